"""The pad of FElupe's player: its mesh, its symmetries and its face, by FElupe and scipy."""

from typing import Any

import numpy as np
from scipy import sparse

from benchmarks.referee.case import PAD_MM, POISSONS, YOUNGS_MPA, Array, Case

# Small elements as far as these places along x and y [mm], and their sizes as parts of the edge asked for.
FINE_MM = {"ball": (2.2, 2.2), "punch": (3.3, 3.3), "edge": (1.2, 4.2), "ring": (4.0, 4.0)}
SIZES = {"ball": (1.0, 1.0), "punch": (0.6, 0.6), "edge": (0.4, 1.2), "ring": (0.6, 0.6)}
UNDER, GROWTH, LARGEST = 0.6, 1.3, 1.6  # height of the first elements and largest size, as parts of the edge; growth
TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # by 90 degrees about z
TOP, NEAR_MM = [4, 5, 6, 7, 12, 13, 14, 15], 1e-9  # nodes of the upper face of a hex of 20; of a plane


def axis(reach: float, size: float, end: float, largest: float) -> Array:
    """Coordinates from 0 to `end` [mm], in steps of this size as far as `reach`, then growing to the largest."""
    at = list(np.linspace(0, reach, max(round(reach / size), 1) + 1))
    while end - at[-1] > 2.2 * (at[-1] - at[-2]):
        at.append(at[-1] + min(GROWTH * (at[-1] - at[-2]), largest))
    return np.array([*at, end])


class Pad:
    """The part of the pad that a case's symmetries leave: points (n, 3) [mm]; field and solid of FElupe; displacements
    (3n, m) of those that are free, and (3q, 3n) at the q points of Gauss of the face, of `area` (q,) [mm^2] each."""

    def __init__(self, case: Case, edge: float, points: int) -> None:
        import felupe as fem

        self.turned = "yaw" in case.moved  # a quarter of a turn changes nothing
        self.mirrors = [
            k for k, ways in enumerate(({"x", "tilt_y", "yaw"}, {"y", "tilt_x", "yaw"})) if not ways & case.moved
        ]
        slid, along = (max(pose.x for pose in case.poses), 0.0), []
        for k in (0, 1):
            reach, size, end = FINE_MM[case.shape][k], edge * SIZES[case.shape][k], PAD_MM[k] / 2
            half = np.zeros(0) if k in self.mirrors or self.turned else -axis(reach, size, end, LARGEST * edge)[:0:-1]
            along.append(np.concatenate([half, axis(reach + slid[k], size, end, LARGEST * edge)]))
        deep = -axis(UNDER * edge, UNDER * edge, PAD_MM[2], LARGEST * edge)[::-1]
        mesh = fem.mesh.Grid(*along, deep).add_midpoints_edges()
        self.points = x = mesh.points
        region = fem.RegionQuadraticHexahedron(mesh, quadrature=fem.GaussLegendre(points - 1, 3))
        self.field = fem.FieldContainer([fem.Field(region, dim=3)])
        law = fem.NeoHooke(YOUNGS_MPA / 2 / (1 + POISSONS), YOUNGS_MPA / 3 / (1 - 2 * POISSONS))
        self.solid = fem.SolidBody(law, self.field)
        top = mesh.cells[:, TOP]
        top = top[abs(x[top][..., 2]).max(1) < NEAR_MM]
        rule = fem.GaussLegendre(2, 2)
        parts = np.array([fem.element.QuadraticQuad().function(point) for point in rule.points])
        sides = (x[top[:, 2]] - x[top[:, 0]])[:, :2]
        self.area = (np.prod(sides, 1)[:, None] / 4 * rule.weights).ravel()
        places = np.repeat(np.arange(len(self.area)), 8), np.repeat(top[:, None], len(parts), 1).ravel()
        at = sparse.csr_matrix((np.tile(parts.ravel(), len(top)), places), (len(self.area), len(x)))
        self.at, self.face = sparse.kron(at, sparse.eye(3), format="csr"), np.unique(top)
        self.free = self._free(x)

    def _free(self, x: Array) -> Any:
        held = np.repeat(x[:, 2:] < NEAR_MM - PAD_MM[2], 3, 1)
        for k in self.mirrors:
            held[:, k] |= abs(x[:, k]) < NEAR_MM
        all_, near = sparse.eye(3 * len(x), format="lil"), abs(x[:, :2]) < NEAR_MM
        if self.turned:
            held[near.all(1), :2] = True
            ends = (np.flatnonzero(near[:, k] & ~near[:, 1 - k]) for k in (0, 1))  # of the planes
            ends = (nodes[np.lexsort(x[nodes][:, [1 - k, 2]].round(6).T)] for k, nodes in enumerate(ends))
            for node, other in zip(*ends, strict=True):
                all_[3 * node : 3 * node + 3, 3 * other : 3 * other + 3] = TURN
                held[node] = True
        return all_.tocsc()[:, np.flatnonzero(~held.ravel())].tocsr()

    def whole(self, points: Array, vectors: Array) -> tuple[Array, Array]:
        """Points and vectors (n, 3) of the whole pad from those of its part."""
        copies = [np.linalg.matrix_power(TURN, k) for k in range(4 if self.turned else 1)]
        for k in self.mirrors:
            copies += [np.diag(np.where(np.arange(3) == k, -1.0, 1.0)) @ one for one in copies]
        return np.concatenate([points @ c.T for c in copies]), np.concatenate([vectors @ c.T for c in copies])
