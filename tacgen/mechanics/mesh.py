"""The mesh of a scene's gel, fine where it can be touched: a tensor grid of hexes, or tets (see tet_mesh)."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product

import numpy as np

from tacgen.base import array_cache
from tacgen.base.errors import UserError
from tacgen.fem.elements import boxes
from tacgen.fem.mesh_quality import dihedral, enclosed, measure, scaled_jacobian
from tacgen.geometry.analytic_sdf import MAX_SDF_SLOPE
from tacgen.geometry.gel import GelBody, SolidGel
from tacgen.geometry.pose import Pose, along, shortest_turn
from tacgen.mechanics import tet_mesh
from tacgen.mechanics.scene import Scene

Array = np.ndarray
# nodes; and the edge asked of fTetWild over that of a hex [-], which returns edges 1.25 to 1.35 times as long
TET_MESHES = {"tet": (10, 1.125), "linear_tet": (4, 0.8)}
MIN_DIHEDRAL_DEG = 2.0  # smallest dihedral angle of a tet [deg]
MIN_SCALED_JACOBIAN = 0.01  # smallest scaled Jacobian of a tet [-]
MAX_HEX_EDGE_RATIO = 11.1  # edge far from the contact over the edge under it [-]
HEX_EDGE_GROWTH = 1.7  # largest ratio of neighbouring edges outside the fine part [-]
FACE_POINTS_PER_EDGE = 3  # points of the face an edge at which the path is looked at
MAX_MESH_NODES = 500_000  # a larger stiffness matrix cannot be factorised in the memory of common machines


@dataclass(frozen=True)
class GelMesh:
    """Arrays with named patches.

    points (n, 3) [mm]; cells (e, a): hexes of 8 nodes, tets of 10 or 4, as VTK numbers them; layer (e,) number of the
    gel layer of each cell, 0 at the base; facets: quads (f, 4) or triangles of 6 or 3 nodes seen from outside, by name:
    "bonded" (held), "coated" (pressed and photographed).
    """

    points: Array
    cells: Array
    layer: Array
    facets: dict[str, Array]


def of(scene: Scene) -> GelMesh:
    """The gel's mesh, fine wherever the scene touches the gel.

    Raises:
        UserError: no mesh of usable cells could be made.
    """
    if scene.element == "hex":
        return build(scene.gel, footprint(scene), scene.edge)
    nodes, edge = TET_MESHES[scene.element]
    made = GelMesh(*tet_mesh.build(scene.gel, touched(scene), edge * scene.edge, nodes))
    angle = float(np.degrees(dihedral(made.points, made.cells).min()))
    least = float(scaled_jacobian(made.points, made.cells).min())
    if angle < MIN_DIHEDRAL_DEG or least < MIN_SCALED_JACOBIAN:
        raise UserError(
            f"gel: its tets are too flat to compute with (smallest angle {angle:.2g} deg, scaled Jacobian {least:.1e}):"
            " the surface has thin walls or sharp folds"
        )
    return made


def quality(gel: GelBody, mesh: GelMesh) -> dict[str, float | int | str]:
    """The quality of a gel's mesh, and its hash."""
    measured = measure(mesh.points, mesh.cells, volume(gel))
    parts = (mesh.points, mesh.cells, mesh.layer, *(a for item in sorted(mesh.facets.items()) for a in item))
    held = {"bonded_share": round(gel.bonded_share, 4)} if isinstance(gel, SolidGel) else {}
    return {**measured.document(), **held, "sha256": array_cache.digest(parts)}


@lru_cache(maxsize=2)
def volume(gel: GelBody) -> float:
    """Volume of a gel [mm^3]; the scenes of a sensor share it, and a grasp has two."""
    vertices, triangles, _ = gel.surface(*tet_mesh.PROJECTED_SURFACE_RATIOS)
    return enclosed(vertices, triangles)


