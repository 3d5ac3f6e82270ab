"""Adaptive evaluation of light: exact on a coarse lattice, interpolated where normals and corner values hardly vary;
other cells are halved."""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacgen.physics import runtime, sampling

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Cells = NDArray[np.int32]


class SamplingTolerance(NamedTuple):
    """When a cell is interpolated."""

    stride: int = 4  # samples between points of the coarsest lattice
    bend: float = 6e-3  # [-] a normal may differ from its bilinear interpolation by this much
    spread: float = 0.25  # [-] the corners of an interpolated cell agree within this share


def evaluate(
    light: Callable[[Integers], Floats], normals: Floats, shape: tuple[int, int], tolerance: SamplingTolerance
) -> Floats:
    """`light(indices) -> (n, c)` for every sample of an (h, w) picture, computed for some and interpolated for others.

    Args:
        light: values at flat sample indices.
        normals: unit normals (h * w, 3), nan where there is nothing to see.
        shape: h, w.
        tolerance: see above.

    Returns:
        (h * w, c).
    """
    h, w = shape
    cells, known, out = lattice(shape, tolerance.stride), np.zeros(h * w, np.bool_), np.zeros((0, 0))
    count = np.zeros(1, np.int32)
    while len(cells):
        points = np.empty(4 * len(cells), np.int64)
        runtime.call(sampling.corners, (1,), cells, known, w, points, count)
        points = points[: count[0]]
        values = light(points)
        out = out if out.size else np.zeros((h * w, values.shape[1]))
        out[points] = values
        halves = np.empty((4 * len(cells), 4), np.int32)
        sizes = w, out.shape[1], tolerance.bend, tolerance.spread
        runtime.call(sampling.filled, (1,), out.reshape(-1), known, normals, cells, *sizes, halves, count)
        cells = halves[: count[0]]
    return out


@lru_cache(maxsize=8)
def lattice(shape: tuple[int, int], stride: int) -> Cells:
    """The coarsest cells of a picture (h, w), whose sides are `stride` samples: (cells, 4), first
    and last row and column of each; read-only."""
    rows, columns = (np.unique(np.append(np.arange(0, n, stride), n - 1)) for n in shape)
    top, left = (grid.ravel() for grid in np.meshgrid(rows[:-1], columns[:-1], indexing="ij"))
    bottom, right = (grid.ravel() for grid in np.meshgrid(rows[1:], columns[1:], indexing="ij"))
    return np.column_stack([top, bottom, left, right]).astype(np.int32)
