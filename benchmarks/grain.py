"""Grain in photographed dents, by width and by what the colours have in common.

Reflectance that differs from place to place changes all colours alike. Relief of the skin turns the normal, so that two
colours change as their changes per slope do: red against blue in a Mini, whose lamps face each other.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks.photographs import Unit
from benchmarks.results_page import Cell, Table, columns
from tacgen.calibrate import solved_presses
from tacgen.calibrate.photos import PhotographedPress
from tacgen.calibrate.render_comparison import Comparison, near
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Surface, Untouched
from tacgen.sensor.model import LitSensor

Array = np.ndarray
BANDS_PX = ((0.6, 1.2), (1.2, 2.4), (2.4, 4.8))  # widths of the Gaussians whose difference is a band [px]
DENT, FAR = 0.8, 3.5  # contact radii within which is the dent, and beyond which the gel is at rest
TREND_DEGREE = 4  # of the polynomial in x and y that is taken away in a dent: its shape, not its grain
UNTOUCHED_FRAMES = 4  # whose mean a photographed untouched picture is, by its noise
NOTE = (
    f"Change of solved faces within {DENT:g} contact radii, without its trend and without what there is beyond {FAR:g}"
    " radii: rms, rendered over photographed; and correlations, photographed and rendered. Reflectance has 1."
)


def covariance(change: Array, where: Array, band: tuple[float, float]) -> Array:
    """Covariance (3, 3) [counts^2] of a change (H, W, 3) in a band of widths [px], of pixels (H, W) bool, about their
    trend."""
    fine, coarse = (gaussian_filter(change.astype(float), (width, width, 0)) for width in band)
    (y, x), values = np.nonzero(where), (fine - coarse)[where]
    across, down = ((one - one.mean()) / np.ptp(one) for one in (x, y))
    trend = np.column_stack([across**i * down**j for i in range(TREND_DEGREE + 1) for j in range(TREND_DEGREE + 1 - i)])
    return np.asarray(np.cov((values - trend @ np.linalg.lstsq(trend, values, rcond=None)[0]).T))


def total(changes: list[Array], where: list[Array], band: tuple[float, float]) -> Array:
    """Sum of the covariances of changes (3, 3)."""
    return np.asarray(np.sum([covariance(*pair, band) for pair in zip(changes, where, strict=True)], axis=0))


def rows(name: str, unit: Unit, sensor: LitSensor) -> list[list[Cell]]:
    """Rows of the table of a unit: rms over the real one, and correlations of the colours."""
    compared, random, found = Comparison(sensor), np.random.default_rng(0), list[list[Cell]]()
    faces = [solved(sensor, press) for press in unit.presses]
    real = [press.picture - unit.untouched.astype(float) for press in unit.presses]
    flat = [compared.picture(Untouched.of(sensor.gel), random) for _ in range(UNTOUCHED_FRAMES)]
    made = [compared.picture(face, random) - np.mean(flat, axis=0) for face in faces]
    inside = [near(press, DENT) for press in unit.presses]
    rest = [~near(press, FAR) for press in unit.presses]
    for band in BANDS_PX:
        there, ours = (total(part, inside, band) - total(part, rest, band) for part in (real, made))
        spread = np.sqrt(np.diag(ours) / np.diag(there)).tolist()
        found.append([name, f"{band[0]:g} to {band[1]:g}", *spread, *alike(there), *alike(ours)])
    return found


def solved(sensor: LitSensor, press: PhotographedPress) -> Surface:
    """The solved face of a press that is as deep as the formula for its contact circle says."""
    dent = solved_presses.face(sensor, press, {})
    assert isinstance(dent, BallDent)
    (face,) = solved_presses.solved(sensor, press, [-float(dent.at(np.array([dent.center]))[0, 2])], {})
    return face


def alike(covariance: Array) -> list[float]:
    """Correlations of red and green, red and blue, green and blue."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-9))
    return [float(covariance[a, b] / (spread[a] * spread[b])) for a, b in ((0, 1), (0, 2), (1, 2))]


def table(found: list[list[Cell]]) -> Table:
    """Grain of all units."""
    pairs = "red and green", "red and blue", "green and blue"
    named = "rms red", "of green", "of blue", *pairs, *(f"{pair}, rendered" for pair in pairs)
    return Table("Grain in dents", columns("unit", "band [px]", *(f"{one}: .2f" for one in named)), found, NOTE)
