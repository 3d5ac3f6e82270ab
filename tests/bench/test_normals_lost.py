"""The parts of a press that are replaced to find where the error of normals comes from."""

import numpy as np
import pytest

from benchmarks import normals_lost
from tacgen.calibrate.likeness import PictureOfPress


@pytest.fixture
def pair():
    """A rendered press, and a photographed one that differs by 3 counts, 20 counts per slope along x in red, and 50 per
    squared slope along y in blue."""
    random, where = np.random.default_rng(1), np.zeros((12, 10), bool)
    where[2:9, 3:9] = True
    slopes, flat = random.uniform(-0.7, 0.7, (where.sum(), 2)), np.full((where.sum(), 2), 0.1)
    made = PictureOfPress(random.normal(size=(12, 10, 3)), where, slopes, flat)
    change, (x, y) = made.change.copy(), (slopes - flat).T
    change[where] += np.column_stack([3 + 20 * x, np.full(len(x), 3.0), 3 + 50 * y**2])
    return PictureOfPress(change, where, slopes, flat), made


def test_a_misfit_is_taken_off_by_the_order_of_its_polynomial(pair):
    real, made = pair
    left = [
        np.abs((normals_lost.without(real, made, n).change - made.change)[real.where]).max(axis=0) for n in (0, 1, 2)
    ]
    assert left[0][0] > 5
    assert left[0][1] < 1e-9
    assert left[1][0] < 1e-9
    assert left[1][2] > 5
    assert (left[2] < 1e-9).all()


def test_outside_the_contact_nothing_is_taken_off(pair):
    real, made = pair
    assert (normals_lost.without(real, made, 2).change == real.change)[~real.where].all()


def test_one_channel_is_swapped(pair):
    real, made = pair
    mixed = normals_lost.swapped(real, made, np.arange(3) == 2).change
    assert (mixed[..., 2] == made.change[..., 2]).all()
    assert (mixed[..., :2] == real.change[..., :2]).all()
