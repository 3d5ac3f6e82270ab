"""The search that `calibrate optics` repeats: a known minimum is found, marks do not move it, bounds and ridge hold."""

import numpy as np
import pytest

from tacgen.calibrate import robust_least_squares
from tacgen.calibrate.robust_least_squares import LinearModel, Ridge

U, LIGHTS, SOFT = np.array([0.4, -0.3]), np.array([2.0, 0.7, 0.0]), 15.0


def tables(u: np.ndarray = U, marks: float = 0.0) -> LinearModel:
    """Equations with noise of one count whose solution is u and LIGHTS; a tenth of the pixels is off by `marks`."""
    random = np.random.default_rng(0)
    rows, slopes = random.normal(0, 40, (600, 4)), random.normal(0, 20, (2, 600, 4))
    slopes[:, :, -1] = 0.0
    made = rows[:, :-1] + np.tensordot(u, slopes[..., :-1], 1)
    rows[:, -1] = made @ LIGHTS + random.normal(0, 1, 600)
    rows[::10, -1] += marks
    return LinearModel(np.zeros(2), rows, slopes)


def found(near: LinearModel, weight: float = 1e-3, most: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    ridge = Ridge(weight, np.ones(3), np.ones(3))
    return robust_least_squares.minimise(near, np.ones(3), (np.full(2, -most), np.full(2, most)), ridge, SOFT)


def test_parameters_and_radiances_are_found_together() -> None:
    u, lights = found(tables())
    assert u == pytest.approx(U, abs=0.005)
    assert lights == pytest.approx(LIGHTS, abs=0.005)
    assert lights.min() >= 0


def test_marks_on_a_tenth_of_the_pixels_hardly_matter() -> None:
    marked = tables(marks=300.0)
    u, _ = found(marked)
    assert u == pytest.approx(U, abs=0.04)
    table = np.column_stack([(marked.slopes @ np.append(LIGHTS, -1)).T, marked.rows[:, :-1]])
    squares = np.linalg.lstsq(table, marked.rows[:, -1], rcond=None)[0][:2]  # even with the right radiances
    assert np.abs(u - U).max() < 0.5 * np.abs(squares - U).max()


def test_bounds_and_a_strong_ridge_hold() -> None:
    u, _ = found(tables(), most=0.2)
    assert u == pytest.approx([0.2, -0.2], abs=1e-9)
    u, lights = found(tables(), weight=1e6)
    assert u == pytest.approx(np.zeros(2), abs=1e-3)
    assert lights == pytest.approx(np.ones(3), abs=1e-3)
