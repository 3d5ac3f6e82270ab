"""Exact distance to the triangles near sharp convex edges and tips of a mesh, which a spline on a grid would round.

The body is opened by a ball: eroded by `radius` (each vertex moves such that its faces move inward by `radius`, a mitre
offset) and offset outward again. So edges have the radius of the contact's range instead of that of the grid, and
distance, normal and curvature are smooth wherever contact acts. In each cell of the grid the triangles are known that
may be closest to its points, so that a distance takes a few triangles.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from tacgen.compiled import njit
from tacgen.geometry.mesh_file import SolidMesh
from tacgen.geometry.sdf_grid import Field, spline_weights

Array = np.ndarray
OFF = 0.05  # error of the spline over the cell, above which edges are computed exactly [-]
NEAR = 2.0  # distance from the surface within which that error matters, over the cell [-]
BLEND = 2  # nodes by which the exact region is wider: there both distances agree, and one passes into the other
LONGEST = 8.0  # longest mitre over the radius [-]: of an edge of 14 deg
FLAT = 1e-3  # square of the sine of an angle of faces, below which they are one flat face [-]
SLIVER = 1e-4  # altitude of a triangle [mm] below which its normal is rounding error, and its neighbours' is taken
CELLS = np.sqrt(3) / 2  # half the diagonal of a cell over its side
MOST = 16  # distances that are about as small at one point
ON_CORE = 1e-9  # distance from the core [mm] within which its direction is rounding error


@dataclass(frozen=True, eq=False, kw_only=True)
class SharpField(Field):
    """A field whose sharp convex edges are exact.

    radius [mm] of the edges; share (i, j, k): coefficients of the part of the exact distance, a spline from 0 to 1 on
    the field's nodes; first (i, j, k): number of the list of each cell, -1 without; start (m + 1,) and near: the lists
    of triangles; triangles (t, 10, 3): corners a, b, c [mm], outward normals of the face, of its edges ab, bc, ca and
    of a, b, c; body (t,).
    """

    radius: float
    share: Array
    first: Array
    start: Array
    near: Array
    triangles: Array
    body: Array

    def distance(self, p: Array) -> tuple[Array, Array, Array]:
        d, g, H = super().distance(p)
        lists = self.first, self.start, self.near, self.triangles, self.body
        _correct(np.ascontiguousarray(p, float), self.origin, self.cell, self.radius, self.share, *lists, d, g, H)
        return d, g, H


def lists(field: Field, distances: Array, solid: SolidMesh, radius: float) -> tuple[Array, ...]:
    """`share`, `first`, `start`, `near` and `triangles` of a SharpField; share is empty if the spline rounds no edge.

    Args:
        distances (i, j, k) [mm]: what the field's coefficients were made from. radius: of the edges [mm].
    """
    at_nodes, origin, cell = field.coefficients, field.origin, field.cell
    for axis in range(3):
        at_nodes = ndimage.correlate1d(at_nodes, np.array([1.0, 4.0, 1.0]) / 6, axis=axis, mode="nearest")
    recedes = (at_nodes - distances > OFF * cell) & (np.abs(distances) < NEAR * cell) & _inner(distances.shape, 2)
    if not recedes.any():
        none = np.zeros(0, np.int32)
        return np.zeros((0, 0, 0), np.float32), none, none, none, np.zeros((0, 10, 3))
    share = ndimage.binary_dilation(recedes, np.ones((3, 3, 3)), iterations=BLEND)
    stencil = ndimage.maximum_filter(share, size=4, origin=-1)  # nodes -1 to 2 of the cell that begins at each node
    cells = np.argwhere(stencil & _inner(share.shape, 1))
    core = _eroded(solid.vertices, solid.triangles, radius)
    table = np.concatenate([core[solid.triangles], _normals(solid.vertices, solid.triangles)], 1)
    far = _farthest(core, solid, origin + (cells + 0.5) * cell)
    reach = far + 2 * CELLS * cell  # what is closest to a point of the cell is no farther from its middle
    first = np.full(share.shape, -1, np.int32)
    first[tuple(cells.T)] = np.arange(len(cells))
    asked = table, first, origin, cell, reach
    start = np.concatenate([[0], np.cumsum(_listed(*asked, np.zeros(0, np.int64), np.zeros(0, np.int32)))])
    near = np.empty(start[-1], np.int32)
    _listed(*asked, start[:-1].copy(), near)
    return share.astype(np.float32), first, start, near, table


def sharpened(field: Field, known: tuple[Array, ...], radius: float, body: Array) -> Field:
    """The field with the edges of these lists and radius [mm]; itself if there are none. body (t,): of triangles."""
    share, first, start, near, triangles = known
    if not share.size:
        return field
    return SharpField(
        **vars(field),
        radius=radius,
        share=share,
        first=first,
        start=start,
        near=near,
        triangles=triangles,
        body=body.astype(np.int32),
    )


def _inner(shape: tuple[int, ...], rim: int) -> Array:
    """Whether nodes (i, j, k) are not among the first `rim` of an axis, nor among the last rim + 1."""
    inner = np.zeros(shape, bool)
    inner[(slice(rim, -rim - 1),) * 3] = True
    return inner


def _farthest(core: Array, solid: SolidMesh, points: Array) -> Array:
    """Distance (n,) [mm] of points (n, 3) from that body whose surface is farthest."""
    import igl

    squared = np.zeros(len(points))
    for number in range(int(solid.body.max()) + 1):
        faces = solid.triangles[solid.body == number].astype(np.int64)
        squared = np.maximum(squared, igl.point_mesh_squared_distance(points, core, faces)[0])
    return np.sqrt(squared)


def _eroded(vertices: Array, triangles: Array, radius: float) -> Array:
    """Vertices (n, 3) moved such that the faces around each move inward by `radius`, by least squares."""
    normal, angle, _ = _corners(vertices, triangles)
    A, b = np.zeros((len(vertices), 3, 3)), np.zeros((len(vertices), 3))
    for k in range(3):
        weighted = angle[:, k, None] * normal
        np.add.at(A, triangles[:, k], weighted[:, :, None] * normal[:, None])
        np.add.at(b, triangles[:, k], -radius * weighted)
    size, axes = np.linalg.eigh(A)
    known = size > FLAT * size[:, -1:]  # across a flat face alone, across an edge two, at a tip all three
    part = np.where(known, np.einsum("nij,ni->nj", axes, b) / np.where(known, size, 1.0), 0.0)
    step = np.einsum("nij,nj->ni", axes, part)
    length = np.linalg.norm(step, axis=1)
    return np.asarray(vertices + step * np.minimum(1.0, LONGEST * radius / np.maximum(length, 1e-12))[:, None])


def _corners(vertices: Array, triangles: Array) -> tuple[Array, Array, Array]:
    """Unit normals (m, 3) and angles at the corners (m, 3) [rad] of triangles, and whether they are no slivers (m,)."""
    at = vertices[triangles]
    side = np.roll(at, -1, 1) - at
    length = np.linalg.norm(side, axis=2)
    cross = np.cross(side[:, 0], side[:, 1])
    twice = np.linalg.norm(cross, axis=1)
    sound = twice > SLIVER * length.max(1)
    unit = side / np.maximum(length, 1e-300)[..., None]
    angle = np.arccos(np.clip(-(unit * np.roll(unit, 1, 1)).sum(2), -1, 1)) * sound[:, None]
    return cross / np.maximum(twice, 1e-300)[:, None], angle, sound


def _normals(vertices: Array, triangles: Array) -> Array:
    """Outward normals (m, 7, 3), not of length 1, of faces, edges and vertices, for the sign of the distance.

    Source: Baerentzen & Aanaes (2005), angle-weighted pseudonormals. A sliver's normal is that of its vertices.
    """
    normal, angle, sound = _corners(vertices, triangles)
    at_vertex = np.zeros((len(vertices), 3))
    for k in range(3):
        np.add.at(at_vertex, triangles[:, k], angle[:, k, None] * normal)
    around = at_vertex[triangles].sum(1)
    around /= np.maximum(np.linalg.norm(around, axis=1), 1e-300)[:, None]
    normal = np.where(sound[:, None], normal, around)
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, 1)], -1).reshape(-1, 2), 1)
    _, number = np.unique(ends, axis=0, return_inverse=True)
    at_edge = np.zeros((number.max() + 1, 3))
    np.add.at(at_edge, number.ravel(), np.repeat(normal, 3, 0))
    return np.concatenate([normal[:, None], at_edge[number.reshape(-1, 3)], at_vertex[triangles]], 1)


@njit(cache=False)
def _closest(t: Array, x: float, y: float, z: float, out: Array) -> int:
    """Closest point, into out (3,), of a triangle t (10, 3) to (x, y, z), and the row of t with the normal there: 3 of
    the face, 4 5 6 of edges, 7 8 9 of corners. Source: Ericson (2005), Real-Time Collision Detection, 5.1.5."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    q = (x, y, z)
    for i in range(3):
        ab, ac = t[1, i] - t[0, i], t[2, i] - t[0, i]
        d1 += ab * (q[i] - t[0, i])
        d2 += ac * (q[i] - t[0, i])
        d3 += ab * (q[i] - t[1, i])
        d4 += ac * (q[i] - t[1, i])
        d5 += ab * (q[i] - t[2, i])
        d6 += ac * (q[i] - t[2, i])
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if d1 <= 0 and d2 <= 0:
        row, v, w = 7, 0.0, 0.0
    elif d3 >= 0 and d4 <= d3:
        row, v, w = 8, 1.0, 0.0
    elif d6 >= 0 and d5 <= d6:
        row, v, w = 9, 0.0, 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        row, v, w = 4, d1 / (d1 - d3), 0.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        row, v, w = 6, 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        row, v = 5, 1 - w
    else:
        row, v, w = 3, vb / (va + vb + vc), vc / (va + vb + vc)
    for i in range(3):
        out[i] = t[0, i] + v * (t[1, i] - t[0, i]) + w * (t[2, i] - t[0, i])
    return row


