"""Smooth interpolation over a triangulation, as matrices that are computed once: it is linear in the nodal values.

Each triangle has a cubic in three pieces; the whole is C1 (Clough & Tocher 1965; slopes across edges as in SciPy's
CloughTocher2DInterpolator). The nodal slopes minimise the curvature along the edges (Nielson 1983).
"""

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.base.compiled import njit

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = np.ndarray


class CloughTocher:
    """Interpolation of values at points (s, 2); matrices are computed when they are first needed."""

    def __init__(self, points: Array) -> None:
        self._points = points
        self._kept: dict[int, tuple[Array, tuple[Array, Array]]] = {}

    def __reduce__(self) -> "tuple[type[CloughTocher], tuple[Array]]":
        return CloughTocher, (self._points,)  # a factorisation cannot be pickled

    @cached_property
    def _plan(self) -> Any:
        from scipy.spatial import Delaunay

        return Delaunay(self._points)

    @cached_property
    def _slopes(self) -> "tuple[Any, csr_array]":
        from scipy.sparse.linalg import splu

        bending, pull = _least_curvature(self._points, *self._plan.vertex_neighbor_vertices)
        # ordered as the symmetric positive definite matrix that it is: two thirds of the entries
        how = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        return splu(bending, **how), pull

    def nodal(self, values: Array) -> Array:
        """Values (s, c) at the points, followed by their slopes, alternately along x and y: (3s, c)."""
        bending, pull = self._slopes
        return np.concatenate([values, bending.solve(pull @ values)])

    def at(self, xy: Array, nodal: Array) -> Array:
        """Values (n, c) at xy (n, 2), nan outside the points' convex hull. The matrix of a read-only xy is cached."""
        if xy.flags.writeable:
            return np.asarray(_weighted(*self._matrix(xy), nodal))
        if id(xy) not in self._kept:
            self._kept[id(xy)] = xy, self._matrix(xy)
        return np.asarray(_weighted(*self._kept[id(xy)][1], nodal))

    def _matrix(self, xy: Array) -> tuple[Array, Array]:
        """The matrix from nodal values and slopes (3s,) to values (n,) at xy (n, 2): see _weights."""
        plan = self._plan
        triangles = plan.points, plan.simplices, plan.neighbors, plan.transform
        return _weights(xy, plan.find_simplex(xy), *triangles)


def _least_curvature(points: Array, start: Array, beside: Array) -> "tuple[csr_array, csr_array]":
    """K (2s, 2s) and P (2s, s): the slopes g with K g = P f minimise the bending of all edges.

    The bending of a cubic over an edge of length L that rises by r, with slopes a/L and b/L at its ends, is
    4 (a^2 + ab + b^2 - 3r (a + b) + 3r^2) / L^3.
    """
    from scipy.sparse import csc_array, csr_array

    s, m = len(points), len(beside)
    own = np.repeat(np.arange(s), np.diff(start))  # each edge is listed from both of its ends
    way = points[beside] - points[own]

    def along(node: Array, ways: Array) -> csr_array:
        columns = (2 * node[:, None] + [0, 1]).ravel()
        return csr_array((ways.ravel(), columns, 2 * np.arange(m + 1)), shape=(m, 2 * s))

    pull = along(own, way / np.linalg.norm(way, axis=1, keepdims=True) ** 3).T
    rise = csr_array((np.tile([1.0, -1.0], m), np.stack([beside, own], 1).ravel(), 2 * np.arange(m + 1)), shape=(m, s))
    return csc_array(pull @ (2 * along(own, way) + along(beside, way))), 3 * pull @ rise


