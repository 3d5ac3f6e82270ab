"""Exact distance to the triangles near sharp convex edges and tips of a mesh, which a spline on a grid would round.

The body is opened by a ball: eroded by `radius` (each vertex moves such that its faces move inward by `radius`, a mitre
offset) and offset outward again. So edges have the radius of the contact's range instead of that of the grid, and
distance, normal and curvature are smooth wherever contact acts. In each cell of the grid the triangles are known that
may be closest to its points, so that a distance takes a few triangles.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from scipy import ndimage

from tacgen.geometry.analytic_sdf import Record
from tacgen.geometry.mesh_file import SolidMesh
from tacgen.geometry.sdf_grid import Field
from tacgen.physics.edges import LIST, RADIUS, ROW_NUMBERS, SHARE, listed
from tacgen.physics.runtime import call
from tacgen.physics.splines import CELL, ORIGIN

Array = np.ndarray
MAX_SPLINE_ERROR = 0.05  # error of the spline over the cell, above which edges are computed exactly [-]
EXACT_BAND_CELLS = 2.0  # distance from the surface within which that error matters, over the cell [-]
BLEND_NODES = 2  # nodes by which the exact region is wider: there both distances agree, and one passes into the other
MAX_MITRE = 8.0  # longest mitre over the radius [-]: of an edge of 14 deg
MAX_FLAT_SINE_SQUARED = 1e-3  # square of the sine of an angle of faces, below which they are one flat face [-]
# altitude of a triangle [mm] below which its normal is rounding error, and its neighbours' is taken
MIN_ALTITUDE_MM = 1e-4
HALF_DIAGONAL = np.sqrt(3) / 2  # half the diagonal of a cell over its side


@dataclass(frozen=True, eq=False, kw_only=True)
class SharpField(Field):
    """A field whose sharp convex edges are exact.

    radius [mm] of the edges; share (i, j, k): coefficients of the part of the exact distance, a spline from 0 to 1 on
    the field's nodes; first (i, j, k): number of the list of each cell, -1 without; start (m + 1,) and near: the lists
    of triangles, by body and then by their distance `away` [mm] from the middle of the cell; triangles (t, 10, 3):
    corners a, b, c [mm], outward normals of the face, of its edges ab, bc, ca and of a, b, c; body (t,).
    """

    radius: float
    share: Array
    first: Array
    start: Array
    near: Array
    away: Array
    triangles: Array
    body: Array

    @cached_property
    def record(self) -> Record:
        numbers, values, _ = super().record
        parts = values, self.share.ravel(), self.away, self.triangles.ravel()
        lists = self.first.ravel(), self.start, self.near, self.body
        numbers[0, RADIUS] = self.radius
        numbers[0, SHARE:LIST] = np.cumsum([part.size for part in parts])[:-1]
        numbers[0, LIST:ROW_NUMBERS] = np.cumsum([0, *(part.size for part in lists)])[:-1]
        both = np.concatenate(parts, dtype=float), np.concatenate(lists, dtype=np.int32, casting="unsafe")
        return Record(numbers, *both)


def lists(field: Field, distances: Array, solid: SolidMesh, radius: float) -> tuple[Array, ...]:
    """`share`, `first`, `start`, `near`, `away` and `triangles` of a SharpField; share is empty if no edge is rounded.

    Args:
        distances (i, j, k) [mm]: what the field's coefficients were made from. radius: of the edges [mm].
    """
    at_nodes, origin, cell = field.coefficients, field.origin, field.cell
    for axis in range(3):
        at_nodes = ndimage.correlate1d(at_nodes, np.array([1.0, 4.0, 1.0]) / 6, axis=axis, mode="nearest")
    recedes = (
        (at_nodes - distances > MAX_SPLINE_ERROR * cell)
        & (np.abs(distances) < EXACT_BAND_CELLS * cell)
        & _inner(distances.shape, 2)
    )
    if not recedes.any():
        none = np.zeros(0, np.int32)
        return np.zeros((0, 0, 0), np.float32), none, none, none, none, np.zeros((0, 10, 3))
    share = ndimage.binary_dilation(recedes, np.ones((3, 3, 3)), iterations=BLEND_NODES)
    stencil = ndimage.maximum_filter(share, size=4, origin=-1)  # nodes -1 to 2 of the cell that begins at each node
    cells = np.argwhere(stencil & _inner(share.shape, 1))
    core = _eroded(solid.vertices, solid.triangles, radius)
    table = np.concatenate([core[solid.triangles], _normals(solid.vertices, solid.triangles)], 1)
    far = _farthest(core, solid, origin + (cells + 0.5) * cell)
    reach = far + 2 * HALF_DIAGONAL * cell  # what is closest to a point of the cell is no farther from its middle
    first = np.full(share.shape, -1, np.int32)
    first[tuple(cells.T)] = np.arange(len(cells))
    counts, none = np.zeros(len(cells), np.int32), np.zeros(0, np.int32)
    numbers = np.zeros((1, ROW_NUMBERS))
    numbers[0, ORIGIN : CELL + 1] = *origin, cell
    asked = numbers, table.ravel(), first, reach, float(reach.max())
    call(listed, (1,), *asked, none, counts, none, np.zeros(0))
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    near, away = np.empty(start[-1], np.int32), np.empty(start[-1])
    call(listed, (1,), *asked, start[:-1], np.zeros_like(counts), near, away)
    order = np.lexsort((away, solid.body[near], np.repeat(np.arange(len(counts)), counts)))
    return share.astype(np.float32), first, start, near[order], away[order].astype(np.float32), table


def sharpened(field: Field, known: tuple[Array, ...], radius: float, body: Array) -> Field:
    """The field with the edges of these lists and radius [mm]; itself if there are none. body (t,): of triangles."""
    named: dict[str, Any] = dict(zip(("share", "first", "start", "near", "away", "triangles"), known, strict=True))
    if not named["share"].size:
        return field
    own = {part.name: getattr(field, part.name) for part in fields(field)}
    return SharpField(**own, **named, radius=radius, body=body.astype(np.int32))


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
    # across a flat face alone, across an edge two, at a tip all three
    known = size > MAX_FLAT_SINE_SQUARED * size[:, -1:]
    part = np.where(known, np.einsum("nij,ni->nj", axes, b) / np.where(known, size, 1.0), 0.0)
    step = np.einsum("nij,nj->ni", axes, part)
    length = np.linalg.norm(step, axis=1)
    return np.asarray(vertices + step * np.minimum(1.0, MAX_MITRE * radius / np.maximum(length, 1e-12))[:, None])


def _corners(vertices: Array, triangles: Array) -> tuple[Array, Array, Array]:
    """Unit normals (m, 3) and angles at the corners (m, 3) [rad] of triangles, and whether they are no slivers (m,)."""
    at = vertices[triangles]
    side = np.roll(at, -1, 1) - at
    length = np.linalg.norm(side, axis=2)
    cross = np.cross(side[:, 0], side[:, 1])
    twice = np.linalg.norm(cross, axis=1)
    sound = twice > MIN_ALTITUDE_MM * length.max(1)
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
