"""Normals that belong to one surface: the step from normals to height that users of such sensors take, and back."""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

Array = np.ndarray
MIN_UPRIGHT = 0.1  # component of a unit normal along z at least, for a finite slope [-]
FREE_HEIGHT_WEIGHT = 1e-9  # of the squared heights, in which slopes leave a constant free [1/px^2]


def integrable(normals: Array, where: Array, aspect: float = 1.0) -> Array:
    """Normals of the surface whose slopes come nearest to those given (Frankot & Chellappa 1988, here in any region).

        min over h of the sum over neighbours a, b along x and y of ((h_b - h_a) / d - (g_a + g_b) / 2)^2

    g is the slope along the way from a to b, d its length. What noise and ambiguous colours add to a field of slopes
    is curled for a good part, which no surface is.

    Args:
        normals: x and y of unit normals (n, 2) of the pixels `where` (H, W) bool, row by row.
        aspect: height of a pixel over its width.
    """
    slopes = normals / np.sqrt(np.maximum(1 - (normals**2).sum(axis=1, keepdims=True), MIN_UPRIGHT**2))
    number = np.full(where.shape, -1)
    number[where] = np.arange(len(slopes))
    steps = [_steps(*pair, len(slopes)) for pair in ((number[:, :-1], number[:, 1:]), (number[:-1], number[1:]))]
    ends, rise = [abs(one) for one in steps], sparse.vstack([steps[0], steps[1] / aspect])
    wanted = np.concatenate([each @ slope / 2 for each, slope in zip(ends, slopes.T, strict=True)])
    free = FREE_HEIGHT_WEIGHT * sparse.eye(len(slopes))
    height = spsolve((rise.T @ rise + free).tocsc(), rise.T @ wanted)
    parts = np.split(rise @ height - wanted, [steps[0].shape[0]])
    for k, (each, part) in enumerate(zip(ends, parts, strict=True)):
        slopes[:, k] += each.T @ part / np.maximum(each.sum(axis=0), 1)
    return np.asarray(slopes / np.sqrt(1 + (slopes**2).sum(axis=1, keepdims=True)))


def _steps(here: Array, there: Array, count: int) -> sparse.csr_array:
    """Differences (m, count) between neighbours, given by the numbers of two pixels; -1 is none."""
    both = (here >= 0) & (there >= 0)
    lines = np.arange(both.sum())
    places = np.concatenate([lines, lines]), np.concatenate([here[both], there[both]])
    return sparse.csr_array((np.repeat([-1.0, 1.0], len(lines)), places), shape=(len(lines), count))