def graded(start: float, end: float, fine: tuple[float, float], edge: float, growth: float, coarsest: float) -> Array:
    """Coordinates from start to end: at most `edge` apart inside `fine`; outside, growing by at most `growth`.

    The intervals on each side are scaled so that the ends are met exactly; a fine part that ends within half an edge of
    an end is extended to it, so that no thin interval remains.
    """
    low, high = max(start, fine[0]), min(end, fine[1])
    low, high = start if low < start + edge / 2 else low, end if high > end - edge / 2 else high
    middle = np.linspace(low, high, max(1, int(np.ceil((high - low) / edge - 1e-9))) + 1)
    if high <= low:
        middle = np.array([np.clip(low, start, end)])

    def side(length: float) -> Array:
        steps = _growing(min(edge * growth, coarsest), length, growth, coarsest)
        return np.cumsum(steps) * (length / sum(steps)) if steps else np.zeros(0)

    below, above = middle[0] - side(middle[0] - start)[::-1], middle[-1] + side(end - middle[-1])
    return np.concatenate([below, middle, above])


def heights(gel: GelBody, edge: float, growth: float, coarsest: float) -> tuple[Array, Array]:
    """Grid heights z from base to face, and the layer of each interval: fine at the face, coarser towards the base;
    each interface is a grid height."""
    z = [0.0]
    layer: list[int] = []
    step = edge
    for number in reversed(range(len(gel.layers))):
        left = gel.layers[number].thickness
        steps = _growing(step, left, growth, coarsest)
        scaled = np.array(steps) * (left / sum(steps))
        step = min(float(scaled[-1]) * growth, coarsest)
        z.extend(z[-1] - np.cumsum(scaled))
        layer.extend([number] * len(steps))
    return np.array(z[::-1]), np.array(layer[::-1], dtype=np.int32)


def _growing(first: float, length: float, growth: float, longest: float) -> list[float]:
    """Steps with a sum of at least `length`, each `growth` times the one before, at most `longest`."""
    steps: list[float] = []
    while sum(steps) < length - 1e-9:
        steps.append(min(steps[-1] * growth, longest) if steps else first)
    return steps


