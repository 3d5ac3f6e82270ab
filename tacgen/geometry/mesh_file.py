"""A triangle-mesh file as a solid: read by trimesh, checked, and repaired by trimesh and pymeshlab."""

import importlib.util
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.base import regular_file
from tacgen.base.errors import UserError, why

if TYPE_CHECKING:
    import trimesh

Array = np.ndarray
MAX_MESH_FILE_BYTES = 256 * 2**20  # largest mesh file [bytes]
MAX_PLY_HEADER_BYTES = 100_000  # largest header of a PLY file [bytes]
MAX_TRIANGLES = 2_000_000
MIN_BODY_SIZE, MAX_BODY_SIZE = 1e-9, 1e9  # longest side of a body, in units of its file
# volume of a body over its surface's area and the mesh's size; single precision keeps 1e-7 [-]
MIN_THICKNESS_RATIO = 1e-6
MAX_CRACK_RATIO = 1e-4  # largest width of a crack that is closed, over the diagonal of the bounding box [-]
MAX_HOLE_EDGES = 40  # most edges around a hole that is closed
MAX_REPAIR_AREA_CHANGE = 0.02  # largest relative change of the surface's area by repair [-]


@dataclass(frozen=True, eq=False)
class SolidMesh:
    """A closed triangle mesh: vertices (n, 3) [mm], triangles (m, 3) wound outward; body (m,) numbers its pieces."""

    name: str  # of the file, for messages
    vertices: Array
    triangles: Array
    body: Array


def read(path: Path) -> SolidMesh:
    """The mesh in an STL, OBJ or PLY file, repaired where the repair is unambiguous; bodies that share triangles are
    united there, and cavities filled.

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
    if not MIN_BODY_SIZE < (size := mesh.extents.max()) < MAX_BODY_SIZE:
        raise UserError(f"{path}: is {size:.3g} of its units long: no body is")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    v, faces = np.asarray(mesh.vertices, float), _without_points(np.asarray(mesh.faces, np.int64))
    if not len(faces):
        raise UserError(f"{path}: encloses no volume")
    for vertices, tried in _repairs(v, faces):
        if (found := _bodies(tried)) is not None:
            return _outward(str(path), vertices, *found, size)
    raise UserError(f"{path}: {_fault(v, _once(faces))}")


def _loaded(path: Path) -> "trimesh.Trimesh":
    import trimesh

    try:
        content = regular_file.read_bytes(path, MAX_MESH_FILE_BYTES)
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {why(error)}") from None
    for name, count in re.findall(rb"^element (\w+) (\d+)", content[:MAX_PLY_HEADER_BYTES], re.MULTILINE):
        if len(count) > 9 or int(count) > len(content):
            raise UserError(f"{path}: is cut short: its head says more of {name.decode()} than there is")
    try:
        # from memory, so that no other file that an OBJ file names is opened
        kind = path.suffix[1:].lower()
        mesh: Any = trimesh.load_mesh(io.BytesIO(content), file_type=kind, process=False, skip_materials=True)
        return mesh if isinstance(mesh, trimesh.Trimesh) else mesh.to_mesh()
    except Exception as error:  # trimesh's readers raise many types of errors for a damaged file
        said = f"{path}: is not a mesh that can be read ({type(error).__name__}: {error})"
        raise UserError(said.split("\n")[0]) from None


def _without_points(faces: Array) -> Array:
    """The faces (m, 3) with three different corners."""
    return faces[(np.diff(np.sort(faces, 1), axis=1) > 0).all(1)]


def _areas(vertices: Array, faces: Array) -> Array:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def _repairs(vertices: Array, faces: Array) -> Iterator[tuple[Array, Array]]:
    """Vertices and faces after ever stronger repairs: each face once; without faces between bodies that touch; small
    holes closed; cracks too; by MeshLab."""
    yield vertices, _once(faces)
    faces = _united(faces)
    yield vertices, faces
    area, holes_closed = _areas(vertices, faces).sum(), _filled(vertices, faces)
    if _areas(*holes_closed).sum() >= (1 - MAX_REPAIR_AREA_CHANGE) * area:
        yield holes_closed
    welded = _welded(vertices, faces)
    for repaired in chain([_filled(vertices, welded)], _mended(vertices, welded)):
        if abs(_areas(*repaired).sum() - area) <= MAX_REPAIR_AREA_CHANGE * area:
            yield repaired


def _once(faces: Array) -> Array:
    """The faces, each once."""
    return faces[np.sort(np.unique(np.sort(faces, 1), axis=0, return_index=True)[1])]


def _united(faces: Array) -> Array:
    """The faces without those between bodies that touch; all of them, once, if a sheet of two sides would be lost."""
    once, kept = _once(faces), _cancelled(faces)
    _, edge, _ = _sides(np.concatenate([once, kept]))
    before, after = (np.bincount(part, minlength=edge.max() + 1) for part in np.split(edge, [once.size]))
    return once if ((before == 1) & (after == 0)).any() else kept


def _cancelled(faces: Array) -> Array:
    """Faces without pairs of the same corners that look opposite ways; others once."""
    _, first, group = np.unique(np.sort(faces, 1), axis=0, return_index=True, return_inverse=True)
    others = (faces.argmin(1)[:, None] + [1, 2]) % 3  # the corners after that of the smallest number
    even = np.diff(np.take_along_axis(faces, others, 1))[:, 0] > 0
    net = np.bincount(group.ravel(), np.where(even, 1, -1))
    flip = (net < 0) == even[first]
    kept = np.where(flip[:, None], faces[first][:, ::-1], faces[first])[net != 0]
    return np.asarray(kept[np.argsort(first[net != 0])])


def _filled(vertices: Array, faces: Array) -> tuple[Array, Array]:
    """Vertices and faces with holes of three or four edges closed; a lone triangle is gone with its own closing."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    trimesh.repair.fill_holes(mesh)
    return np.asarray(mesh.vertices, float), _cancelled(np.asarray(mesh.faces, np.int64))


