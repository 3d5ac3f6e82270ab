"""Launches on a core: what changes from one to the next is given anew, and arrays of other types are refused."""

import numpy as np
import pytest
import warp as wp
from helpers.program import ran

from tacgen.physics import MAX_UNROLLED_STEPS
from tacgen.physics.runtime import call


@wp.kernel(enable_backward=False, module="tests.runtime")
def moved(x: wp.array(dtype=wp.vec2d), way: wp.vec2d, times: wp.float64, out: wp.array(dtype=wp.vec2d)):
    k = wp.tid()
    out[k] = x[k] + times * way


def shifted(x: np.ndarray, way: tuple[float, float], times: float) -> np.ndarray:
    out = np.full(x.shape, np.nan)
    call(moved, (len(x),), x, way, times, out)
    return out


def test_numbers_vectors_and_lengths_may_change() -> None:
    r = np.random.default_rng(0)
    for count, way, times in [
        (3, (1.0, 2.0), 1.0),
        (3, (5.0, 7.0), 1.0),
        (9, (1.0, 2.0), 1.0),
        (9, (1.0, 2.0), 3.0),
    ] * 2:
        x = r.normal(size=(count, 2))
        assert shifted(x, way, times) == pytest.approx(x + times * np.array(way))
    assert shifted(np.asfortranarray(r.normal(size=(4, 2))), (0.0, 0.0), 0.0).shape == (4, 2)
    assert shifted(np.zeros((0, 2)), (1.0, 2.0), 1.0).shape == (0, 2)


def test_arrays_of_other_types_and_shapes_are_refused() -> None:
    """A whole number in the place of a real one would be read as another."""
    shifted(np.zeros((2, 2)), (1.0, 2.0), 1.0)
    with pytest.raises(AssertionError, match="int64"):
        shifted(np.zeros((2, 2), np.int64), (1.0, 2.0), 1.0)
    with pytest.raises(ValueError, match="last axes"):
        shifted(np.zeros((2, 3)), (1.0, 2.0), 1.0)


def test_threads_of_other_axes_are_refused() -> None:
    """A kernel would take the second axis for another, and write beyond its arrays."""
    with pytest.raises(AssertionError, match="1 axes"):
        call(moved, (1, 2), np.zeros((2, 2)), (1.0, 2.0), 7.0, np.zeros((2, 2)))


def test_what_other_programs_compile_is_not_changed() -> None:
    """Settings of the compiler are those of tacgen's modules alone: Newton's kernels need loops that are unrolled."""
    names = ("max_unroll", "enable_backward", "cpu_compiler_flags")
    told = "import warp as wp; before = vars(wp.config).copy(); import tacgen.physics.elements;"
    told += f"print([n for n in {names} if vars(wp.config)[n] != before[n]],"
    told += "wp.get_module('tacgen.physics').options['max_unroll'])"
    assert ran("-c", told).split() == ["[]", str(MAX_UNROLLED_STEPS)]
