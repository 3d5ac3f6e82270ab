"""Adaptive evaluation of light: exact on a coarse lattice, interpolated where normals and corner values hardly vary;
other cells are halved."""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacgen.base.compiled import njit

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


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
    while len(cells):
        points = corners(cells, known, w)
        values = light(points)
        out = out if out.size else np.zeros((h * w, values.shape[1]))
        out[points] = values
        cells = fill(out.reshape(h, w, -1), known.reshape(h, w), normals.reshape(h, w, 3), cells, *tolerance[1:])
    return out


@lru_cache(maxsize=8)
def lattice(shape: tuple[int, int], stride: int) -> Integers:
    """The coarsest cells of a picture (h, w), whose sides are `stride` samples: (cells, 4), as in `fill`; read-only."""
    rows, columns = (np.unique(np.append(np.arange(0, n, stride), n - 1)) for n in shape)
    top, left = (grid.ravel() for grid in np.meshgrid(rows[:-1], columns[:-1], indexing="ij"))
    bottom, right = (grid.ravel() for grid in np.meshgrid(rows[1:], columns[1:], indexing="ij"))
    return np.column_stack([top, bottom, left, right])


@njit(cache=True)
def corners(cells: Integers, known: NDArray[np.bool_], width: int) -> Integers:
    """Flat indices (n,) of the corners of cells (cells, 4) that are not `known` (h * w,) yet; known from then on."""
    count, out = 0, np.empty(4 * len(cells), np.int64)
    for m in range(len(cells)):
        for y in range(2):
            for x in range(2, 4):
                at = cells[m, y] * width + cells[m, x]
                if not known[at]:
                    known[at], out[count] = True, at
                    count += 1
    return out[:count]


@njit(cache=True, error_model="numpy")
def fill(
    out: Floats, known: NDArray[np.bool_], normals: Floats, cells: Integers, bend: float, spread: float
) -> Integers:
    """Interpolate `out` (h, w, c) in place, but for what is `known` (h, w), in the cells that allow it.

    Returns:
        The halves of those that do not: (cells, 4), as `cells`: first and last row and column.
    """
    count, left = 0, np.empty((4 * len(cells), 4), np.int64)
    first, step = np.empty(out.shape[2]), np.empty(out.shape[2])
    for m in range(len(cells)):
        t, b, a, r = cells[m, 0], cells[m, 1], cells[m, 2], cells[m, 3]
        if b - t <= 1 and r - a <= 1:
            continue
        if bends(out, normals, t, b, a, r, bend, spread):
            middle, centre = (t + b) // 2, (a + r) // 2
            for y in range(2 if middle > t else 1):
                for x in range(2 if centre > a else 1):
                    left[count, 0], left[count, 1] = middle if y == 1 else t, middle if y == 0 and middle > t else b
                    left[count, 2], left[count, 3] = centre if x == 1 else a, centre if x == 0 and centre > a else r
                    count += 1
            continue
        down, across = 1 / (b - t), 1 / (r - a)
        for y in range(t, b + 1):
            v = (y - t) * down
            for c in range(out.shape[2]):
                first[c] = (1 - v) * out[t, a, c] + v * out[b, a, c]
                step[c] = ((1 - v) * out[t, r, c] + v * out[b, r, c] - first[c]) * across
            for x in range(a, r + 1):
                if not known[y, x]:
                    for c in range(out.shape[2]):
                        out[y, x, c] = first[c] + (x - a) * step[c]
    return left[:count]


@njit(cache=False, error_model="numpy")
def bends(out: Floats, normals: Floats, t: int, b: int, a: int, r: int, bend: float, spread: float) -> bool:
    """Whether light cannot be interpolated in a cell; nan counts as not smooth."""
    for c in range(out.shape[2]):
        least = min(out[t, a, c], out[t, r, c], out[b, a, c], out[b, r, c])
        most = max(out[t, a, c], out[t, r, c], out[b, a, c], out[b, r, c])
        if most - least > spread * most:
            return True
    down, across = 1 / (b - t), 1 / (r - a)
    for y in range(t, b + 1):
        v = (y - t) * down
        for c in range(3):
            first = (1 - v) * normals[t, a, c] + v * normals[b, a, c]
            step = ((1 - v) * normals[t, r, c] + v * normals[b, r, c] - first) * across
            for x in range(a, r + 1):
                if not abs(normals[y, x, c] - (first + (x - a) * step)) <= bend:
                    return True
    return False