def _welded(vertices: Array, faces: Array) -> Array:
    """The faces after merging vertices closer than MAX_CRACK_RATIO; MeshLab's own filter misses many."""
    from scipy.spatial import cKDTree

    reach = MAX_CRACK_RATIO * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    i, j = cKDTree(vertices).query_pairs(reach, output_type="ndarray").T
    group = connected(i, j, len(vertices))
    _, first = np.unique(group, return_index=True)
    return _without_points(first[group[faces]])


def _mended(vertices: Array, faces: Array) -> Iterator[tuple[Array, Array]]:
    """Vertices and faces with cracks and holes closed and non-manifold triangles removed by MeshLab; nothing where it
    is not installed or fails."""
    try:
        import pymeshlab
    except ImportError:  # an extra: tacgen[repair]
        return

    work = pymeshlab.MeshSet(verbose=False)
    work.add_mesh(pymeshlab.Mesh(vertices, faces))
    try:
        work.meshing_remove_null_faces()
        work.meshing_remove_duplicate_faces()
        work.meshing_repair_non_manifold_edges(method="Remove Faces")
        work.meshing_repair_non_manifold_vertices()
        work.meshing_close_holes(maxholesize=MAX_HOLE_EDGES, selfintersection=False)
    except pymeshlab.PyMeshLabException:
        return
    mended = work.current_mesh()
    yield _filled(mended.vertex_matrix(), _without_points(np.asarray(mended.face_matrix(), np.int64)))