@njit(cache=True)
def _listed(table: Array, first: Array, origin: Array, cell: float, reach: Array, place: Array, near: Array) -> Array:
    """Number (m,) of triangles no farther from the middle of each cell than its `reach` (m,) [mm]; with `place` (m,),
    where the lists begin, they are written to `near`."""
    counts = np.zeros(len(reach), np.int64)
    most, at = reach.max(), np.empty(3)
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for t in range(len(table)):
        for a in range(3):
            lower = min(table[t, 0, a], table[t, 1, a], table[t, 2, a]) - most
            upper = max(table[t, 0, a], table[t, 1, a], table[t, 2, a]) + most
            low[a] = max(0, int(np.floor((lower - origin[a]) / cell - 0.5)))
            high[a] = min(first.shape[a] - 1, int(np.ceil((upper - origin[a]) / cell - 0.5)))
        for i in range(low[0], high[0] + 1):
            x = origin[0] + (i + 0.5) * cell
            for j in range(low[1], high[1] + 1):
                y = origin[1] + (j + 0.5) * cell
                for k in range(low[2], high[2] + 1):
                    number = first[i, j, k]
                    if number < 0:
                        continue
                    z = origin[2] + (k + 0.5) * cell
                    _closest(table[t], x, y, z, at)
                    if (at[0] - x) ** 2 + (at[1] - y) ** 2 + (at[2] - z) ** 2 > reach[number] ** 2:
                        continue
                    if len(place):
                        near[place[number] + counts[number]] = t
                    counts[number] += 1
    return counts


