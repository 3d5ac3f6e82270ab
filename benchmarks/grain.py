"""Grain in photographed dents, by width and by what the colours have in common.

Reflectance that differs from place to place changes all colours alike. Relief of the skin turns the normal, so that two
colours change as their changes per slope do: red against blue in a Mini, whose lamps face each other.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks.photographs import Unit
from benchmarks.results_page import Cell, Table, columns
from tacgen.calibrate.render_comparison import Comparison, near
from tacgen.optics.surface_grid import Surface, Untouched

Array = np.ndarray
BANDS_PX = ((0.6, 1.2), (1.2, 2.4), (2.4, 4.8))  # widths of the Gaussians whose difference is a band [px]
DENT, FAR = 0.8, 3.5  # contact radii within which is the dent, and beyond which the gel is at rest
TREND_DEGREE = 4  # of the polynomial in x and y that is taken away in a dent: its shape, not its grain
NOTE = (
    f"Change within {DENT:g} contact radii, without its trend: rms, photographed over rendered by a formula that moves"
    f" the face along z; and correlations of what photographs have there beyond {FAR:g} radii. Reflectance has 1."
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


def rows(name: str, unit: Unit, faces: list[Surface], compared: Comparison) -> list[list[Cell]]:
    """Rows of the table of a unit: rms, and correlations of the colours."""
    random, found = np.random.default_rng(0), list[list[Cell]]()
    real = [press.picture - unit.untouched.astype(float) for press in unit.presses]
    flat = compared.picture(Untouched.of(compared.sensor.gel), random).astype(float)
    made = [compared.picture(face, random) - flat for face in faces]
    inside = [near(press, DENT) for press in unit.presses]
    rest = [~near(press, FAR) for press in unit.presses]
    for band in BANDS_PX:
        there, ours = (total(part, inside, band) for part in (real, made))
        excess = there - total(real, rest, band)
        spread = np.sqrt(np.maximum(np.diag(excess), 1e-9))
        alike = [float(excess[a, b] / (spread[a] * spread[b])) for a, b in ((0, 1), (0, 2), (1, 2))]
        found.append([name, f"{band[0]:g} to {band[1]:g}", *np.sqrt(np.diag(there) / np.diag(ours)).tolist(), *alike])
    return found


def table(found: list[list[Cell]]) -> Table:
    """Grain of all units."""
    named = "rms red", "of green", "of blue", "red and green", "red and blue", "green and blue"
    return Table("Grain in dents", columns("unit", "band [px]", *(f"{one}: .2f" for one in named)), found, NOTE)