@njit(cache=True)
def _weights(
    xy: Array, number: Array, points: Array, simplices: Array, neighbors: Array, transform: Array
) -> tuple[Array, Array]:
    """Weights (n, 9) of a triangle's three values and of their slopes, alternately along x and y; and their indices
    (n, 9) among all values and slopes.

    Args:
        xy: points (n, 2). number: triangle of each point (n,); -1 outside, where the weights are nan.
        points, simplices, neighbors, transform: the triangulation, as in SciPy's Delaunay.
    """
    out, columns, last = np.empty((len(xy), 9)), np.empty((len(xy), 9), np.int32), -1
    out[:], columns[:] = np.nan, 0
    at, b, turn, corners = np.empty(3), np.empty(3), np.empty(3), np.empty((3, 2))
    # Bezier ordinates of each weight's function over a triangle: at corners, beside them, inside, across the edges
    ordinates, share = np.empty((9, 15)), np.empty(15)
    for p in range(len(xy)):
        t = number[p]
        if t < 0:
            continue
        if t != last:  # neighbours often share a triangle
            last = t
            for k in range(3):
                corners[k, 0], corners[k, 1] = points[simplices[t, k], 0], points[simplices[t, k], 1]
                turn[k] = -0.5
                beside = neighbors[t, k]
                if beside >= 0:  # by the barycentric coordinates of the centroid of the triangle across the edge
                    x = y = 0.0
                    for i in range(3):
                        x, y = x + points[simplices[beside, i], 0], y + points[simplices[beside, i], 1]
                    _barycentric(transform[t], x / 3, y / 3, at)
                    i, j = at[(k + 1) % 3], at[(k + 2) % 3]
                    turn[k] = (2 * j + i - 1) / (2 - 3 * (i + j))
            for m in range(9):
                value, toward = ordinates[m, :3], ordinates[m, 3:9]  # of corner k toward k + 1 and k + 2
                inner, across = ordinates[m, 9:12], ordinates[m, 12:]
                for k in range(3):
                    value[k] = 1.0 if m == k else 0.0
                    for n in range(2):
                        j = (k + 1 + n) % 3
                        slope = (corners[j, (m - 3) % 2] - corners[k, (m - 3) % 2]) / 3
                        toward[2 * k + n] = value[k] + (slope if m >= 3 and (m - 3) // 2 == k else 0.0)
                    inner[k] = (value[k] + toward[2 * k] + toward[2 * k + 1]) / 3
                for k in range(3):
                    i, j = (k + 1) % 3, (k + 2) % 3
                    ahead, back = toward[2 * i], toward[2 * j + 1]
                    bend = turn[k] * (3 * (ahead - back) + value[j] - value[i])
                    across[k] = (bend - value[i] + 2 * ahead - back + inner[i] + inner[j]) / 2
        _barycentric(transform[t], xy[p, 0], xy[p, 1], at)
        c = min(at[0], at[1], at[2])  # the piece between the other two corners and the centroid
        for k in range(3):
            b[k] = at[k] - c
        c *= 3
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            share[k], share[3 + 2 * k], share[4 + 2 * k] = b[k] ** 3, 3 * b[k] ** 2 * b[i], 3 * b[k] ** 2 * b[j]
            share[9 + k] = c**3 / 9 + c**2 * b[k] + 3 * b[k] ** 2 * c
            share[12 + k] = 2 * c**3 / 9 + c**2 * (b[i] + b[j]) + 6 * c * b[i] * b[j]
            first = len(points) + 2 * simplices[t, k]
            columns[p, k], columns[p, 3 + 2 * k], columns[p, 4 + 2 * k] = simplices[t, k], first, first + 1
        for m in range(9):
            total = 0.0
            for n in range(15):
                total += share[n] * ordinates[m, n]
            out[p, m] = total
    return out, columns


@njit(cache=True)
def _weighted(weights: Array, columns: Array, nodal: Array) -> Array:
    """Sums (n, c) of nodal values and slopes (3s, c) by weights (n, 9) of those in columns (n, 9); five at once."""
    last = nodal.shape[1] - 1
    out = np.empty((len(weights), last + 1))
    for first in range(0, last + 1, 5):
        a, b, c, d, e = first, min(first + 1, last), min(first + 2, last), min(first + 3, last), min(first + 4, last)
        for p in range(len(weights)):
            in_a = in_b = in_c = in_d = in_e = 0.0
            for k in range(9):
                weight, value = weights[p, k], nodal[np.uint32(columns[p, k])]
                in_a, in_b, in_c = in_a + weight * value[a], in_b + weight * value[b], in_c + weight * value[c]
                in_d, in_e = in_d + weight * value[d], in_e + weight * value[e]
            out[p, a], out[p, b], out[p, c], out[p, d], out[p, e] = in_a, in_b, in_c, in_d, in_e
    return out


@njit(cache=False)
def _barycentric(transform: Array, x: float, y: float, out: Array) -> None:
    """Barycentric coordinates (3,) in a triangle by its row (3, 2) of Delaunay.transform."""
    x, y = x - transform[2, 0], y - transform[2, 1]
    for k in range(2):
        out[k] = transform[k, 0] * x + transform[k, 1] * y
    out[2] = 1 - (out[0] + out[1])