@njit(cache=False)
def _bend(t: Array, row: int, n: Array, length: float, D: Array) -> None:
    """Hessian D (3, 3) of the distance from the point of triangle t that `row` names, `length` away along n (3,)."""
    D[:] = 0.0
    if row == 3:
        return
    edge = np.zeros(3)
    if row < 7:  # along an edge there is no curvature
        edge[:] = t[(row - 3) % 3] - t[row - 4]
        edge /= np.sqrt((edge**2).sum())
    for a in range(3):
        for b in range(3):
            D[a, b] = ((a == b) - n[a] * n[b] - edge[a] * edge[b]) / length


@njit(cache=False)
def _is_lowest(t: Array, row: int, n: Array) -> bool:
    """Whether the point of triangle t that `row` names, from which n (3,) leads to a point outside, is closest to that
    of all the surface around it. A corner is taken for one that is not."""
    if row > 6 or n[0] * t[row, 0] + n[1] * t[row, 1] + n[2] * t[row, 2] <= 0:
        return False
    if row == 3:
        return True
    edge, beyond = t[(row - 3) % 3] - t[row - 4], t[row] - t[3] / np.sqrt((t[3] ** 2).sum())  # the other face's normal
    # the edge runs against that face's orientation, so its cross product points from the edge into the face
    inward = (
        n[0] * (edge[1] * beyond[2] - edge[2] * beyond[1])
        + n[1] * (edge[2] * beyond[0] - edge[0] * beyond[2])
        + n[2] * (edge[0] * beyond[1] - edge[1] * beyond[0])
    )
    return bool(inward <= 0.0)


