"""Dots found in pictures, and what is fitted to their motion."""

import numpy as np
import pytest

from benchmarks import real_dots
from benchmarks.real_dots import DEPTHS, Pressed

Array = np.ndarray


def drawn(centers: Array) -> Array:
    """A picture of grey 120 with round dots of grey 30 and radius 6 px."""
    y, x = np.mgrid[:90, :120] + 0.5
    picture = np.full((90, 120, 3), 120, np.uint8)
    for cx, cy in centers:
        picture[np.hypot(x - cx, y - cy) < 6] = 30
    return picture


def test_dots_are_found_where_they_are() -> None:
    before = np.array([[20.0, 25.0], [60.0, 25.0], [100.0, 60.0]])
    after = np.add(before, [[3.0, -2.0], [0.5, 1.0], [0.0, 0.0]])
    rest = real_dots.dots(drawn(before))
    found = real_dots.motion(rest, real_dots.dots(drawn(after)))
    np.testing.assert_allclose(found[rest[:, 0].argsort()], after - before, atol=0.25)


def test_a_dot_that_is_gone_has_no_motion() -> None:
    found = real_dots.motion(np.array([[20.0, 25.0], [60.0, 25.0]]), np.array([[21.0, 25.0]]))
    np.testing.assert_array_equal(np.isnan(found), [[False, False], [True, True]])


def test_depth_is_recovered() -> None:
    r = np.random.default_rng(3)
    rest = r.uniform(0, 200, (40, 2))
    made = DEPTHS[:, None, None] * r.normal(size=(40, 2))
    depth, left = Pressed("one", rest, 1.1 * made[-1] / DEPTHS[-1], made).fitted()
    assert depth == pytest.approx(1.1, abs=1e-3)
    assert real_dots.rms(left) < 1e-3
