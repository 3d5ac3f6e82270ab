"""A triangle-mesh file as a solid: read by trimesh, checked, and repaired by trimesh and pymeshlab."""

import importlib.util
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen import regular_file
from tacgen.errors import UserError, why

if TYPE_CHECKING:
    import trimesh

Array = np.ndarray
MAX_FILE = 256 * 2**20  # largest mesh file [bytes]
MAX_HEAD = 100_000  # largest header of a PLY file [bytes]
MAX_TRIANGLES = 2_000_000
MIN_SIZE, MAX_SIZE = 1e-9, 1e9  # longest side of a body, in units of its file
MIN_TRIANGLES = 4  # of a closed body: a tetrahedron
MAX_CRACK = 1e-4  # largest width of a crack that is closed, over the diagonal of the bounding box [-]
MAX_HOLE = 40  # most edges around a hole that is closed
MAX_NEW_AREA = 0.02  # largest relative change of the surface's area by repair [-]


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
