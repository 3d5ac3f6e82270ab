"""Light evaluated where it bends and interpolated where it does not: exact on a coarse lattice and in every cell of it
whose normals or corner values vary."""

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STRIDE = 4  # samples between lattice points
BEND = 1.5e-3  # [-] a normal may differ from its bilinear interpolation by this much
SPREAD = 0.12  # [-] the corners of an interpolated cell agree within this share


def evaluate(light: Callable[[NDArray[np.int64]], Floats], normals: Floats, shape: tuple[int, int]) -> Floats:
    """`light(indices) -> (n, c)` for every sample of an (h, w) picture, asked for only some of them.

    Args:
        light: values at flat sample indices.
        normals: unit normals (h * w, 3), nan where there is nothing to see.
        shape: h, w.

    Returns:
        (h * w, c).
    """
    rows, columns = lattice(shape[0]), lattice(shape[1])
    points = (rows[:, None] * shape[1] + columns[None, :]).ravel()
    known = light(points)
    out = np.zeros((shape[0] * shape[1], known.shape[1]))
    out[points] = known
    todo = fill(out.reshape(*shape, -1), normals.reshape(*shape, 3), rows, columns, BEND, SPREAD)
    todo.ravel()[points] = False
    rest = np.flatnonzero(todo)
    if len(rest):
        out[rest] = light(rest)
    return out


def lattice(n: int) -> NDArray[np.int64]:
    """0, STRIDE, ... and n - 1."""
    return np.unique(np.append(np.arange(0, n, STRIDE), n - 1))


@njit(cache=True)
def fill(
    out: Floats, normals: Floats, rows: NDArray[np.int64], columns: NDArray[np.int64], bend: float, spread: float
) -> NDArray[np.bool_]:
    """Interpolate `out` (h, w, c) in place in the cells that allow it; True (h, w) where a sample needs evaluation."""
    h, w, count = out.shape
    todo = np.zeros((h, w), np.bool_)
    for j in range(len(rows) - 1):
        for i in range(len(columns) - 1):
            t, b, a, r = rows[j], rows[j + 1], columns[i], columns[i + 1]
            smooth = True
            for c in range(count):
                least = min(out[t, a, c], out[t, r, c], out[b, a, c], out[b, r, c])
                most = max(out[t, a, c], out[t, r, c], out[b, a, c], out[b, r, c])
                if most - least > spread * most:
                    smooth = False
            for y in range(t, b + 1):
                for x in range(a, r + 1):
                    v, u = (y - t) / (b - t), (x - a) / (r - a)
                    for c in range(3):
                        flat = (1 - v) * ((1 - u) * normals[t, a, c] + u * normals[t, r, c])
                        flat += v * ((1 - u) * normals[b, a, c] + u * normals[b, r, c])
                        if not abs(normals[y, x, c] - flat) <= bend:  # nan is not smooth either
                            smooth = False
            for y in range(t, b + 1):
                for x in range(a, r + 1):
                    if not smooth:
                        todo[y, x] = True
                    elif y not in (t, b) or x not in (a, r):
                        v, u = (y - t) / (b - t), (x - a) / (r - a)
                        for c in range(count):
                            top = (1 - u) * out[t, a, c] + u * out[t, r, c]
                            out[y, x, c] = (1 - v) * top + v * ((1 - u) * out[b, a, c] + u * out[b, r, c])
    return todo
