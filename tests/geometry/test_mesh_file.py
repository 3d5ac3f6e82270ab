"""Mesh files: read, mended and refused; the shipped objects."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.meshes import ball, box, cells, saved
from helpers.needs import needs
from helpers.program import loaded

from tacgen.base.errors import UserError
from tacgen.geometry import mesh_file, mesh_import
from tacgen.recipe import assets


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_formats(suffix: str, tmp_path: Path):
    found = mesh_file.read(saved(box(2, 3, 4), tmp_path / f"box.{suffix}"))
    assert len(found.vertices) == 8
    assert np.ptp(found.vertices, axis=0) == pytest.approx([2, 3, 4])


def test_small_damage_is_repaired(tmp_path: Path):
    holed = box(2, 2, 2)
    holed.update_faces(np.arange(12) != 3)
    assert len(mesh_file.read(saved(holed, tmp_path / "holed.stl")).triangles) == 12
    inverted = box(2, 2, 2)
    inverted.invert()
    found = mesh_file.read(saved(inverted, tmp_path / "inverted.stl"))
    assert trimesh.Trimesh(found.vertices, found.triangles).volume == pytest.approx(8)
    half = box(2, 2, 2)
    half.faces[:5] = half.faces[:5, ::-1]
    found = mesh_file.read(saved(half, tmp_path / "half.stl"))
    assert trimesh.Trimesh(found.vertices, found.triangles).volume == pytest.approx(8)


def cracked() -> trimesh.Trimesh:
    """A ball whose triangles have corners of their own, none quite where its neighbour's is."""
    whole = ball(3)
    loose = whole.vertices[whole.faces].reshape(-1, 3)
    loose += np.random.default_rng(0).uniform(-1e-5, 1e-5, loose.shape)
    return trimesh.Trimesh(loose, np.arange(len(loose)).reshape(-1, 3), process=False)


def holed() -> trimesh.Trimesh:
    """A ball with a hole of six edges, and a triangle that hangs off an edge."""
    mesh = ball(3)
    mesh.update_faces(~(mesh.faces == mesh.faces[500, 0]).any(1))
    mesh.remove_unreferenced_vertices()
    flag = np.array([*mesh.faces[10, :2], len(mesh.vertices)])
    outside = mesh.triangles_center[10] * 1.2
    return trimesh.Trimesh([*mesh.vertices, outside], [*mesh.faces, flag], process=False)


def test_what_trimesh_cannot_repair_is_repaired_by_meshlab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    needs("pymeshlab")
    path = saved(holed(), tmp_path / "torn.stl")
    found = mesh_file.read(path)
    assert_whole(found, ball(3).volume)
    monkeypatch.setattr(mesh_file, "_mended", lambda *mesh: iter([]))
    with pytest.raises(UserError, match=r"is not closed: \d+ "):
        mesh_file.read(path)


def test_cracks_are_closed_without_meshlab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(mesh_file, "_mended", lambda *mesh: iter([]))
    assert_whole(mesh_file.read(saved(cracked(), tmp_path / "torn.stl")), ball(3).volume)


def test_a_corner_within_a_neighbours_edge_opens_nothing(tmp_path: Path):
    needs("pymeshlab")
    whole = box(2, 2, 2)
    a, b, c = whole.faces[0]
    corners = [*whole.vertices, whole.vertices[[a, b]].mean(0)]
    split = trimesh.Trimesh(corners, [[a, 8, c], [8, b, c], *whole.faces[1:]], process=False)
    assert_whole(mesh_file.read(saved(split, tmp_path / "box.stl")), 8)


def assert_whole(found: mesh_file.SolidMesh, volume: float) -> None:
    mended = trimesh.Trimesh(found.vertices, found.triangles, process=False)
    assert mended.is_watertight
    assert mended.is_winding_consistent
    assert mended.volume == pytest.approx(volume, rel=0.01)