@dataclass(frozen=True)
class Axes:
    """The coordinates [mm] of a tensor grid of hexes before its columns are scaled to the face: x, y, z, and the layer
    of each interval of z; the first and the last node of the fine part along x and along y."""

    x: Array
    y: Array
    z: Array
    layer: Array
    fine_x: tuple[int, int]
    fine_y: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of nodes."""
        return len(self.x), len(self.y), len(self.z)

    def points(self, gel: GelBody) -> Array:
        """Nodes (n, 3) [mm], z fastest; each column is scaled to the local height of the face."""
        points = np.stack(np.meshgrid(self.x, self.y, self.z, indexing="ij"), -1).reshape(-1, 3)
        points[:, 2] += gel.top(points[:, 0], points[:, 1]) * (points[:, 2] + gel.thickness) / gel.thickness
        return points

    def inside(self, gel: GelBody) -> Array:
        """Which columns of cells (x, y) exist: a column whose centre is outside the outline is left out."""
        return gel.contains((self.x[1:] + self.x[:-1])[:, None] / 2, (self.y[1:] + self.y[:-1])[None] / 2)


def axes(gel: GelBody, footprint: tuple[float, float, float, float], edge: float) -> Axes:
    """The grid of `build`, whose arguments these are. Raises UserError: it would have more than MAX_MESH_NODES
    nodes.
    """
    x0, x1, y0, y1 = footprint
    coarsest = MAX_HEX_EDGE_RATIO * edge
    xs = graded(-gel.width / 2, gel.width / 2, (x0, x1), edge, HEX_EDGE_GROWTH, coarsest)
    ys = graded(-gel.height / 2, gel.height / 2, (y0, y1), edge, HEX_EDGE_GROWTH, coarsest)
    zs, layer = heights(gel, 1.3 * edge, 1.1, coarsest / 2)  # maps depend on the width of cells, hardly on their height
    _refuse_above(MAX_MESH_NODES, len(xs) * len(ys) * len(zs), edge, "nodes")
    return Axes(xs, ys, zs, layer, _nearest(xs, x0, x1), _nearest(ys, y0, y1))


def _nearest(at: Array, low: float, high: float) -> tuple[int, int]:
    """The numbers of the coordinates nearest to two places."""
    return int(np.abs(at - low).argmin()), int(np.abs(at - high).argmin())


def build(gel: GelBody, footprint: tuple[float, float, float, float], edge: float) -> GelMesh:
    """Graded hexes for a gel with a flat base; each column of the grid is scaled to the local height of the face.

    Args:
        footprint: x0, x1, y0, y1 [mm] of the region that the trajectory can touch; its cells are `edge` [mm] wide.

    Raises:
        UserError: that would be a mesh of more than MAX_MESH_NODES nodes.
    """
    return on(axes(gel, footprint, edge), gel)


def on(grid: Axes, gel: GelBody) -> GelMesh:
    """The hexes of a grid, without the columns outside the gel."""
    points, inside = grid.points(gel), grid.inside(gel)
    hexes = boxes(np.arange(len(points)).reshape(grid.shape))
    bonded = hexes[inside][:, 0][:, [0, 3, 2, 1]]
    coated = hexes[inside][:, -1][:, [4, 5, 6, 7]]
    cells = hexes[inside].reshape(-1, 8)
    layers = np.tile(grid.layer, int(inside.sum()))
    used, compact = np.unique(cells, return_inverse=True)
    rename = np.full(len(points), -1)
    rename[used] = np.arange(len(used))
    return GelMesh(points[used], compact.reshape(-1, 8), layers, {"bonded": rename[bonded], "coated": rename[coated]})


def _refuse_above(most: float, count: float, edge: float, what: str) -> None:
    if count > most:
        raise UserError(
            f"quality.edge_mm: {edge:g} mm under all that the trajectory touches gives {count:.1g} {what}, and"
            f" {most:.1g} are the most: a larger edge or a shorter way is needed"
        )


def footprint(scene: Scene) -> tuple[float, float, float, float]:
    """x0, x1, y0, y1 [mm] around the region that the scene touches, half an edge more, rounded up to whole edges from
    the start: the cells are symmetric about a press there, wherever the indenter moves next."""
    where, start, edge = touched(scene)[:, :2], scene.start[:2, 3], scene.edge
    low = start - edge * np.ceil((start - where.min(0)) / edge + 0.5)
    high = start + edge * np.ceil((where.max(0) - start) / edge + 0.5)
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def touched(scene: Scene) -> Array:
    """Points (n, 3) of the untouched face that the indenter overlaps on its path, up to a third of an edge apart; below
    its start if there are none.

    A rigid body cuts a wider patch out of the untouched face than it touches of a soft one: this is on the safe side.
    Between frames the path is looked at in steps of half the indenter's thickness: a thin plate is wholly below the
    untouched face where it has been pressed deeper than it is thick.
    """
    gel, step = scene.gel, scene.edge / FACE_POINTS_PER_EDGE
    _refuse_above(60 * MAX_MESH_NODES, gel.width * gel.height / step**2, scene.edge, "points of the face to look at")
    x, y = (np.linspace(-size / 2, size / 2, math.ceil(size / step) + 1) for size in (gel.width, gel.height))
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    z = gel.top(*grid.T)
    face = np.column_stack([grid, z])
    hit = np.zeros(len(face), bool)
    poses = scene.poses
    if scene.forced is not None:
        poses = poses.copy()
        poses[:, 2, 3] -= scene.forced.allowance
    corners = np.array(list(product(x[[0, -1]], y[[0, -1]], (z.min(), z.max()))))  # no point moves more than they do
    before = Pose.of(scene.start).local(corners)
    bound = np.zeros(len(face))  # of the distance, from below: it is evaluated only where this is negative
    for matrix in _dense(scene.start, poses, scene.shape.reach):
        pose = Pose.of(matrix)
        local = pose.local(corners)
        bound -= MAX_SDF_SLOPE * np.linalg.norm(local - before, axis=1).max()
        near = np.flatnonzero(~hit & (bound <= 0))
        bound[near] = scene.shape.value(pose.local(face[near]))
        hit[near[bound[near] < 0]] = True
        before = local
    if hit.any():
        return face[hit]
    start = scene.start[None, :2, 3]
    return np.column_stack([start, gel.top(*start.T)])


def _dense(start: Array, poses: Array, step: float) -> Iterator[Array]:
    """The poses (n, 4, 4), and more between them, at most `step` [mm] of translation apart."""
    for a, b in pairwise([start, *poses]):
        n = max(1, math.ceil(float(np.linalg.norm(b[:3, 3] - a[:3, 3])) / step))
        yield from [b] if n == 1 else along(a, b, shortest_turn(a, b), n)
