"""Mesh files: read, mended, refused and turned; distances against closed forms; the cache; recipes with meshes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.needs import needs
from helpers.program import loaded

from tacgen.errors import UserError
from tacgen.geometry import mesh_import
from tacgen.geometry.mesh_import import SolidMesh
from tacgen.recipe import assets, plan, scene_of_row

Array = np.ndarray


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TACGEN_CACHE_DIR", str(tmp_path / "cache"))


def saved(mesh: Any, path: Path) -> Path:
    mesh.export(path)
    return path


def solid_of(mesh: trimesh.Trimesh) -> SolidMesh:
    return SolidMesh("test", np.asarray(mesh.vertices), np.asarray(mesh.faces), np.zeros(len(mesh.faces), int))


def ball(subdivisions: int = 5) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=4.0)


def box(*size: float) -> trimesh.Trimesh:
    return trimesh.creation.box(size)


def field(mesh: trimesh.Trimesh, cell: float, height: float = 1.5) -> Any:
    return mesh_import.field(mesh_import.placed(solid_of(mesh)), cell=cell, height=height, half=30.0)


def test_distance_to_a_fine_ball():
    """The triangles cut at most 1.2 um off; the spline adds less."""
    found = field(ball(), 0.15)
    rng = np.random.default_rng(0)
    a, b = np.arccos(rng.uniform(0.75, 1, 3000)), rng.uniform(0, 2 * np.pi, 3000)
    n = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), -np.cos(a)], 1)
    off = rng.uniform(-0.05, 0.05, 3000)
    d, g, _ = found.distance(n * (4 + off)[:, None] + [0, 0, 4])
    assert 0.1e-3 < np.abs(d - off).max() < 3e-3
    assert np.abs(g - n).max() < 0.02
    assert 3.8 < found.smallest_radius < 6.2  # 1.5 times too large where triangles are equilateral
    assert found.support(np.array([0, 0, -1.0])) == pytest.approx(0.0, abs=1e-9)
    assert found.support(np.array([1.0, 0, 0])) == pytest.approx(4.0, rel=1e-3)


def test_distance_to_a_block():
    """Faces are exact six cells off the edges, which are rounded by two."""
    found = field(box(6, 6, 4), 0.1)
    rng = np.random.default_rng(1)
    p = np.column_stack([rng.uniform(-2.4, 2.4, (2000, 2)), rng.uniform(-0.2, 0.1, 2000)])
    assert found.distance(p)[0] == pytest.approx(-p[:, 2], abs=1e-6)
    side = np.column_stack([rng.uniform(2.9, 3.2, 500), rng.uniform(-2, 2, 500), rng.uniform(0.4, 0.9, 500)])
    assert found.distance(side)[0] == pytest.approx(side[:, 0] - 3, abs=1e-3)
    assert found.smallest_radius == pytest.approx(0.2)  # sharp: two cells, what the grid makes of it
    edge = found.distance(np.array([[3.0, 0.0, 0.0]]))[0][0]
    assert 0.02 < edge < 0.15  # the rounded edge lies inside the sharp one


def test_a_wall_thinner_than_the_cell_gets_a_finer_grid():
    assert field(box(6, 6, 0.3), 0.15).cell == pytest.approx(0.05)


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_formats(suffix: str, tmp_path: Path):
    found = mesh_import.read(saved(box(2, 3, 4), tmp_path / f"box.{suffix}"))
    assert len(found.vertices) == 8
    assert np.ptp(found.vertices, axis=0) == pytest.approx([2, 3, 4])


def test_small_damage_is_repaired(tmp_path: Path):
    holed = box(2, 2, 2)
    holed.update_faces(np.arange(12) != 3)
    assert len(mesh_import.read(saved(holed, tmp_path / "holed.stl")).triangles) == 12
    inverted = box(2, 2, 2)
    inverted.invert()
    found = mesh_import.read(saved(inverted, tmp_path / "inverted.stl"))
    assert trimesh.Trimesh(found.vertices, found.triangles).volume == pytest.approx(8)
    half = box(2, 2, 2)
    half.faces[:5] = half.faces[:5, ::-1]
    found = mesh_import.read(saved(half, tmp_path / "half.stl"))
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
    needs("pymeshlab")
    path = saved(make(), tmp_path / "torn.stl")
    found = mesh_import.read(path)
    mended = trimesh.Trimesh(found.vertices, found.triangles, process=False)
    assert mended.is_watertight
    assert mended.is_winding_consistent
    assert mended.volume == pytest.approx(ball(3).volume, rel=0.01)
    monkeypatch.setattr(mesh_import, "_repaired", lambda mesh: mesh)
    with pytest.raises(UserError, match=r"is not closed: \d+ "):
        mesh_import.read(path)


def slivered(mesh: trimesh.Trimesh, height: float) -> trimesh.Trimesh:
    """Every third triangle split at a point `height` from the middle of one of its edges, as bad exporters do."""
    v, faces, more = list(mesh.vertices), [], []
    for k, (a, b, c) in enumerate(mesh.faces):
        if k % 3:
            faces.append((a, b, c))
            continue
        middle = (mesh.vertices[a] + mesh.vertices[b]) / 2
        v.append(middle + (mesh.vertices[c] - middle) * height)
        n = len(v) - 1
        more += [(a, b, n), (b, c, n), (c, a, n)]
    return trimesh.Trimesh(v, [*faces, *more], process=False)


@pytest.mark.parametrize("height", [1e-4, 1e-9])
def test_slivers_change_no_distance(height: float):
    clean, bad = field(ball(2), 0.3), field(slivered(ball(2), height), 0.3)
    x = np.random.default_rng(1).normal(size=(200, 3)) * 2 + [0, 0, 4]
    assert bad.distance(x)[0] == pytest.approx(clean.distance(x)[0], abs=1e-3)


def test_overlapping_bodies_are_united(tmp_path: Path):
    other = box(2, 2, 2)
    other.apply_translation([1, 0, 0])
    found = mesh_import.read(saved(trimesh.util.concatenate([box(2, 2, 2), other]), tmp_path / "two.stl"))
    assert found.body.max() == 1
    made = mesh_import.field(mesh_import.placed(found), cell=0.1, height=2.0, half=30)
    inside = np.column_stack([np.linspace(-1.2, 1.2, 25), np.zeros(25), np.full(25, 0.5)])
    assert (made.distance(inside)[0] < -0.2).all()


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
        mesh_import.read(path)
    (line,) = caught.value.lines
    assert line.startswith(str(path))
    assert says in line
    assert "\n" not in line


def test_limits_of_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = saved(ball(2), tmp_path / "ball.stl")
    monkeypatch.setattr(mesh_import, "MAX_TRIANGLES", 100)
    with pytest.raises(UserError, match="has 320 triangles, at most 100"):
        mesh_import.read(path)
    monkeypatch.setattr(mesh_import, "MAX_FILE", 10)
    with pytest.raises(UserError, match="cannot be read: 0 MB, at most 0 can be read"):
        mesh_import.read(path)
    monkeypatch.setattr(mesh_import, "MAX_NODES", 20_000)
    assert field(ball(2), 0.05).coefficients.size < 60_000


def test_a_thin_wall_is_refused_where_its_grid_would_lose_it():
    """A tube with a wall of 0.3 mm: on cells of 0.15 mm its spline has no inside, and a press 1/8 of the force."""
    tube = trimesh.creation.annulus(r_min=3.7, r_max=4.0, height=6)
    solid, inside = mesh_import.placed(solid_of(tube)), np.array([[3.85, 0.0, 0.5]])
    assert field(tube, 0.15).distance(inside)[0][0] > -0.02
    with pytest.raises(UserError, match=r"has walls thinner than 0\.45 mm.*edge_mm: 0\.3}"):
        mesh_import.refuse_thin_walls(solid, 0.15, 1.5, 0.6)
    mesh_import.refuse_thin_walls(solid, 0.15 * 0.3 / 0.6, 1.5, 0.3)
    mesh_import.refuse_thin_walls(solid, 0.09, 1.5, 0.6)
    assert field(tube, 0.09).distance(inside)[0][0] < -0.06
    foil = mesh_import.placed(solid_of(trimesh.creation.annulus(r_min=3.98, r_max=4.0, height=6)))
    with pytest.raises(UserError, match="too thin for this quality: make them thicker"):
        mesh_import.refuse_thin_walls(foil, 0.15, 1.5, 0.6)


def test_a_surface_through_itself_is_refused():
    mesh = box(2, 2, 2).subdivide().subdivide()
    top = mesh.vertices[:, 2] > 0.9
    mesh.vertices[top] -= [0, 0, 2.5]  # the lid pushed out through the floor
    with pytest.raises(UserError, match="cuts through itself"):
        field(mesh, 0.1)


@pytest.mark.parametrize(
    ("up", "extents", "above"),
    [("+z", [2, 3, 4], "z"), ("-z", [2, 3, 4], "-z"), ("+x", [3, 4, 2], "x"), ("-y", [4, 2, 3], "-y")],
)
def test_placing(up: str, extents: list[float], above: str):
    mesh = box(2, 3, 4)
    mesh.apply_translation([7, 8, 9])
    mark = 3 * np.eye(3)["xyz".index(above[-1])] * (-1 if above[0] == "-" else 1) + [7, 8, 9]
    solid = solid_of(mesh)
    with_mark = SolidMesh("test", np.vstack([solid.vertices, [mark] * 2]), solid.triangles, solid.body)
    placed = mesh_import.placed(with_mark, up=up)
    assert placed.vertices[-1, 2] == placed.vertices[:, 2].max()  # the marked side ends on top
    plain = mesh_import.placed(solid, up=up).vertices
    assert sorted(np.ptp(plain, axis=0)) == pytest.approx(sorted(extents))
    assert plain[:, 2].min() == pytest.approx(0)
    assert (plain.min(0) + plain.max(0))[:2] == pytest.approx([0, 0])
    turned = trimesh.Trimesh(plain, solid.triangles, process=False)
    assert turned.volume == pytest.approx(24)  # not mirrored


def test_sizes():
    solid = solid_of(box(2, 3, 4))
    assert np.ptp(mesh_import.placed(solid, scale=25.4).vertices, axis=0) == pytest.approx([50.8, 76.2, 101.6])
    assert np.ptp(mesh_import.placed(solid, size=10).vertices, axis=0) == pytest.approx([5, 7.5, 10])


def test_distances_are_kept_and_a_damaged_file_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    first = field(ball(3), 0.2)
    (file,) = (tmp_path / "cache" / "distances").iterdir()
    monkeypatch.setattr(mesh_import, "_distances", lambda *a: pytest.fail("computed again"))
    assert (field(ball(3), 0.2).coefficients == first.coefficients).all()
    monkeypatch.undo()
    monkeypatch.setenv("TACGEN_CACHE_DIR", str(tmp_path / "cache"))
    file.write_bytes(file.read_bytes()[:1000])
    assert (field(ball(3), 0.2).coefficients == first.coefficients).all()
    assert file.stat().st_size > 1000


# -- recipes --

RECIPE = """tacgen: 1
name: mesh
sensor: gelsight_mini
indenter: {shape: mesh, file: ball.stl, size_mm: 6}
trajectory: [{press: {depth_mm: 0.5, frames: 1}}]
outputs: [force]
quality: draft
"""


def written(folder: Path, text: str = RECIPE) -> Path:
    folder.mkdir(exist_ok=True)
    saved(ball(3), folder / "ball.stl")
    saved(trimesh.Trimesh(np.eye(3), [[0, 1, 2]]), folder / "open.stl")
    (folder / "r.yaml").write_text(text)
    return folder / "r.yaml"


def test_a_mesh_beside_the_recipe(tmp_path: Path):
    (row,) = plan.load(written(tmp_path / "a")).rows
    shape = scene_of_row.build(row).shape
    d, _, _ = shape.distance(np.array([[0, 0, -0.1], [0, 0, 3.0]]))
    assert d[0] == pytest.approx(0.1, abs=0.01)
    assert row.document()["indenter"]["file"] == "ball.stl"
    assert row.document()["indenter"]["sha256"] == assets.sha256(tmp_path / "a" / "ball.stl")


def test_the_key_follows_the_content_of_the_mesh_not_its_place(tmp_path: Path):
    here, there = (plan.load(written(tmp_path / name)).rows[0] for name in "ab")
    assert here.key == there.key
    saved(ball(2), tmp_path / "b" / "ball.stl")
    assert here.key != there.key


def test_a_mesh_that_was_changed_since_is_reported(tmp_path: Path):
    text = RECIPE.replace("size_mm: 6", f"size_mm: 6, sha256: '{'0' * 64}'")
    with pytest.raises(UserError) as caught:
        plan.load(written(tmp_path / "a", text))
    assert "indenter.sha256: ball.stl is another file now" in caught.value.lines[0]


def test_a_row_finds_its_mesh_from_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    written(tmp_path / "a")
    monkeypatch.chdir(tmp_path)
    (row,) = plan.load(Path("a/r.yaml")).rows
    (other,) = plan.load(Path("a/r.yaml"), ["indenter.file=a/ball.stl"]).rows
    monkeypatch.chdir("/")
    assert row.mesh_path == other.mesh_path == tmp_path / "a" / "ball.stl"


def test_varied_meshes(tmp_path: Path):
    vary = "vary: {method: grid, over: {indenter.file: {choice: [ball.stl, letters]}}}\n"
    rows = plan.load(written(tmp_path / "a", RECIPE + vary)).rows
    assert [row.mesh_path.name for row in rows] == ["ball.stl", "letters.stl"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("ball.stl", "bal.stl", "r.yaml:4:31: indenter.file: "),
        ("ball.stl", "hexbolt", "no object is called 'hexbolt'; did you mean hex_bolt?"),
        ("size_mm: 6", "size_mm: 6, scale: 2", "indenter.size_mm: cannot be given beside scale"),
        ("size_mm: 6", "up: z", "indenter.up: must be one of +x, -x, +y, -y, +z, -z (got 'z')"),
        ("size_mm: 6", "scale: 0.001", "indenter.file: is 0.008 mm long, too small for a mesh of edge "),
        ("ball.stl", "open.stl", "open.stl: is not closed: 3 open edges; close it in a mesh editor"),
        ("size_mm: 6", "scale: 0", "indenter.scale: must be greater than 0 (got 0)"),
    ],
)
def test_mistakes_in_a_recipe(old: str, new: str, says: str, tmp_path: Path):
    with pytest.raises(UserError) as caught:
        plan.load(written(tmp_path / "a", RECIPE.replace(old, new)))
    assert any(says in line for line in caught.value.lines), caught.value.lines


# -- shipped objects --


@pytest.mark.parametrize("name", assets.list_objects())
def test_shipped_objects_are_what_the_script_makes(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    script = loaded(Path(__file__).parents[2] / "scripts" / "make_objects.py")
    monkeypatch.setattr(script, "ROOT", tmp_path)
    shipped = assets.mesh_path(name)
    made, kept = (trimesh.load_mesh(path).triangles for path in (script.write(name), shipped))
    assert made == pytest.approx(kept, abs=1e-6)  # sines differ in the last bit from one machine to the next
    assert shipped.stat().st_size < 200_000
    solid = mesh_import.read(shipped)
    assert solid.body.max() == 0
    assert np.ptp(solid.vertices, axis=0).max() < 15
    readme = (shipped.parent / "README.md").read_text()
    assert "Apache-2.0" in readme
    assert "make_objects.py" in readme
    extents = " x ".join(f"{size:.1f}" for size in np.ptp(solid.vertices, axis=0))
    assert extents in readme
