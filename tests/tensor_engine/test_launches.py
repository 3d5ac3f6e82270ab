"""Launches on tensors, prepared once for each kernel and types of its arrays: on a core they are tried as they are."""

import numpy as np
import pytest
import warp as wp

from tacgen.physics.runtime import TensorLaunches
from tests.helpers.needs import needs

needs("torch")
import torch


@wp.kernel(enable_backward=False, module="tests.launches")
def moved(
    x: wp.array2d(dtype=wp.vec2d), which: wp.array(dtype=wp.bool), way: wp.vec2d, times: wp.float64, first: int,
    out: wp.array2d(dtype=wp.vec2d),
):  # fmt: skip
    s, k = wp.tid()
    value = x[s, k]
    if k >= first and (which.shape[0] == 0 or which[s]):
        value = value + times * way
    out[s, k] = value


def test_shapes_strides_numbers_and_vectors_may_change() -> None:
    launches, r = TensorLaunches(), np.random.default_rng(0)
    for scenes, count, way, times, first, marked in [
        (2, 3, (1.0, 2.0), 1.0, 0, False),
        (3, 5, (5.0, 7.0), 2.0, 1, False),
        (3, 5, (1.0, 0.0), 0.5, 2, True),
        (4, 2, (1.0, 0.0), 0.5, 0, True),
        (2, 3, (0.0, 3.0), 4.0, 0, False),
    ] * 2:
        whole = torch.as_tensor(r.normal(size=(scenes, 2 * count, 2)))
        x, out = whole[:, ::2], torch.full((scenes, count, 2), np.nan, dtype=torch.float64)
        which = torch.as_tensor(r.random(scenes) < 0.5) if marked else None
        launches(moved, (scenes, count), (x, which, wp.vec2d(*way), times, first, out)).launch()
        there = (np.arange(count) >= first)[None, :] & (which.numpy()[:, None] if marked else np.full((1, 1), True))
        assert out.numpy() == pytest.approx(x.numpy() + there[..., None] * times * np.array(way))


def test_a_tensor_of_other_last_axes_is_refused() -> None:
    launches, way = TensorLaunches(), wp.vec2d(1.0, 2.0)
    good, bad = (torch.zeros(1, 3, last, dtype=torch.float64) for last in (2, 3))
    launches(moved, (1, 3), (good, None, way, 1.0, 0, good)).launch()
    turned = torch.zeros(1, 2, 4, dtype=torch.float64).transpose(1, 2)
    for x in (bad, good[..., 0], turned):
        with pytest.raises(ValueError, match="x of moved"):
            launches(moved, (1, 3), (x, None, way, 1.0, 0, good))