@njit(cache=False)
def _exact(
    table: Array, body: Array, near: Array, x: float, y: float, z: float, radius: float, n: Array, D: Array
) -> float:
    """Smallest distance from the opened bodies at a point; its gradient, into n (3,), and Hessian, into D (3, 3)."""
    at, squared, length = np.empty(3), np.inf, np.inf
    c, best, which, row = np.empty(3), np.empty(3), near[0], 3
    t, found = near[0], 3
    for m in range(len(near)):
        one = _closest(table[near[m]], x, y, z, at)
        away = (at[0] - x) ** 2 + (at[1] - y) ** 2 + (at[2] - z) ** 2
        if away < squared:
            squared, t, found = away, near[m], one
            c[:] = at
        if m + 1 < len(near) and body[near[m + 1]] == body[near[m]]:
            continue
        outward = (x - c[0]) * table[t, found, 0] + (y - c[1]) * table[t, found, 1] + (z - c[2]) * table[t, found, 2]
        signed = np.sqrt(squared) if outward >= 0 else -np.sqrt(squared)
        if signed < length:
            length, which, row = signed, t, found
            best[:] = c
        squared = np.inf
    n[0], n[1], n[2] = x - best[0], y - best[1], z - best[2]
    D[:] = 0.0
    if abs(length) < ON_CORE:  # the direction outward
        n[:] = table[which, row] / np.sqrt((table[which, row] ** 2).sum())
        return length - radius
    n /= length
    _bend(table[which], row, n, length, D)
    if length > 0:
        return _rounded(table, near, x, y, z, radius, best, n, D, length) - radius
    return length - radius


