"""Triangle-mesh files: reading, checking, repairing and placing a mesh, and its signed distance on a grid.

trimesh reads and repairs files, pymeshlab repairs what trimesh cannot, libigl gives the exact distance to triangles,
signed by angle-weighted pseudonormals (Baerentzen & Aanaes 2005). For 144 000 points and 20 480 triangles libigl takes
1.4 s, trimesh with rtree 190 s; they agree to 6e-14 mm.
"""

import importlib.util
import io
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen import array_cache, regular_file
from tacgen.errors import UserError, why
from tacgen.geometry.sdf_grid import Field

if TYPE_CHECKING:
    import trimesh

Array = np.ndarray
CACHE_VERSION = 2  # of the grids and walls in the cache
MAX_FILE = 256 * 2**20  # largest mesh file [bytes]
MAX_HEAD = 100_000  # largest header of a PLY file [bytes]
MAX_TRIANGLES = 2_000_000
MAX_NODES = 8_000_000  # of a distance grid: 64 MB of spline
MIN_SIZE, MAX_SIZE = 1e-9, 1e9  # longest side of a body, in units of its file
MIN_TRIANGLES = 4  # of a closed body: a tetrahedron
MAX_CRACK = 1e-4  # largest width of a crack that is closed, over the diagonal of the bounding box [-]
MAX_HOLE = 40  # most edges around a hole that is closed
MAX_NEW_AREA = 0.02  # largest relative change of the surface's area by repair [-]
MARGIN_CELLS = 6  # cells of the grid around the body: contact is evaluated no farther away
FINER = (0.7, 0.5, 0.35, 0.25, 0.15, 0.1)  # parts of the edge that are tried for walls too thin for it [-]
MIN_WALL = 3  # thickness of a wall over the grid's cell [-]; forces of thinner ones are 10 to 90 % too low
MAX_THIN = 0.01  # largest share of the surface that may belong to thinner walls
SHARP_ANGLE = np.radians(30)  # angle of triangles at a sharp edge; smaller angles approximate a fillet [rad]


@dataclass(frozen=True, eq=False)
class SolidMesh:
    """A closed triangle mesh: vertices (n, 3) [mm], triangles (m, 3) wound outward; body (m,) numbers its pieces."""

    name: str  # of the file, for messages
    vertices: Array
    triangles: Array
    body: Array


def read(path: Path) -> SolidMesh:
    """The mesh in an STL, OBJ or PLY file, repaired where the repair is unambiguous.

    Raises:
        UserError: not a mesh, empty, too big, with open edges, or without volume.
    """
    mesh = _loaded(path)
    if not len(mesh.faces):
        raise UserError(f"{path}: holds no triangles")
    if len(mesh.faces) > MAX_TRIANGLES:
        raise UserError(f"{path}: has {len(mesh.faces)} triangles, at most {MAX_TRIANGLES} can be; simplify it first")
    if mesh.vertices.shape[1:] != (3,) or mesh.faces.shape[1:] != (3,):
        raise UserError(f"{path}: holds no triangles in space")
    if not np.isfinite(mesh.vertices).all():
        raise UserError(f"{path}: holds vertices that are not numbers")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise UserError(f"{path}: has triangles between vertices that are not there")
    if not MIN_SIZE < mesh.extents.max() < MAX_SIZE:
        raise UserError(f"{path}: is {mesh.extents.max():.3g} of its units long: no body is")
    unclosed = _clean(mesh).copy()
    if not len(unclosed.faces):
        raise UserError(f"{path}: encloses no volume")
    bad = _edges_not_shared_by_two(_close(mesh))
    if bad or len(mesh.split(only_watertight=False)[0].faces) < MIN_TRIANGLES:  # trimesh duplicates a single triangle
        mesh = _repaired(unclosed)
        bad = _edges_not_shared_by_two(mesh)
    if bad:
        hint = "" if importlib.util.find_spec("pymeshlab") else ", or try pip install 'tacgen[repair]'"
        raise UserError(f"{path}: is not closed: {bad}; close it in a mesh editor first{hint}")
    bodies = [body for body in mesh.split(only_watertight=False) if len(body.faces) >= MIN_TRIANGLES]
    volume = sum(abs(float(body.volume)) for body in bodies)
    if not mesh.is_winding_consistent or volume < 1e-6 * float(mesh.extents.max()) ** 3:
        raise UserError(f"{path}: encloses no volume")
    for body in bodies:  # an enclosed cavity touches nothing, so it is filled
        if body.volume < 0:
            body.invert()
    return _joined(str(path), [(np.asarray(b.vertices, float), np.asarray(b.faces)) for b in bodies])


