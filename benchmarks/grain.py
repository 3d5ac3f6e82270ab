"""Grain in photographed dents, by width and by what the colours have in common: reflectance changes all alike, relief
of the skin turns the normal, which changes red against blue in a Mini, whose lamps face each other."""

import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks import photographs
from benchmarks.results_page import Cell, Table, columns
from tacgen.calibrate import solved_presses
from tacgen.calibrate.photos import PhotographedPress
from tacgen.calibrate.render_comparison import Comparison, near
from tacgen.optics.surface_grid import Surface, Untouched
from tacgen.sensor.model import LitSensor

Array = np.ndarray
BANDS_PX = ((0.6, 1.2), (1.2, 2.4), (2.4, 4.8))  # widths of the Gaussians whose difference is a band [px]
DENT, FAR = 0.8, 3.5  # contact radii within which is the dent, and beyond which the gel is at rest
TREND_DEGREE = 4  # of the polynomial in x and y that is taken away in a dent: its shape, not its grain
UNTOUCHED_FRAMES = 4  # whose mean a photographed untouched picture is, by its noise
PAIRS = [0, 0, 1], [1, 2, 2]  # of colours
NOTE = (
    f"Change of solved faces within {DENT:g} contact radii, without its trend and without what there is beyond {FAR:g}"
    " radii: rms, rendered over photographed; and correlations, photographed and rendered. Reflectance has 1."
)


def covariance(change: Array, where: Array, band: tuple[float, float]) -> Array:
    """Covariance (3, 3) [counts^2] of a change (H, W, 3) in a band of widths [px] and some pixels, about its trend."""
    fine, coarse = (gaussian_filter(change.astype(float), (width, width, 0)) for width in band)
    (y, x), values = np.nonzero(where), (fine - coarse)[where]
    across, down = ((one - one.mean()) / np.ptp(one) for one in (x, y))
    trend = np.column_stack([across**i * down**j for i in range(TREND_DEGREE + 1) for j in range(TREND_DEGREE + 1 - i)])
    return np.asarray(np.cov((values - trend @ np.linalg.lstsq(trend, values, rcond=None)[0]).T))


def total(changes: list[Array], where: list[Array], band: tuple[float, float]) -> Array:
    """Sum of the covariances of changes (3, 3)."""
    return np.asarray(np.sum([covariance(*pair, band) for pair in zip(changes, where, strict=True)], axis=0))


def rows(name: str, sensor: LitSensor) -> list[list[Cell]]:
    """Rows of the table of a unit: rms over the real one, and correlations of the colours."""
    unit, random, found = photographs.unit(name), np.random.default_rng(0), list[list[Cell]]()
    assert unit is not None
    compared, untouched = Comparison(sensor), Untouched.of(sensor.gel)
    flat = np.mean([compared.picture(untouched, random) for _ in range(UNTOUCHED_FRAMES)], axis=0)
    real = [press.picture - unit.untouched.astype(float) for press in unit.presses]
    made = [compared.picture(solved(sensor, press), random) - flat for press in unit.presses]
    inside = [near(press, DENT) for press in unit.presses]
    rest = [~near(press, FAR) for press in unit.presses]
    for band in BANDS_PX:
        there, ours = (total(part, inside, band) - total(part, rest, band) for part in (real, made))
        scale = [np.sqrt(np.maximum(np.diag(each), 1e-9)) for each in (there, ours)]
        alike = [(each / np.outer(rms, rms))[PAIRS].tolist() for each, rms in zip((there, ours), scale, strict=True)]
        found.append([name, f"{band[0]:g} to {band[1]:g}", *(scale[1] / scale[0]).tolist(), *alike[0], *alike[1]])
    return found


def solved(sensor: LitSensor, press: PhotographedPress) -> Surface:
    """The solved face of a press that is as deep as the formula for its contact circle says."""
    deep = solved_presses.face(sensor, press, {}).at(np.array([solved_presses.place(sensor, press.center, 0.0)]))
    return solved_presses.solved(sensor, press, [-float(deep[0, 2])], {})[0]


def table(sensors: dict[str, LitSensor]) -> Table:
    """Grain of units, by the names of their photographs."""
    found = [row for name, sensor in sensors.items() for row in rows(name, sensor)]
    pairs = "red and green", "red and blue", "green and blue"
    named = "rms red", "of green", "of blue", *pairs, *(f"{pair}, rendered" for pair in pairs)
    return Table("Grain in dents", columns("unit", "band [px]", *(f"{one}: .2f" for one in named)), found, NOTE)
