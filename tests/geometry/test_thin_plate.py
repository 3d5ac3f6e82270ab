"""The spline against SciPy's, and distances against its tree."""

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

from tacgen.geometry.thin_plate import distances, thin_plate

RNG = np.random.default_rng(0)


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
