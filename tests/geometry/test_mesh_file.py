"""Mesh files: read, mended and refused; the shipped objects."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.meshes import ball, box, saved
from helpers.program import loaded

from tacgen.errors import UserError
from tacgen.geometry import mesh_file
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


@pytest.mark.parametrize("make", [cracked, holed])
def test_what_trimesh_cannot_repair_is_repaired_by_meshlab(make: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("pymeshlab")
    path = saved(make(), tmp_path / "torn.stl")
    found = mesh_file.read(path)
    mended = trimesh.Trimesh(found.vertices, found.triangles, process=False)
    assert mended.is_watertight
    assert mended.is_winding_consistent
    assert mended.volume == pytest.approx(ball(3).volume, rel=0.01)
    monkeypatch.setattr(mesh_file, "_repaired", lambda mesh: mesh)
    with pytest.raises(UserError, match=r"is not closed: \d+ "):
        mesh_file.read(path)


def open_ball(tmp_path: Path) -> Path:
    mesh = ball(2)
    mesh.update_faces(mesh.triangles_center[:, 2] < 2)
    return saved(mesh, tmp_path / "open.stl")


def flat(tmp_path: Path) -> Path:
    return saved(box(2, 2, 1e-9), tmp_path / "flat.stl")


def text(name: str, content: bytes):
    def write(tmp_path: Path) -> Path:
        (tmp_path / name).write_bytes(content)
        return tmp_path / name

    return write


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (open_ball, "is not closed: "),
        (open_ball, " open edges; close it in a mesh editor first"),
        (flat, "encloses no volume"),
        (text("a.stl", b""), ": "),
        (text("a.stl", b"solid x\nendsolid x\n"), "holds no triangles"),
        (text("a.ply", b"no mesh"), "is not a mesh that can be read ("),
        (text("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"), "is not a mesh that can be read ("),
        (text("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), "holds vertices that are not numbers"),
        (lambda folder: folder / "none.stl", "No such file"),
    ],
)
def test_what_cannot_be_used_is_reported_in_one_line(make: Any, says: str, tmp_path: Path):
    path = make(tmp_path)
    with pytest.raises(UserError) as caught:
        mesh_file.read(path)
    (line,) = caught.value.lines
    assert line.startswith(str(path))
    assert says in line
    assert "\n" not in line


def test_limits_of_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = saved(ball(2), tmp_path / "ball.stl")
    monkeypatch.setattr(mesh_file, "MAX_TRIANGLES", 100)
    with pytest.raises(UserError, match="has 320 triangles, at most 100"):
        mesh_file.read(path)
    monkeypatch.setattr(mesh_file, "MAX_FILE", 10)
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
