"""Grain in and around photographed dents, by width and by what the colours have in common.

Reflectance that differs from place to place changes all colours alike. Relief of the skin turns the normal, so that two
colours change as their changes per slope do: red against blue in a Mini, whose lamps face each other.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks.photographs import Unit
from benchmarks.results_page import Cell, Table, columns
from tacgen.calibrate.render_comparison import Comparison, circle
from tacgen.optics.surface_grid import Surface, Untouched

Array = np.ndarray
BANDS_PX = ((0.6, 1.2), (1.2, 2.4), (2.4, 4.8))  # widths of the Gaussians whose difference is a band [px]
DENT, FAR = 0.8, 3.5  # contact radii within which is the dent, and beyond which the gel is at rest
TREND_DEGREE = 4  # of the polynomial in x and y that is taken away in a dent: its shape, not its grain
PAIRS = ((0, 1), (0, 2), (1, 2))  # of colours


def covariance(change: Array, where: Array, band: tuple[float, float]) -> Array:
    """Covariance (3, 3) [counts^2] of a change (H, W, 3) in a band of widths [px], of pixels (H, W) bool, about their
    trend."""
    fine, coarse = (gaussian_filter(change.astype(float), (width, width, 0)) for width in band)
    (y, x), values = np.nonzero(where), (fine - coarse)[where]
    across, down = ((one - one.mean()) / np.ptp(one) for one in (x, y))
    trend = np.column_stack([across**i * down**j for i in range(TREND_DEGREE + 1) for j in range(TREND_DEGREE + 1 - i)])
    return np.asarray(np.cov((values - trend @ np.linalg.lstsq(trend, values, rcond=None)[0]).T))


def correlations(excess: Array) -> list[Cell]:
    """Correlation of red and green, red and blue, green and blue in a covariance (3, 3)."""
    deviation = np.sqrt(np.maximum(np.diag(excess), 1e-9))
    return [float(np.clip(excess[pair] / (deviation[pair[0]] * deviation[pair[1]]), -1, 1)) for pair in PAIRS]


def table(units: list[tuple[str, Unit, list[Surface], Comparison]]) -> Table:
    """Grain of each unit and band: rms in the dent, photographed over rendered; and correlations of the colours in what
    the photographed dent has more than the gel at rest."""
    rows: list[list[Cell]] = []
    for name, unit, faces, compared in units:
        random = np.random.default_rng(0)
        flat = compared.picture(Untouched.of(compared.sensor.gel), random).astype(float)
        pairs = [(press.picture - unit.untouched.astype(float), compared.picture(face, random) - flat)
                 for press, face in zip(unit.presses, faces, strict=True)]  # fmt: skip
        for band in BANDS_PX:
            dent, rest = np.zeros((2, 3, 3)), np.zeros((3, 3))
            for press, changes in zip(unit.presses, pairs, strict=True):
                inside, touched = (circle(flat.shape[:2], press.center, share * (press.contact or 0.0), press.aspect)
                                   for share in (DENT, FAR))  # fmt: skip
                dent += [covariance(one, inside, band) for one in changes]
                rest += covariance(changes[0], ~touched, band)
            ratio = np.sqrt(np.diag(dent[0]) / np.diag(dent[1])).tolist()
            rows.append([name, f"{band[0]:g} to {band[1]:g}", *ratio, *correlations(dent[0] - rest)])
    named = "rms red", "of green", "of blue", "red and green", "red and blue", "green and blue"
    heads = columns("unit", "band [px]", *(f"{one}: .2f" for one in named))
    note = (
        f"Change within {DENT:g} contact radii, without its trend, photographed over rendered; and correlations of what"
        f" it has beyond the change at {FAR:g} contact radii. Reflectance alone has"
        " 1. Rendered dents are those of a formula, whose points move along z alone; the second file has no grain."
    )
    return Table("Grain in dents", heads, rows, note)
