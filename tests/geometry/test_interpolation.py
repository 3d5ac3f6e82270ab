"""Cubics and thin plates against SciPy's, and distances against its tree."""

import pickle

import numpy as np
import pytest
from scipy.interpolate import CloughTocher2DInterpolator, RBFInterpolator
from scipy.spatial import Delaunay, cKDTree

from tacgen.geometry.clough_tocher import CloughTocher
from tacgen.geometry.thin_plate import distances, thin_plate

RNG = np.random.default_rng(0)
GRID = np.stack(np.meshgrid(np.linspace(-3, 3, 7) ** 3 / 9, np.linspace(-2, 2, 6)), -1).reshape(-1, 2)


@pytest.mark.parametrize("points", [GRID, RNG.uniform(-3, 3, (60, 2))])
def test_values_are_those_of_scipy(points: np.ndarray) -> None:
    f = np.stack([np.sin(points[:, 0]) * np.cos(points[:, 1]), points[:, 0] ** 3], -1)
    at = RNG.uniform(-3.2, 3.2, (2000, 2))
    expected = CloughTocher2DInterpolator(Delaunay(points), f, tol=1e-13, maxiter=10_000)(at)
    between = CloughTocher(points)
    found = between.at(at, between.nodal(f))
    assert 500 < np.isfinite(expected[:, 0]).sum() < 2000
    assert found == pytest.approx(expected, abs=1e-11, nan_ok=True)
    at.flags.writeable = False
    assert np.array_equal(between.at(at, between.nodal(f)), found, equal_nan=True)  # its matrix is made
    assert between.at(at, between.nodal(2 * f)) == pytest.approx(2 * found, abs=1e-11, nan_ok=True)  # and used again


def test_many_columns_are_what_each_is_alone() -> None:
    between, at, values = CloughTocher(GRID), RNG.uniform(-2, 2, (200, 2)), RNG.normal(size=(len(GRID), 7))
    nodal = between.nodal(values)
    alone = [between.at(at, np.ascontiguousarray(nodal[:, [k]])) for k in range(7)]
    assert np.array_equal(between.at(at, nodal), np.hstack(alone), equal_nan=True)


def test_two_read_only_arrays_have_their_own_matrices() -> None:
    between = CloughTocher(GRID)
    for at in (RNG.uniform(-1, 1, (9, 2)) for _ in range(20)):
        at.flags.writeable = False
        assert between.at(at, between.nodal(GRID)) == pytest.approx(at, abs=1e-12)


def test_it_can_be_sent_to_another_process_after_use() -> None:
    rng = np.random.default_rng(3)
    cubics, xy = CloughTocher(rng.uniform(-1, 1, (40, 2))), rng.uniform(-0.3, 0.3, (20, 2))
    values = rng.normal(size=(40, 2))
    found = cubics.at(xy, cubics.nodal(values))
    other = pickle.loads(pickle.dumps(cubics))
    assert np.array_equal(other.at(xy, other.nodal(values)), found)


@pytest.mark.parametrize("smoothing", [0.0, 0.3])
def test_the_spline_is_scipys(smoothing: float) -> None:
    known, values, at = RNG.uniform(7, 12, (40, 2)), RNG.normal(size=40), RNG.uniform(6, 13, (30, 2))
    spline = RBFInterpolator(known, values, kernel="thin_plate_spline", smoothing=smoothing)
    there, further = thin_plate(known, values, at, smoothing)
    assert there == pytest.approx(spline(known), abs=1e-9)
    assert further == pytest.approx(spline(at), abs=1e-9)


def test_distances_are_those_of_a_tree_as_far_as_asked() -> None:
    at, to = RNG.uniform(-9, 9, (500, 2)), RNG.uniform(-1, 2, (20, 2))
    expected, found = cKDTree(to).query(at)[0], distances(at, to, 1.5)
    near = expected <= 3.0
    assert 20 < near.sum() < 300
    assert found[near] == pytest.approx(expected[near])
    assert (np.isinf(found) | np.isclose(found, expected)).all()
    assert np.isinf(found).sum() > 100
