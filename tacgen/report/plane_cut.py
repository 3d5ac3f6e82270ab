"""The boundary of a solid mesh, and its intersection with a plane, with interpolated values."""

import numpy as np

from tacgen.mechanics.tet_mesh import TET_FACES

Array = np.ndarray
# six tetrahedra of a hex, around its diagonal 0-6; of a quadratic tetrahedron, its corners
CELL_TETS = {8: [[0, 1, 2, 6], [0, 1, 5, 6], [0, 4, 5, 6], [0, 4, 7, 6], [0, 3, 7, 6], [0, 3, 2, 6]], 4: [[0, 1, 2, 3]]}

HEX_FACES = np.array([(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)])


def boundary(cells: Array) -> Array:
    """The facets (f, 4 or 3) of cells (e, 8, 4 or 10) that belong to one cell only, as corner nodes."""
    facets = cells[:, HEX_FACES if cells.shape[1] == 8 else TET_FACES]
    facets = facets.reshape(-1, facets.shape[2])
    _, first, count = np.unique(np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(facets[first[count == 1]])


def cut(points: Array, cells: Array, values: Array, y: float) -> tuple[Array, Array]:
    """Intersection of a plane of constant `y` with cells (e, 8, 4 or 10) of points (n, 3), with values (n, c) there.

    Cells are divided into tetrahedra with straight edges. Returns triangles (t, 3, 2) in x and z, and values at their
    corners (t, 3, c), sorted by area: large triangles are drawn last and cover slivers.
    """
    corners = CELL_TETS[8 if cells.shape[1] == 8 else 4]
    tets = np.concatenate([cells[:, four] for four in corners])
    side = points[tets, 1] - y
    count = (side > 0).sum(1)
    pieces = []
    for above in (1, 3):  # one corner on one side of the plane: a triangle
        order = np.argsort(side[count == above] * (1 if above == 3 else -1), axis=1)
        lone = np.take_along_axis(tets[count == above], order, 1)
        pieces.append([(lone[:, 0], lone[:, k]) for k in (1, 2, 3)])
    order = np.argsort(side[count == 2], axis=1)  # two corners on each side: a quadrilateral
    a, b, c, d = np.take_along_axis(tets[count == 2], order, 1).T
    pieces += [[(a, c), (a, d), (b, d)], [(a, c), (b, d), (b, c)]]
    flat, carried = [], []
    for triangle in pieces:
        for low, high in triangle:
            s = points[low, 1] - y
            part = (s / (s - (points[high, 1] - y)))[:, None]
            flat.append((points[low] + part * (points[high] - points[low]))[:, [0, 2]])
            carried.append(values[low] + part * (values[high] - values[low]))
    within, values_there = _stacked(flat), _stacked(carried)
    order = np.abs(np.linalg.det(within[:, 1:] - within[:, :1])).argsort()
    return within[order], values_there[order]


def _stacked(parts: list[Array]) -> Array:
    """Triangles (t, 3, c) from their corners, three consecutive parts for each block of triangles."""
    return np.concatenate([np.stack(parts[k : k + 3], 1) for k in range(0, len(parts), 3)])


def outline(corners: Array) -> Array:
    """The sides (l, 2, 2) of triangles (t, 3, 2) that belong to one triangle only."""
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    _, number = np.unique(sides.reshape(-1, 2).round(7), axis=0, return_inverse=True)
    ends = np.sort(number.reshape(-1, 2), axis=1)
    _, first, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
    return np.asarray(sides[first[(count == 1)]])


def crossed(points: Array, triangles: Array, y: float) -> Array:
    """Intersection of triangles (t, 3) of points (n, 3) with a plane of constant `y`: lines (l, 2, 2) in x and z."""
    corners = points[triangles]
    side = corners[..., 1] - y
    here = (side > 0).any(1) & (side <= 0).any(1)
    corners, side = corners[here], side[here]
    lone = np.argmax((side > 0) == ((side > 0).sum(1) == 1)[:, None], axis=1)
    take = (lone[:, None] + np.arange(3)) % 3
    corners, side = np.take_along_axis(corners, take[..., None], 1), np.take_along_axis(side, take, 1)
    part = side[:, :1] / (side[:, :1] - side[:, 1:])
    return np.asarray((corners[:, :1] + part[..., None] * (corners[:, 1:] - corners[:, :1]))[..., [0, 2]])