# -- bodies that touch --

ALL = tuple(np.ndindex(2, 2, 2))
TOUCHING: dict[str, tuple[Any, bool, int]] = {  # cells, whether with the walls between them, number of bodies
    "at a corner": ([(0, 0, 0), (1, 1, 1)], False, 2),
    "at an edge": ([(0, 0, 0), (1, 1, 0)], False, 2),
    "at a face": ([(0, 0, 0), (1, 0, 0)], True, 1),
    "at all faces": (ALL, True, 1),
    "itself at an edge": ([(0, 0, 0), (1, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1)], False, 1),
}


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("name", TOUCHING)
def test_bodies_that_touch(name: str, flipped: bool, tmp_path: Path):
    """Edges of four triangles, and walls that two bodies share: what is a cube is inside, and nothing else is."""
    cubes, walls, bodies = TOUCHING[name]
    mesh = cells(*cubes, walls=walls)
    if flipped and not walls:  # which of two walls is whose is then unknown
        mesh.faces[::3] = mesh.faces[::3, ::-1]
    found = mesh_file.read(saved(mesh, tmp_path / "cells.stl"))
    assert found.body.max() + 1 == bodies
    assert trimesh.Trimesh(found.vertices, found.triangles, process=False).volume == pytest.approx(len(cubes))
    around = np.array(list(np.ndindex(4, 4, 4))) - 1
    inside = [tuple(cube) in set(cubes) for cube in around]
    distance = mesh_import.signed_distance(found, around + 0.5)
    assert (distance < 0).tolist() == inside
    assert np.abs(distance).min() == pytest.approx(0.5)
    if name == "at all faces":
        assert mesh_import.signed_distance(found, np.ones((1, 3))) == pytest.approx(-1)


def test_bodies_apart_and_cavities(tmp_path: Path):
    other, cavity = box(1, 1, 1), box(1, 1, 1)
    other.apply_translation([4, 0, 0])
    other.invert()
    cavity.invert()
    found = mesh_file.read(saved(trimesh.util.concatenate([box(2, 2, 2), other, cavity]), tmp_path / "three.stl"))
    assert found.body.max() == 2
    distance = mesh_import.signed_distance(found, np.array([[0, 0, 0], [4, 0, 0], [2.5, 0, 0.0]]))
    assert distance == pytest.approx([-1, -0.5, 1.0])


def test_a_surface_of_two_sides_given_twice_is_one(tmp_path: Path):
    whole, sheet = box(2, 2, 2), np.array([[3, 0, 0], [5, 0, 0], [5, 2, 0], [3, 2, 0.0]])
    double = trimesh.Trimesh(whole.vertices, [*whole.faces, *whole.faces[:, ::-1]], process=False)
    assert_whole(mesh_file.read(saved(double, tmp_path / "double.stl")), 8)
    fin = trimesh.Trimesh(sheet, [[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]], process=False)
    with pytest.raises(UserError, match=r"is not closed: 4 open edges, one of them near x \d\S*, y \d"):
        mesh_file.read(saved(trimesh.util.concatenate([whole, fin]), tmp_path / "fin.stl"))


def test_a_needle_is_a_body(tmp_path: Path):
    assert mesh_file.read(saved(box(0.02, 0.02, 50), tmp_path / "needle.stl")).body.max() == 0


def bottle() -> trimesh.Trimesh:
    """A Klein bottle, the turned figure of eight: closed, and without an inside."""
    n, m = 30, 16
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b = 2 * np.pi * i / n, 2 * np.pi * (j + 0.5) / m
    r = 2 + np.cos(a / 2) * np.sin(b) - np.sin(a / 2) * np.sin(2 * b)
    z = np.sin(a / 2) * np.sin(b) + np.cos(a / 2) * np.sin(2 * b)
    number = np.arange(n * m).reshape(n, m)
    number = np.concatenate([number, number[:1, ::-1]])
    number = np.concatenate([number, number[:, :1]], 1)
    corners = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    p, q, s, t = (corner.ravel() for corner in corners)
    points = np.stack([r * np.cos(a), r * np.sin(a), z], -1).reshape(-1, 3)
    return trimesh.Trimesh(points, [*np.stack([p, q, s], 1), *np.stack([p, s, t], 1)], process=False)