def connected(i: Array, j: Array, n: int) -> Array:
    """Number (n,) of each of n nodes' connected component, where nodes i (k,) and j (k,) are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    return np.asarray(connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)[1])


def _sides(faces: Array) -> tuple[Array, Array, Array]:
    """Edges (e, 2) and, for all sides of all faces (3 m,), from each corner to the next: the edge, and whether the side
    runs along it (1) or against it (-1)."""
    a, b = faces.ravel(), np.roll(faces, -1, 1).ravel()
    n = faces.max() + 1
    keys, edge = np.unique(np.minimum(a, b) * n + np.maximum(a, b), return_inverse=True)
    return np.stack([keys // n, keys % n], 1), edge, np.where(a < b, 1, -1)


def _bodies(faces: Array) -> tuple[Array, Array] | None:
    """Faces (m, 3) wound alike and the number of each one's body (m,); None if they are not closed.

    A surface is closed if as many faces run along each edge one way as the other. Four faces at an edge are two bodies
    that touch, or one that touches itself: a body is what hangs together at edges of two faces, and is closed.
    """
    import igl

    if not len(faces):
        return None
    edges, edge, way = _sides(faces)
    if np.bincount(edge, way).any():
        faces = igl.bfs_orient(faces)[0]
        edges, edge, way = _sides(faces)
        if np.bincount(edge, way).any():
            return None
    m = len(faces)
    face, two = np.repeat(np.arange(m), 3), np.bincount(edge)[edge] == 2
    patch = connected(face[two], m + edge[two], m + len(edges))[face]
    _, at, rim = np.unique(edge * m + patch, return_index=True, return_inverse=True)
    at = at[np.bincount(rim, way) != 0]  # sides at which a patch is open: it is closed by others there
    body = connected(patch[at], m + edge[at], m + len(edges))[patch[::3]]
    return faces, np.unique(body, return_inverse=True)[1]


def _outward(name: str, vertices: Array, faces: Array, body: Array, size: float) -> SolidMesh:
    """The bodies that enclose a volume, wound outward; an enclosed cavity touches nothing, so it is filled.

    Raises:
        UserError: some of the surface encloses no volume.
    """
    area, corners = _areas(vertices, faces), vertices[faces] - vertices[faces[0, 0]]
    volume = np.bincount(body, np.linalg.det(corners) / 6)
    flat = np.abs(volume) < MIN_THICKNESS_RATIO * size * np.bincount(body, area)
    if area[flat[body]].sum() > MAX_REPAIR_AREA_CHANGE * area.sum():
        where = _place(vertices[faces[flat[body]][0]])
        raise UserError(f"{name}: {'' if flat.all() else f'has a part, {where}, that '}encloses no volume")
    faces = np.where(volume[body, None] < 0, faces[:, ::-1], faces)
    parts = []
    for part in np.split(faces[np.argsort(body, kind="stable")], np.cumsum(np.bincount(body))[:-1]):
        used, renamed = np.unique(part, return_inverse=True)
        parts.append((vertices[used], renamed.reshape(-1, 3)))
    return _joined(name, [part for part, no in zip(parts, flat, strict=True) if not no])


def _fault(vertices: Array, faces: Array) -> str:
    """Why faces are not closed, and the place of an edge to blame."""
    edges, edge, _ = _sides(faces)
    shared = np.bincount(edge)
    faults = ("open edge", "", shared == 1), ("edge", " between 3 or more triangles", (shared > 2) & (shared % 2 == 1))
    counts = [f"{n} {what}{'s' * (n > 1)}{of}" for what, of, which in faults if (n := int(which.sum()))]
    if not counts:
        return "its triangles face to both sides; make their normals consistent in a mesh editor first"
    hint = "" if importlib.util.find_spec("pymeshlab") else ", or try pip install 'tacgen[repair]'"
    where = _place(vertices[edges[np.flatnonzero(shared % 2)[0]]])
    return f"is not closed: {', '.join(counts)}, one of them {where}; close it in a mesh editor first{hint}"


def _place(points: Array) -> str:
    return "near x {:.4g}, y {:.4g}, z {:.4g} of the file".format(*points.mean(0))


def _joined(name: str, parts: list[tuple[Array, Array]]) -> SolidMesh:
    offset = np.cumsum([0, *(len(v) for v, _ in parts)])
    triangles = [t + o for (_, t), o in zip(parts, offset, strict=False)]
    body = np.repeat(np.arange(len(parts)), [len(t) for _, t in parts])
    return SolidMesh(name, np.concatenate([v for v, _ in parts]), np.concatenate(triangles), body)
