"""Smooth interpolation over a triangulation, as matrices that are computed once: it is linear in the nodal values.

Each triangle has a cubic in three pieces; the whole is C1 (Clough & Tocher 1965; slopes across edges as in SciPy's
CloughTocher2DInterpolator). The nodal slopes minimise the curvature along the edges (Nielson 1983).
"""

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.physics import interpolation, runtime

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

    @cached_property
    def _ordinates(self) -> Array:
        """Bezier ordinates of the triangles, see interpolation.ordinates."""
        plan, out = self._plan, np.empty(self._plan.simplices.size * 45)
        around = plan.points, plan.simplices, plan.neighbors, plan.transform.reshape(-1, 2)
        runtime.call(interpolation.ordinates, (len(out) // interpolation.MAX_ORDINATES,), *around, out)
        return out

    def nodal(self, values: Array) -> Array:
        """Values (s, c) at the points, followed by their slopes, alternately along x and y: (3s, c)."""
        bending, pull = self._slopes
        return np.concatenate([values, bending.solve(pull @ values)])

    def at(self, xy: Array, nodal: Array) -> Array:
        """Values (n, c) at xy (n, 2), nan outside the points' convex hull. The matrix of a read-only xy is cached."""
        if not xy.flags.writeable and id(xy) not in self._kept:
            self._kept[id(xy)] = xy, self._matrix(xy)
        matrix = self._matrix(xy) if xy.flags.writeable else self._kept[id(xy)][1]
        out, count = np.empty((len(xy), nodal.shape[1])), nodal.shape[1]
        runtime.call(interpolation.weighted, (len(xy),), *matrix, nodal.reshape(-1), count, out.reshape(-1))
        return out

    def _matrix(self, xy: Array) -> tuple[Array, Array]:
        """The matrix from nodal values and slopes (3s,) to values (n,) at xy (n, 2): weights and columns, both
        (9n,)."""
        plan, out, columns = self._plan, np.empty(9 * len(xy)), np.empty(9 * len(xy), np.int32)
        triangles = len(self._points), plan.simplices, plan.transform.reshape(-1, 2), self._ordinates
        runtime.call(interpolation.cubic_weights, (len(xy),), xy, plan.find_simplex(xy), *triangles, out, columns)
        return out, columns


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