@njit(cache=False)
def _rounded(
    table: Array, near: Array, x: float, y: float, z: float, radius: float, best: Array, n: Array, D: Array, low: float
) -> float:
    """The smallest distance `low`, gradient n and Hessian D where others are nearly as small, above a crease: the
    normal would jump from one face to the other. Each other distance that is lowest on its part of the surface, larger
    by u < k, lowers it by

        (k - u)^3 / (6 k^2),    k = radius (1 - cosine of the angle between the normals),

    which is C2, and zero where a face ends at the crease (there u >= k).
    """
    at, m, E, v, slope = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(3)
    first, bend, out = n.copy(), D.copy(), low
    known = np.empty((MOST, 3))
    known[0] = best
    count = 1
    for t in near:
        row = _closest(table[t], x, y, z, at)
        m[0], m[1], m[2] = x - at[0], y - at[1], z - at[2]
        length = np.sqrt((m**2).sum())
        if length > low + 2 * radius or count == MOST:
            continue
        m /= length
        k = radius * (1 - (first * m).sum())
        u = length - low
        if u >= k or not _is_lowest(table[t], row, m):
            continue
        again = False
        for i in range(count):
            again |= ((known[i] - at) ** 2).sum() < ON_CORE**2
        if again:  # an edge of two triangles
            continue
        known[count] = at
        count += 1
        _bend(table[t], row, m, length, E)
        part = (k - u) / k
        out -= k * part**3 / 6
        for a in range(3):
            slope[a] = 0.0
            for b in range(3):
                slope[a] -= radius * (bend[a, b] * m[b] + E[a, b] * first[b])
        v[:] = m - first - (u / k) * slope
        n += part**2 / 2 * (m - first) - (part**2 / 2 - part**3 / 3) * slope
        for a in range(3):
            for b in range(3):
                D[a, b] += part**2 / 2 * (E[a, b] - bend[a, b]) - part / k * v[a] * v[b]
    return out


@njit(cache=True)
def _correct(
    p: Array, origin: Array, cell: float, radius: float, share: Array, first: Array, start: Array, near: Array,
    table: Array, body: Array, d: Array, g: Array, H: Array,
) -> None:  # fmt: skip
    w, n, D = np.empty((3, 3, 4)), np.empty(3), np.empty((3, 3))
    s, S, index = np.empty(3), np.empty((3, 3)), np.empty(3, np.int64)
    for m in range(len(p)):
        inner = True
        for a in range(3):
            x = (p[m, a] - origin[a]) / cell
            inner &= 1.0 <= x <= first.shape[a] - 2.0
            index[a] = min(int(x), first.shape[a] - 3) if inner else 0
            if inner:
                spline_weights(x - index[a], w[a])
        number = first[index[0], index[1], index[2]] if inner else -1
        if number < 0:
            continue
        part = 0.0
        s[:], S[:] = 0.0, 0.0
        for i in range(4):
            for j in range(4):
                for k in range(4):
                    q = share[index[0] - 1 + i, index[1] - 1 + j, index[2] - 1 + k]
                    if q == 0:
                        continue
                    x0, y0, z0 = w[0, 0, i], w[1, 0, j], w[2, 0, k]
                    x1, y1, z1 = w[0, 1, i], w[1, 1, j], w[2, 1, k]
                    part += q * x0 * y0 * z0
                    s[0] += q * x1 * y0 * z0
                    s[1] += q * x0 * y1 * z0
                    s[2] += q * x0 * y0 * z1
                    S[0, 0] += q * w[0, 2, i] * y0 * z0
                    S[1, 1] += q * x0 * w[1, 2, j] * z0
                    S[2, 2] += q * x0 * y0 * w[2, 2, k]
                    S[0, 1] += q * x1 * y1 * z0
                    S[0, 2] += q * x1 * y0 * z1
                    S[1, 2] += q * x0 * y1 * z1
        some = near[start[number] : start[number + 1]]
        exact = _exact(table, body, some, p[m, 0], p[m, 1], p[m, 2], radius, n, D)
        more = exact - d[m]
        S[1, 0], S[2, 0], S[2, 1] = S[0, 1], S[0, 2], S[1, 2]
        for a in range(3):
            for b in range(3):
                cross = s[a] * (n[b] - g[m, b]) + s[b] * (n[a] - g[m, a])
                H[m, a, b] += part * (D[a, b] - H[m, a, b]) + cross / cell + more * S[a, b] / cell**2
        for a in range(3):
            g[m, a] += part * (n[a] - g[m, a]) + more * s[a] / cell
        d[m] += part * more
