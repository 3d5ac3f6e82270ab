"""Solids of triangles: turned; distances against closed forms; the cache; recipes with meshes."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.meshes import ball, box, field_of, saved, solid_of, truncated_cone

from benchmarks import sharp
from tacgen.base.errors import UserError
from tacgen.geometry import mesh_import
from tacgen.geometry.mesh_file import SolidMesh
from tacgen.geometry.sdf_grid import Field
from tacgen.recipe import assets, plan, scene_of_row

Array = np.ndarray
RADIUS = 0.02  # of sharp edges [mm]


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TACGEN_CACHE_DIR", str(tmp_path / "cache"))


def test_distance_to_a_fine_ball():
    """The triangles cut at most 1.2 um off; the spline adds less."""
    found = field_of(ball(), 0.15)
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
    """Faces are exact, and edges but for their radius."""
    found = field_of(box(6, 6, 4), 0.1)
    rng = np.random.default_rng(1)
    p = np.column_stack([rng.uniform(-2.4, 2.4, (2000, 2)), rng.uniform(-0.2, 0.1, 2000)])
    assert found.distance(p)[0] == pytest.approx(-p[:, 2], abs=1e-6)
    side = np.column_stack([rng.uniform(2.9, 3.2, 500), rng.uniform(-2, 2, 500), rng.uniform(0.4, 0.9, 500)])
    assert found.distance(side)[0] == pytest.approx(side[:, 0] - 3, abs=1e-3)
    assert found.smallest_radius == pytest.approx(RADIUS)
    assert found.value(np.array([[3.0, 0.0, 0.0]])) == pytest.approx(RADIUS * (np.sqrt(2) - 1), abs=1e-9)


def test_a_wall_thinner_than_the_cell_gets_a_finer_grid():
    assert field_of(box(6, 6, 0.3), 0.15).cell == pytest.approx(0.05)


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
    clean, bad = field_of(ball(2), 0.3), field_of(slivered(ball(2), height), 0.3)
    x = np.random.default_rng(1).normal(size=(200, 3)) * 2 + [0, 0, 4]
    assert bad.distance(x)[0] == pytest.approx(clean.distance(x)[0], abs=1e-3)


@pytest.mark.parametrize("cell", [0.35, 0.4])
def test_the_sign_is_right_beside_slivers(cell: float):
    """A convex body of 180 facets: inside is where no facet is above a point. Pseudonormals fail at single points."""
    cone = truncated_cone()
    x = np.arange(-3, 3, cell)
    nodes = np.stack(np.meshgrid(x, x, x, indexing="ij"), -1).reshape(-1, 3) + cone.vertices.mean(0)
    found = mesh_import.signed_distance(solid_of(cone), nodes)
    a, b, c = np.moveaxis(np.asarray(cone.triangles), 1, 0)
    normal = np.cross(b - a, c - a)
    broad = trimesh.triangles.area(cone.triangles) > 0.01
    normal = normal[broad] / np.linalg.norm(normal[broad], axis=1)[:, None]
    true = (nodes @ normal.T - (a[broad] * normal).sum(1)).max(1)
    off = np.abs(true) > 1e-3
    assert ((found < 0) == (true < 0))[off].all()
    assert found[true < 0] == pytest.approx(true[true < 0], abs=1e-3)
    field_of(cone, cell)


def test_a_grid_has_a_bounded_number_of_nodes(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(mesh_import, "MAX_GRID_NODES", 20_000)
    assert field_of(ball(2), 0.05).coefficients.size < 60_000


@pytest.mark.parametrize(("wall", "dhat", "advice"), [(0.1, 0.05, "0.035"), (0.05, 0.04, "0.02"), (0.05, 0.02, "")])
def test_a_wall_thinner_than_contact_reaches_is_refused(wall: float, dhat: float, advice: str):
    tube = mesh_import.placed(solid_of(trimesh.creation.annulus(r_min=4 - wall, r_max=4.0, height=6)))
    for solid in (tube, mesh_import.placed(solid_of(box(wall, 8, 6)))):
        if not advice:
            mesh_import.refuse_thin_walls(solid, dhat, 1.5)
            continue
        with pytest.raises(UserError, match=rf"walls thinner than {2.2 * dhat:.2g} mm.*dhat_mm: {advice}}}"):
            mesh_import.refuse_thin_walls(solid, dhat, 1.5)


def test_a_foil_is_too_thin_for_contact_of_any_range():
    foil = mesh_import.placed(solid_of(trimesh.creation.annulus(r_min=3.999, r_max=4.0, height=6)))
    with pytest.raises(UserError, match="make them thicker"):
        mesh_import.refuse_thin_walls(foil, 0.05, 1.5)


@pytest.mark.parametrize("mesh", [sharp.wedge(15), sharp.cone(15), sharp.nut()])
def test_a_sharp_edge_is_no_wall_however_fine_its_triangles(mesh: trimesh.Trimesh):
    mesh_import.refuse_thin_walls(mesh_import.placed(solid_of(mesh.subdivide_to_size(0.15))), 0.05, 1.0)


def test_a_tube_with_a_wall_as_thin_as_a_cell_keeps_its_inside():
    """Its spline has none."""
    tube, inside = trimesh.creation.annulus(r_min=3.7, r_max=4.0, height=6), np.array([[3.85, 0.0, 0.05]])
    exact = field_of(tube, 0.15)
    plain = Field(*(getattr(exact, part.name) for part in fields(Field)))
    assert plain.value(inside)[0] > -0.02
    assert exact.value(inside)[0] == pytest.approx(-0.05, abs=1e-3)


def test_a_surface_through_itself_is_refused():
    mesh = box(2, 2, 2).subdivide().subdivide()
    top = mesh.vertices[:, 2] > 0.9
    mesh.vertices[top] -= [0, 0, 2.5]  # the lid pushed out through the floor
    with pytest.raises(UserError, match="cuts through itself"):
        field_of(mesh, 0.1)


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
    first = field_of(ball(3), 0.2)
    (file,) = (tmp_path / "cache" / "distances").iterdir()
    monkeypatch.setattr(mesh_import, "_distances", lambda *a: pytest.fail("computed again"))
    assert (field_of(ball(3), 0.2).coefficients == first.coefficients).all()
    monkeypatch.undo()
    monkeypatch.setenv("TACGEN_CACHE_DIR", str(tmp_path / "cache"))
    file.write_bytes(file.read_bytes()[:1000])
    assert (field_of(ball(3), 0.2).coefficients == first.coefficients).all()
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
        ("ball.stl", "open.stl", "open.stl: is not closed: 3 open edges, one of them near x "),
        ("size_mm: 6", "scale: 0", "indenter.scale: must be greater than 0 (got 0)"),
        ("size_mm: 6", f"sha256: '{'0' * 64}'", "indenter.sha256: ball.stl is another file now"),
    ],
)
def test_mistakes_in_a_recipe(old: str, new: str, says: str, tmp_path: Path):
    with pytest.raises(UserError) as caught:
        plan.load(written(tmp_path / "a", RECIPE.replace(old, new)))
    assert any(says in line for line in caught.value.lines), caught.value.lines