def _loaded(path: Path) -> "trimesh.Trimesh":
    import trimesh

    try:
        content = regular_file.read_bytes(path, MAX_FILE)
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {why(error)}") from None
    for name, count in re.findall(rb"^element (\w+) (\d+)", content[:MAX_HEAD], re.MULTILINE):
        if len(count) > 9 or int(count) > len(content):
            raise UserError(f"{path}: is cut short: its head says more of {name.decode()} than there is")
    try:
        # from memory, so that no other file that an OBJ file names is opened
        kind = path.suffix[1:].lower()
        mesh: Any = trimesh.load_mesh(io.BytesIO(content), file_type=kind, process=False, skip_materials=True)
        return mesh if isinstance(mesh, trimesh.Trimesh) else mesh.to_mesh()
    except Exception as error:  # trimesh's readers raise many types of errors for a damaged file
        raise UserError(
            f"{path}: is not a mesh that can be read ({type(error).__name__}: {error})".split("\n")[0]
        ) from None


def _clean(mesh: Any) -> Any:
    """Merge equal vertices, remove degenerate and duplicate triangles."""
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.update_faces(mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    return mesh


def _close(mesh: Any) -> Any:
    """Close holes of three or four edges and make the orientation consistent."""
    from trimesh import repair

    if not mesh.is_watertight:
        repair.fill_holes(mesh)
    if not mesh.is_winding_consistent:
        repair.fix_winding(mesh)  # type: ignore[no-untyped-call]
    return mesh


def _repaired(mesh: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """The mesh repaired by MeshLab: cracks and small holes closed, non-manifold triangles removed. Unchanged if MeshLab
    is not installed, fails, or changes the surface's area too much."""
    try:
        import pymeshlab
    except ImportError:  # an extra: tacgen[repair]
        return mesh
    import trimesh

    work = pymeshlab.MeshSet(verbose=False)
    work.add_mesh(pymeshlab.Mesh(mesh.vertices, _welded(mesh)))
    try:
        work.meshing_remove_null_faces()
        work.meshing_remove_duplicate_faces()
        work.meshing_repair_non_manifold_edges(method="Remove Faces")
        work.meshing_repair_non_manifold_vertices()
        work.meshing_close_holes(maxholesize=MAX_HOLE, selfintersection=False)
    except pymeshlab.PyMeshLabException:
        return mesh
    mended = work.current_mesh()
    repaired = _close(_clean(trimesh.Trimesh(mended.vertex_matrix(), mended.face_matrix(), process=False)))
    return repaired if abs(repaired.area - mesh.area) <= MAX_NEW_AREA * mesh.area else mesh


def _welded(mesh: "trimesh.Trimesh") -> Array:
    """The faces after merging vertices closer than MAX_CRACK; MeshLab's own filter misses many."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    n = len(mesh.vertices)
    reach = MAX_CRACK * float(np.linalg.norm(mesh.extents))
    i, j = cKDTree(mesh.vertices).query_pairs(reach, output_type="ndarray").T
    _, group = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)
    _, first = np.unique(group, return_index=True)
    faces = first[group[mesh.faces]]
    return np.asarray(faces[(np.diff(np.sort(faces, 1), axis=1) > 0).all(1)])


def _edges_not_shared_by_two(mesh: "trimesh.Trimesh") -> str:
    _, shared = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    counts = []
    if (shared == 1).any():
        counts.append(f"{int((shared == 1).sum())} open edges")
    if (shared > 2).any():
        counts.append(f"{int((shared > 2).sum())} edges between more than two triangles")
    return ", ".join(counts)


def _joined(name: str, parts: list[tuple[Array, Array]]) -> SolidMesh:
    offset = np.cumsum([0, *(len(v) for v, _ in parts)])
    triangles = [t + o for (_, t), o in zip(parts, offset, strict=False)]
    body = np.repeat(np.arange(len(parts)), [len(t) for _, t in parts])
    return SolidMesh(name, np.concatenate([v for v, _ in parts]), np.concatenate(triangles), body)


def placed(solid: SolidMesh, *, up: str = "+z", scale: float = 1.0, size: float | None = None) -> SolidMesh:
    """The solid as an indenter: the file's axis `up` along z, lowest point at z = 0, box centred on the z axis.

    Args:
        scale: mm per unit of the file. size: length of the longest side [mm], instead of scale.
    """
    v, origin, scale = _turned(solid, up, scale, size)
    return SolidMesh(solid.name, (v - origin) * scale, solid.triangles, solid.body)


def _turned(solid: SolidMesh, up: str, scale: float, size: float | None) -> tuple[Array, list[float], float]:
    """Vertices (n, 3) with the axis `up` along z, in units of the file; the indenter's origin there; the scale."""
    after, signs = _upright(up)
    v = solid.vertices[:, after] * signs
    low, high = v.min(0), v.max(0)
    return v, [*((low + high) / 2)[:2], low[2]], size / (high - low).max() if size else scale


def _upright(up: str) -> tuple[list[int], list[int]]:
    """The file's axes that become x, y and z, cyclic, so right-handed; and their signs."""
    axis, sign = "xyz".index(up[1]), 1 if up[0] == "+" else -1
    return [(axis + 1) % 3, (axis + 2) % 3, axis], [1, sign, sign]


def placement(solid: SolidMesh, *, up: str = "+z", scale: float = 1.0, size: float | None = None) -> Array:
    """Pose (4, 4) [mm] of the indenter that `placed` makes of a solid, in the file's frame scaled to mm."""
    _, origin, scale = _turned(solid, up, scale, size)
    (after, signs), pose = _upright(up), np.eye(4)
    pose[:3, :3] = np.eye(3)[:, after] * signs
    pose[:3, 3] = pose[:3, :3] @ origin * scale
    return pose


def signed_distance(solid: SolidMesh, points: Array) -> Array:
    """Signed distance (n,) [mm] of points (n, 3) from a solid, negative inside; of several bodies the smallest."""
    import igl

    sign = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    out = np.full(len(points), np.inf)
    for number in range(int(solid.body.max()) + 1):
        used, renamed = np.unique(solid.triangles[solid.body == number], return_inverse=True)
        vertices, faces = np.ascontiguousarray(solid.vertices[used]), renamed.reshape(-1, 3)
        out = np.minimum(out, igl.signed_distance(np.ascontiguousarray(points), vertices, faces, sign_type=sign)[0])
    return out


def sizes(path: Path, up: str, scale: float) -> tuple[float, float, float]:
    """Sides of the bounding box [mm] of a placed solid; cached until the file changes."""
    state = path.stat()
    return _sizes(path, up, scale, state.st_mtime_ns, state.st_size)


@cache
def _sizes(path: Path, up: str, scale: float, *_: int) -> tuple[float, float, float]:
    x, y, z = np.ptp(placed(read(path), up=up, scale=scale).vertices, axis=0)
    return float(x), float(y), float(z)


def field(solid: SolidMesh, *, cell: float, height: float, half: float) -> Field:
    """Signed distance of a placed solid as a spline.

    Args:
        cell: spacing of the grid [mm]; smaller for thin bodies, larger if there would be more than MAX_NODES nodes.
        height: largest height of the gel above the lowest point [mm].
        half: largest distance of the gel from the z axis [mm].

    Raises:
        UserError: a surface that cuts through itself.
    """
    low, high = solid.vertices.min(0), solid.vertices.max(0)
    a = np.maximum(low - MARGIN_CELLS * cell, [-half, -half, -np.inf])
    b = np.minimum(high + MARGIN_CELLS * cell, [half, half, height])
    cell = min(cell, float((high - low).min()) / 6)
    cell = max(cell, float((np.prod(b - a) / MAX_NODES) ** (1 / 3)))
    nodes = np.ceil((b - a) / cell).astype(int) + 5  # two more on each side for the spline
    origin = a - 2 * cell
    asked = (solid, origin, cell, tuple(int(n) for n in nodes))
    key = array_cache.digest((CACHE_VERSION, *asked[1:], solid.vertices, solid.triangles, solid.body))
    distances = array_cache.kept_one("distances", key, lambda: _distances(*asked))
    from scipy.spatial import ConvexHull

    radius = max(smallest_radius(solid, height), 2 * cell)  # the field rounds edges by two cells
    corners = solid.vertices[ConvexHull(solid.vertices).vertices]
    surface = solid.vertices, solid.triangles
    return Field.through(distances, origin, cell, smallest_radius=radius, corners=corners, surface=surface, blunt=True)


def refuse_thin_walls(solid: SolidMesh, cell: float, height: float, edge: float) -> None:
    """Raise UserError if a grid with this cell [mm], of a gel with this `edge` [mm], would lose walls of the solid
    below `height` [mm]: where MIN_WALL cells inward of the surface is outside again."""

    def thin(part: float) -> bool:
        thickness = MIN_WALL * cell * part
        key = array_cache.digest((CACHE_VERSION, thickness, height, solid.vertices, solid.triangles))
        share = array_cache.kept_one("walls", key, lambda: np.array(_thin_share(solid, thickness, height)))
        return bool(share > MAX_THIN)

    if not thin(1.0):
        return
    fine = next((part for part in FINER if not thin(part)), None)
    advice = f"ask for a finer mesh, as in quality: {{edge_mm: {edge * fine:.2g}}}" if fine else "make them thicker"
    text = f"has walls thinner than {MIN_WALL * cell:.2g} mm, too thin for this quality: {advice}"
    raise UserError(f"{solid.name}: {text}")


def _thin_share(solid: SolidMesh, thickness: float, height: float) -> float:
    """Share of the surface below `height` [mm] from which `thickness` [mm] inward is outside again; from 10 000
    triangles at most."""
    a, b, c = (solid.vertices[solid.triangles[:, k]] for k in range(3))
    middle, normal = (a + b + c) / 3, np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    some = np.flatnonzero((np.minimum(a, np.minimum(b, c))[:, 2] < height) & (area > 0))
    some = some[:: 1 + len(some) // 10_000]
    inward = middle[some] - thickness * normal[some] / area[some, None]
    thin = area[some] @ ~inside(solid.vertices, solid.triangles, inward)
    return float(thin / area[some].sum()) if len(some) else 0.0


def smallest_radius(solid: SolidMesh, height: float) -> float:
    """The 1 % quantile of the radii of curvature [mm] at convex edges below `height`; 0 for sharp edges.

    Exact for the strips of triangles of CAD fillets, up to 1.5 times too large for equilateral triangles.
    """
    import trimesh

    mesh = trimesh.Trimesh(solid.vertices, solid.triangles, process=False)
    angle = mesh.face_adjacency_angles
    low = mesh.vertices[mesh.face_adjacency_edges][:, :, 2].min(1) < height
    convex = low & mesh.face_adjacency_convex & (angle > 1e-3)
    if not convex.any():
        return float(np.inf)
    across = mesh.face_adjacency_span[convex] / 2  # about the distance between the centres of two triangles
    return round(float(np.quantile(np.where(angle[convex] > SHARP_ANGLE, 0.0, across / angle[convex]), 0.01)), 4)


def _distances(solid: SolidMesh, origin: Array, cell: float, nodes: tuple[int, ...]) -> Array:
    """Signed distance (i, j, k) [mm] in single precision, slab by slab; of several bodies the smallest.

    Raises:
        UserError: a surface that cuts through itself.
    """
    import igl

    sign = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    x, y, z = (origin[a] + cell * np.arange(nodes[a]) for a in range(3))
    out = np.full(nodes, np.inf, dtype=np.float32)
    bodies = [np.ascontiguousarray(solid.triangles[solid.body == b]) for b in range(int(solid.body.max()) + 1)]
    rows = max(1, 200_000 // (nodes[1] * nodes[2]))
    for triangles in bodies:
        used, renamed = np.unique(triangles, return_inverse=True)
        vertices, faces = np.ascontiguousarray(solid.vertices[used]), renamed.reshape(-1, 3)
        for start in range(0, nodes[0], rows):
            part = np.stack(np.meshgrid(x[start : start + rows], y, z, indexing="ij"), -1)
            d = igl.signed_distance(part.reshape(-1, 3), vertices, faces, sign_type=sign)[0]
            block = out[start : start + rows]
            np.minimum(block, d.reshape(block.shape).astype(np.float32), out=block)
    steepest = max(float(np.abs(np.diff(out, axis=a)).max()) for a in range(3))
    if steepest > 1.01 * cell:  # impossible for a distance: inside and outside are wrong somewhere
        raise UserError(f"{solid.name}: its surface cuts through itself; unite its parts in a mesh editor first")
    return out


def above(vertices: Array, triangles: Array, xy: Array) -> tuple[Array, Array]:
    """Height (n,) [mm] at xy (n, 2) of a surface that is a graph over the plane, and distance (n,) [mm] of xy from its
    outline; outside, the height is that of the nearest point."""
    import igl

    flat = vertices * [1.0, 1.0, 0.0]
    points = np.column_stack([xy, np.zeros(len(xy))])
    squared, which, near = igl.point_mesh_squared_distance(points, flat, triangles.astype(np.int64))
    a, b, c = (vertices[triangles[which, k]] for k in range(3))
    n = np.cross(b - a, c - a)
    return a[:, 2] - ((near - a)[:, :2] * n[:, :2]).sum(1) / n[:, 2], np.sqrt(squared)


def inside(vertices: Array, triangles: Array, points: Array) -> Array:
    """Whether points (n, 3) lie inside a closed surface with outward orientation."""
    import igl

    number = igl.winding_number(np.ascontiguousarray(vertices, float), triangles.astype(np.int64), points)
    return np.asarray(number > 0.5)


def nearest(vertices: Array, triangles: Array, points: Array) -> Array:
    """The points (n, 3) of a surface that are closest to `points` (n, 3)."""
    import igl

    ours = np.ascontiguousarray(points, float), np.ascontiguousarray(vertices, float), triangles.astype(np.int64)
    return np.asarray(igl.point_mesh_squared_distance(*ours)[2])