def open_with_flag() -> trimesh.Trimesh:
    """Open edges around a large hole, and 2 and an edge of three triangles where one triangle hangs off the surface;
    MeshLab takes that one away."""
    mesh = ball(3)
    mesh.update_faces(mesh.triangles_center[:, 2] < 1)
    flag = [*mesh.faces[10, :2], len(mesh.vertices)]
    return trimesh.Trimesh([*mesh.vertices, mesh.triangles_center[10] * 1.2], [*mesh.faces, flag], process=False)


def open_ball() -> trimesh.Trimesh:
    mesh = ball(2)
    mesh.update_faces(mesh.triangles_center[:, 2] < 2)
    return mesh


@pytest.mark.parametrize(
    ("made", "says"),
    [
        # of the file, not of its repair
        (open_with_flag, "is not closed: 46 open edges, 1 edge between 3 or more triangles, one of them near x "),
        (bottle, "its triangles face to both sides; make their normals consistent in a mesh editor first"),
        (lambda: trimesh.util.concatenate([box(1, 1, 1), box(2, 1e-9, 2)]), "has a part, near x "),
        (open_ball, "; close it in a mesh editor first"),
        (lambda: box(2, 2, 1e-9), "encloses no volume"),
        (("a.stl", b""), ": "),
        (("a.stl", b"solid x\nendsolid x\n"), "holds no triangles"),
        (("a.ply", b"no mesh"), "is not a mesh that can be read ("),
        (("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"), "is not a mesh that can be read ("),
        (("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), "holds vertices that are not numbers"),
        (("a.stl", None), "No such file"),
    ],
)
def test_what_cannot_be_used_is_reported_in_one_line(made: Any, says: str, tmp_path: Path):
    name, content = made if isinstance(made, tuple) else ("bad.obj", made().export(file_type="obj").encode())
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError) as caught:
        mesh_file.read(tmp_path / name)
    (line,) = caught.value.lines
    assert line.startswith(str(tmp_path / name))
    assert says in line


def test_limits_of_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = saved(ball(2), tmp_path / "ball.stl")
    monkeypatch.setattr(mesh_file, "MAX_TRIANGLES", 100)
    with pytest.raises(UserError, match="has 320 triangles, at most 100"):
        mesh_file.read(path)
    monkeypatch.setattr(mesh_file, "MAX_MESH_FILE_BYTES", 10)
    with pytest.raises(UserError, match="cannot be read: 0 MB, at most 0 can be read"):
        mesh_file.read(path)


# -- shipped objects --


@pytest.mark.parametrize("name", assets.list_objects())
def test_shipped_objects_are_what_the_script_makes(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    script = loaded(Path(__file__).parents[2] / "scripts" / "make_objects.py")
    monkeypatch.setattr(script, "ROOT", tmp_path)
    shipped = assets.mesh_path(name)
    made, kept = (trimesh.load_mesh(path).triangles for path in (script.write(name), shipped))
    assert made == pytest.approx(kept, abs=1e-6)  # sines differ in the last bit from one machine to the next
    assert shipped.stat().st_size < 200_000
    solid = mesh_file.read(shipped)
    assert solid.body.max() == 0
    assert np.ptp(solid.vertices, axis=0).max() < 15
    readme = (shipped.parent / "README.md").read_text()
    assert "Apache-2.0" in readme
    assert "make_objects.py" in readme
    extents = " x ".join(f"{size:.1f}" for size in np.ptp(solid.vertices, axis=0))
    assert extents in readme
