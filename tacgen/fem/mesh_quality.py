"""Quality of a mesh: counts, angles, Jacobians, volume."""

from dataclasses import asdict, dataclass

import numpy as np

from tacgen.fem.elements import TET_EDGES, grid_points, integration, jacobians

Array = np.ndarray
# the three neighbours of each corner along edges, right-handed
HEX_CORNER_NEIGHBOURS = np.array(
    [(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)]
)
TET_CORNER_NEIGHBOURS = np.array([(1, 2, 3), (2, 0, 3), (0, 1, 3), (1, 0, 2)])
# the two corners not on each of TET_EDGES
TET_OPPOSITE_CORNERS = np.array([(2, 3), (0, 3), (1, 3), (1, 2), (2, 0), (0, 1)])


@dataclass(frozen=True)
class MeshQuality:
    """Smallest dihedral angle of tets [deg] (None for hexes); smallest scaled Jacobian (1: a cube or a regular tet,
    0: a flat cell) [-]; relative error of the volume [-]."""

    nodes: int
    cells: int
    smallest_dihedral_deg: float | None
    smallest_scaled_jacobian: float
    volume_error: float

    def document(self) -> dict[str, float | int]:
        """The numbers that are known, rounded: the last bits of a sum are noise."""
        return {name: round(v, 6) for name, v in asdict(self).items() if v is not None}


def dihedral(points: Array, tets: Array) -> Array:
    """Angles (e, 6) [rad] between the faces that meet at the straight edges of tets (e, 4 or more)."""
    x = points[tets[:, :4]]
    a, b = x[:, TET_EDGES[:, 0]], x[:, TET_EDGES[:, 1]]
    along = (b - a) / np.maximum(np.linalg.norm(b - a, axis=-1, keepdims=True), 1e-300)
    c, d = (x[:, TET_OPPOSITE_CORNERS[:, k]] - a for k in (0, 1))
    c, d = (v - (v * along).sum(-1, keepdims=True) * along for v in (c, d))
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(c, d), axis=-1), (c * d).sum(-1)))


def scaled_jacobian(points: Array, cells: Array) -> Array:
    """The smallest triple product of unit edges at a cell's corners (e,), at most 1.

    For a quadratic tet the volume is that of its curved map at the worst node: 0 where an edge node inverts it.
    """
    ends = HEX_CORNER_NEIGHBOURS if cells.shape[1] == 8 else TET_CORNER_NEIGHBOURS
    x = np.ascontiguousarray(np.moveaxis(points[cells[:, : len(ends)]], 0, -1))  # cells last: the longest loop
    sides = [x[ends[:, k]] - x for k in range(3)]  # each (corners, 3, e)
    length = np.maximum(np.prod([np.sqrt((side**2).sum(1)) for side in sides], axis=0), 1e-300)
    if len(ends) == 8:
        return np.asarray(((sides[0] * np.cross(sides[1], sides[2], axis=1)).sum(1) / length).min(0))
    return np.asarray(np.sqrt(2) * nodal_volume(points, cells).min(1) / length.max(0))


def nodal_volume(points: Array, tets: Array) -> Array:
    """Determinant of the map from the reference tet at each node (e, a) [mm^3]; for a straight tet six times its
    volume. The map of a curved tet is invertible at nodes where it is positive."""
    _, dN = grid_points(tets.shape[1])
    return np.asarray(np.linalg.det(jacobians(points, tets, dN)))


def measure(points: Array, cells: Array, volume: float) -> MeshQuality:
    """The quality of a mesh whose volume should be `volume` [mm^3]."""
    angle = None if cells.shape[1] == 8 else float(np.degrees(dihedral(points, cells).min()))
    _, dN, parts = integration(cells.shape[1])
    x = np.ascontiguousarray(np.moveaxis(points[cells], 0, -1))  # cells last: the longest loop
    a, b, c = np.moveaxis(np.tensordot(dN, x, (1, 0)), 1, 0)  # columns of dX/dxi, each (q, 3, e)
    meshed = float((a * np.cross(b, c, axis=1)).sum()) / parts
    least = float(scaled_jacobian(points, cells).min())
    return MeshQuality(len(points), len(cells), angle, least, meshed / volume - 1)


def enclosed(vertices: Array, triangles: Array) -> float:
    """Volume inside a closed surface with outward orientation [mm^3]."""
    return float(np.linalg.det(vertices[triangles]).sum() / 6)
