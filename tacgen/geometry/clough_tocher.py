"""Smooth interpolation over a triangulation by matrices that are made once, since it is linear in the nodal values.

On each triangle a cubic in three pieces, C1 throughout (Clough & Tocher 1965; slopes across edges as in SciPy's
CloughTocher2DInterpolator). The nodes' slopes are those of the least curvature along the edges (Nielson 1983).
"""

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.compiled import njit

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = np.ndarray


class CloughTocher:
    """Values at points (s, 2) to values between them; nothing is made before it is asked for."""

    def __init__(self, points: Array) -> None:
        self._points = points
        self._kept: dict[int, tuple[Array, csr_array]] = {}

    @cached_property
    def _plan(self) -> Any:
        from scipy.spatial import Delaunay

        return Delaunay(self._points)

    @cached_property
    def _slopes(self) -> "tuple[Any, csr_array]":
        from scipy.sparse.linalg import splu

        bending, pull = _least_curvature(self._points, *self._plan.vertex_neighbor_vertices)
        return splu(bending), pull

    def nodal(self, values: Array) -> Array:
        """Values (s, c) at the points and, below, their slopes along x and y by turns: (3s, c)."""
        bending, pull = self._slopes
        return np.concatenate([values, bending.solve(pull @ values)])

    def at(self, xy: Array, nodal: Array) -> Array:
        """Values (n, c) at xy (n, 2), nan outside the points' hull.

        The matrix for an array that cannot be written to is kept.
        """
        if xy.flags.writeable:
            return np.asarray(self._matrix(xy) @ nodal)
        if id(xy) not in self._kept:
            self._kept[id(xy)] = xy, self._matrix(xy)
        return np.asarray(self._kept[id(xy)][1] @ nodal)

    def _matrix(self, xy: Array) -> "csr_array":
        """What takes nodal values and slopes (3s,) to values (n,) at xy (n, 2)."""
        from scipy.sparse import csr_array

        plan, number = self._plan, self._plan.find_simplex(xy)
        map_, nodes, beside = plan.transform[number], plan.simplices[number], plan.neighbors[number]
        points = np.concatenate([xy[:, None], plan.points[plan.simplices[beside]].mean(2)], 1)
        first = np.einsum("nij,nkj->nki", map_[:, :2], points - map_[:, None, 2])
        barycentric = np.concatenate([first, 1 - first.sum(2, keepdims=True)], 2)
        values = _weights(plan.points[nodes], barycentric[:, 0], barycentric[:, 1:], beside >= 0)
        values[number < 0] = np.nan
        count = len(plan.points)
        columns = np.concatenate([nodes, count + 2 * np.repeat(nodes, 2, axis=1) + [0, 1] * 3], 1)
        return csr_array((values.ravel(), columns.ravel(), 9 * np.arange(len(xy) + 1)), shape=(len(xy), 3 * count))


def _least_curvature(points: Array, start: Array, beside: Array) -> "tuple[csr_array, csr_array]":
    """K (2s, 2s) and P (2s, s): the slopes g with K g = P f bend the edges least.

    A cubic over an edge of length L that rises by r, with slopes a and b times L at its ends, bends by
    4 (a^2 + ab + b^2 - 3r (a + b) + 3r^2) / L^3.
    """
    from scipy.sparse import csc_array, csr_array

    s, m = len(points), len(beside)
    own = np.repeat(np.arange(s), np.diff(start))  # each edge from both of its ends
    way = points[beside] - points[own]

    def along(node: Array, ways: Array) -> csr_array:
        columns = (2 * node[:, None] + [0, 1]).ravel()
        return csr_array((ways.ravel(), columns, 2 * np.arange(m + 1)), shape=(m, 2 * s))

    pull = along(own, way / np.linalg.norm(way, axis=1, keepdims=True) ** 3).T
    rise = csr_array((np.tile([1.0, -1.0], m), np.stack([beside, own], 1).ravel(), 2 * np.arange(m + 1)), shape=(m, s))
    return csc_array(pull @ (2 * along(own, way) + along(beside, way))), 3 * pull @ rise


@njit(cache=True)
def _weights(corners: Array, at: Array, middles: Array, shared: Array) -> Array:
    """Weights (n, 9) of a triangle's three values, and of their slopes along x and y by turns.

    Args:
        corners: of each point's triangle, (n, 3, 2).
        at: barycentric coordinates of the point, (n, 3).
        middles: those of the centroids of the triangles across from each corner (n, 3, 3), where there is one: shared
            (n, 3).
    """
    out, turn, b = np.empty((len(at), 9)), np.empty(3), np.empty(3)
    value, inner, across, toward = np.empty(3), np.empty(3), np.empty(3), np.empty((3, 3))  # Bezier ordinates
    for p in range(len(at)):
        c = min(at[p, 0], at[p, 1], at[p, 2])  # in the piece whose corners are the other two and the centroid
        for k in range(3):
            b[k] = at[p, k] - c
        c *= 3
        for k in range(3):
            i, j = middles[p, k, (k + 1) % 3], middles[p, k, (k + 2) % 3]
            turn[k] = (2 * j + i - 1) / (2 - 3 * (i + j)) if shared[p, k] else -0.5
        for m in range(9):
            for i in range(3):
                value[i] = 1.0 if m == i else 0.0
                for j in range(3):
                    slope = (corners[p, j, (m - 3) % 2] - corners[p, i, (m - 3) % 2]) / 3
                    toward[i, j] = value[i] + (slope if m >= 3 and (m - 3) // 2 == i else 0.0)
                inner[i] = (value[i] + toward[i, (i + 1) % 3] + toward[i, (i + 2) % 3]) / 3
            for k in range(3):
                i, j = (k + 1) % 3, (k + 2) % 3
                bend = turn[k] * (3 * (toward[i, j] - toward[j, i]) + value[j] - value[i])
                across[k] = (bend - value[i] + 2 * toward[i, j] - toward[j, i] + inner[i] + inner[j]) / 2
            whole = inner[0] + inner[1] + inner[2] + 2 * (across[0] + across[1] + across[2])
            out[p, m] = c**3 * whole / 9
            for k in range(3):
                i, j = (k + 1) % 3, (k + 2) % 3
                out[p, m] += b[k] ** 3 * value[k]
                out[p, m] += 3 * b[k] ** 2 * (b[i] * toward[k, i] + b[j] * toward[k, j] + c * inner[k])
                out[p, m] += c**2 * b[k] * (inner[k] + across[i] + across[j]) + 6 * c * b[i] * b[j] * across[k]
    return out
