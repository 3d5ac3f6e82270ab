"""A sensor from a triangle mesh of the gel: a knob with an undercut, made here; and DIGIT's own, where it is."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks import photographs
from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.geometry.pose import Pose
from tacgen.mechanics import mesh
from tacgen.recipe import loading, plan, scene_of_row

Array = np.ndarray
DIGIT = photographs.reference() / "geometry" / "digit_gel.stl"
SENSOR = """\
tacgen_sensor: 1
name: knob
description: a domed knob, narrower below its rim
gel:
  solid: {file: knob.stl, up: "-y", scale: 10, source: made by a test}
  width_mm: 8.0
  height_mm: 8.0
  layers:
    - {name: base, thickness_mm: 2.0, youngs_modulus_mpa: 0.15, poissons_ratio: 0.48, source: assumed}
    - {name: skin, thickness_mm: 1.0, youngs_modulus_mpa: 0.3, poissons_ratio: 0.48, source: assumed}
  source: made by a test
camera: {distance_mm: 20, mm_per_px: 0.2, width_px: 48, height_px: 48, source: assumed}
markers: {columns: 3, rows: 3, pitch_mm: [2, 2], diameter_mm: 0.5, albedo: 0.1, source: assumed}
"""
SKIN = "    - {name: skin, thickness_mm: 1.0, youngs_modulus_mpa: 0.3, poissons_ratio: 0.48, source: assumed}\n"
ONE_LAYER = SENSOR.replace(SKIN, "").replace("thickness_mm: 2.0", "thickness_mm: 3.0")
RECIPE = """\
tacgen: 1
name: knob
sensor: ./sensors/knob.yaml
quality: {edge_mm: 0.8, dhat_mm: 0.05}
indenter: {shape: sphere, radius_mm: 2.0}
start: {x_mm: 1.0}
trajectory: [{press: {depth_mm: 0.4, frames: 1}}]
outputs: [force, traction, height, stress, markers]
"""
CAP = [(3.0 + np.cos(t), 2.0 + np.sin(t)) for t in np.radians(np.arange(0, 91, 15))]


def turned(profile: list[tuple[float, float]], n: int = 24) -> trimesh.Trimesh:
    """The closed solid that a profile (r, z) from the base up makes around the z axis."""
    angle = np.arange(n) * 2 * np.pi / n
    rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(n, z)]) for r, z in profile]
    ends = [[0, 0, profile[0][1]], [0, 0, profile[-1][1]]]
    k, after, last = np.arange(n), (np.arange(n) + 1) % n, n * (len(rings) - 1)
    low, high = np.full(n, last + n), np.full(n, last + n + 1)
    faces = [np.stack([low, after, k], 1), np.stack([k + last, after + last, high], 1)]
    for i in range(len(rings) - 1):
        a, b, c, d = k + n * i, after + n * i, after + n * (i + 1), k + n * (i + 1)
        faces += [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    return trimesh.Trimesh(np.concatenate([*rings, ends]), np.concatenate(faces), process=False)


KNOB = [(3.5, 0.0), (3.0, 1.0), *CAP]  # a dome on a waist: the ledge below the rim faces up, and is not coated


def folder(tmp_path: Path, profile: list[tuple[float, float]] = KNOB, sensor: str = SENSOR) -> Path:
    """A recipe that names a sensor file in another folder, which names a mesh beside it: y down, in cm."""
    (tmp_path / "sensors").mkdir(exist_ok=True)
    solid = turned(profile)
    solid.vertices = solid.vertices[:, [0, 2, 1]] * [0.1, -0.1, 0.1]
    assert solid.is_watertight
    solid.export(tmp_path / "sensors" / "knob.stl")
    (tmp_path / "sensors" / "knob.yaml").write_text(sensor)
    (tmp_path / "r.yaml").write_text(RECIPE)
    return tmp_path / "r.yaml"


pytestmark = pytest.mark.usefixtures("own_cache")


# fTetWild needs half a minute for a solid with a sheet between layers
@pytest.mark.slow
@pytest.mark.parametrize("text", [ONE_LAYER, SENSOR], ids=["one layer", "two"])
def test_from_a_sensor_file_to_a_bundle(text: str, tmp_path: Path) -> None:
    row = plan.load(folder(tmp_path, sensor=text)).rows[0]
    made = scene_of_row.build(row)
    gel = made.gel
    r = np.array([0.0, 1.0, 2.9, 3.5, 5.0])
    flat, rim = 0.0, -1 + np.sqrt(1 - 0.25)
    assert gel.top(r, 0 * r)[:3] == pytest.approx([flat, flat, flat], abs=1e-6)
    assert gel.top(r, 0 * r)[3] == pytest.approx(rim, abs=0.02)
    assert gel.contains(r, 0 * r).tolist() == [True, True, True, True, False]
    assert gel.contains(np.array([3.9]), np.array([0.0])).tolist() == [False]  # steeper there than 60 deg
    gap = made.shape.distance(Pose.of(made.start).local(np.array([[1.0, 0.0, 0.0]])))[0]
    assert gap == pytest.approx(0.0, abs=1e-3)
    grid = mesh.of(made)
    x = grid.points
    assert x.min(0) == pytest.approx([-4, -4, -3], abs=0.03)
    assert x.max(0) == pytest.approx([4, 4, 0], abs=0.03)
    face, base = (np.unique(grid.facets[name]) for name in ("coated", "bonded"))
    assert x[base, 2] == pytest.approx(-3.0, abs=1e-6)
    assert np.hypot(*x[base, :2].T).max() == pytest.approx(3.5, abs=0.03)
    assert x[face, 2] == pytest.approx(gel.top(*x[face, :2].T), abs=1e-9)
    assert x[face, 2].min() > -1
    assert np.unique(grid.layer).tolist() == list(range(len(gel.layers)))
    if text == SENSOR:
        shared = np.intersect1d(grid.cells[grid.layer == 0], grid.cells[grid.layer == 1])
        sheet = gel.at_height(float(gel.interfaces[0]), x[shared, :2])[:, 2]
        assert x[shared, 2] == pytest.approx(sheet, abs=1e-9)
        assert sheet == pytest.approx(-3 + 2 / 3 * (3 + gel.top(*x[shared, :2].T)), abs=0.15)  # flat between its nodes
    assert abs(mesh.quality(gel, grid)["volume_error"]) < 2e-3

    here = set(Path.cwd().iterdir())
    result = pipeline.run_scene(row, tmp_path)
    assert result.status == "ok", result.reason
    assert set(Path.cwd().iterdir()) == here  # the mesher leaves nothing behind
    found = bundle.read(result.path)
    force = found["/frames/force"][0]
    assert force[2] < -0.05
    assert abs(force[1]) < 0.02 * -force[2]
    height = found["/frames/height"][0]
    assert np.nanmin(height) < -0.35
    assert np.isfinite(found["/frames/markers"]).all()
    sensor = json.loads(found.attrs["sensor_document"])
    assert len(sensor["gel"]["solid"]["sha256"]) == 64


DOME = """\
tacgen_sensor: 1
name: dome
description: a half ball with markers, as a TacTip has
gel:
  solid: {file: knob.stl, up: "-y", scale: 10, bonded_mm: 0.05, coated_deg: 60, source: made by a test}
  width_mm: 20.0
  height_mm: 20.0
  layers:
    - {name: gel, thickness_mm: 10.0, youngs_modulus_mpa: 0.2, poissons_ratio: 0.48, source: assumed}
  source: made by a test
camera: {distance_mm: 20, mm_per_px: 0.1, width_px: 120, height_px: 120, source: assumed}
markers: {columns: 5, rows: 5, pitch_mm: [2.5, 2.5], diameter_mm: 0.8, albedo: 0.9, source: assumed}
"""


@pytest.mark.slow
def test_a_half_ball_is_pressed_as_hertz_says_and_its_markers_move_apart(tmp_path: Path) -> None:
    """Pressure for the force that was found, of two balls, in rings around the middle; markers radially."""
    angles = np.radians(np.arange(0, 89, 4))
    profile = [(10 * np.cos(t), 10 * np.sin(t)) for t in angles]
    press = "trajectory=[{press: {depth_mm: 1.0, frames: 1}}]", "start.x_mm=0", "indenter.radius_mm=5"
    sets = (*press, "contact.friction=0", "quality={edge_mm: 0.5, dhat_mm: 0.05}")
    found = bundle.read(pipeline.run_scene(plan.load(folder(tmp_path, profile, DOME), sets).rows[0], tmp_path).path)
    force, modulus, radius = -found["/frames/force"][0, 2], 0.2 / (1 - 0.48**2), 1 / (1 / 10 + 1 / 5)
    a = (0.75 * force * radius / modulus) ** (1 / 3)
    pressure = found["/frames/pressure"][0]
    y, x = np.indices(pressure.shape) + 0.5 - 60
    r = 0.1 * np.hypot(x, y)
    hertz = 1.5 * force / (np.pi * a**2) * np.sqrt(np.maximum(1 - (r / a) ** 2, 0))
    for low in np.arange(0, 0.75 * a, 0.25):
        ring = (r >= low) & (r < low + 0.25)
        assert pressure[ring].mean() == pytest.approx(hertz[ring].mean(), rel=0.08)
        assert pressure[ring].std() < 0.12 * pressure.max()
    assert found["/frames/marker_visible"].all()
    flow = found["/frames/marker_flow"][0].reshape(5, 5, 2)
    outward = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), -1)
    assert (flow * outward).sum(-1)[np.abs(outward).sum(-1) > 0].min() > 0.2
    lopsided = flow + flow[::-1, ::-1]  # no mesh is symmetric
    assert np.sqrt((lopsided**2).mean()) < 0.08 * np.sqrt((flow**2).mean())


LIT = """\
plate: {thickness_mm: 2, refractive_index: 1.49, source: assumed}
coating: {albedo: 0.5, specular: 0.1, roughness: 0.4, source: assumed}
walls: {albedo: 0.05, margin_mm: 1.5, source: assumed}
leds:
  - {name: red, center_mm: [0, -5.3, -3], normal: [0, 1, 0.2], size_mm: [8, 1.5], radiance: [9, 0, 0], source: assumed}
  - {name: blue, center_mm: [0, 5.3, -3], normal: [0, -1, 0.2], size_mm: [8, 1.5], radiance: [0, 0, 9], source: assumed}
"""


@pytest.mark.slow
def test_pictures_show_the_solid_itself(tmp_path: Path) -> None:
    """Round, not the square of its box; its rim turned from the near light to the far one; as path has it."""
    recipe, found = folder(tmp_path, sensor=ONE_LAYER + LIT), {}
    for method, spp in (("transport", 64), ("path", 100)):
        sets = ("outputs=[rgb, radiance]", f"render.method={method}", f"quality.spp={spp}")
        found[method] = bundle.read(pipeline.run_scene(plan.load(recipe, sets).rows[0], tmp_path / method).path)
    y, x = np.mgrid[:48, :48] * 0.2 - 4.7
    r = np.hypot(x, y)
    for made in found.values():
        untouched = made["/reference/rgb"].max(-1)
        assert (untouched[r < 3.4] > 15).mean() > 0.97
        assert untouched[r > 4.4].max() < 15
    exact, path = (found[name]["/frames/radiance"][0] for name in ("transport", "path"))
    for inner, outer in ((0, 2), (2, 3), (3.0, 3.5)):
        for half in (y < -0.5, y > 0.5):
            here = (r >= inner) & (r < outer) & half
            truth, noise = path[here].mean(0), path[here].std(0) / np.sqrt(here.sum())
            # 18 means are compared: 3 standard errors
            assert (np.abs(exact[here].mean(0) - truth) <= 0.05 * truth + 3 * noise + 1e-9).all(), outer


@pytest.mark.slow
def test_slivers_in_the_file_are_not_in_the_mesh(tmp_path: Path) -> None:
    """Each triangle of the file split close to one of its edges; one layer."""
    recipe = folder(tmp_path, sensor=ONE_LAYER)
    solid = trimesh.load_mesh(tmp_path / "sensors" / "knob.stl")
    split = solid.triangles * [[[0.49995], [0.49995], [0.0001]]]
    points = np.concatenate([solid.vertices, split.sum(1)])
    a, b, c = solid.faces.T
    n = len(solid.vertices) + np.arange(len(solid.faces))
    faces = np.concatenate([np.stack(corners, 1) for corners in ((a, b, n), (b, c, n), (c, a, n))])
    trimesh.Trimesh(points, faces, process=False).export(tmp_path / "sensors" / "knob.stl")
    made = scene_of_row.build(plan.load(recipe).rows[0])
    assert len(made.gel.solid.triangles) > 2.5 * len(solid.faces)
    grid = mesh.of(made)
    said = mesh.quality(made.gel, grid)
    assert said["smallest_dihedral_deg"] > 5
    assert abs(said["volume_error"]) < 3e-3
    assert len(grid.points) < 6000


def test_the_files_content_is_in_the_scenes_key(tmp_path: Path) -> None:
    recipe = folder(tmp_path)
    key = plan.load(recipe).rows[0].key
    assert plan.load(recipe).rows[0].key == key
    folder(tmp_path, [(3.4, 0.0), *KNOB[1:]])
    assert plan.load(recipe).rows[0].key != key


def test_gels_of_the_same_size_from_two_files_have_two_volumes(tmp_path: Path) -> None:
    """Scenes of one process share what depends on the gel alone."""
    for profile in (KNOB, [(3.0, 0.0), *KNOB[1:]]):
        made = scene_of_row.build(plan.load(folder(tmp_path, profile)).rows[0])
        assert mesh.volume(made.gel) == pytest.approx(turned(profile).volume)


def test_a_varied_depth_and_a_sensor_override(tmp_path: Path) -> None:
    recipe = folder(tmp_path)
    vary = "vary={method: grid, over: {'sensor.gel.solid.coated_deg': {choice: [30, 60]}}}"
    rows = plan.load(recipe, (vary,)).rows
    assert [scene_of_row.build(row).gel.contains(np.array([3.7]), np.array([0.0]))[0] for row in rows] == [False, True]
    assert rows[0].key != rows[1].key


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("scale: 10", "scale: 1"), "gel.width_mm: the solid measures 0.8 mm along x (got 8): is scale or up wrong?"),
        (('up: "-y"', 'up: "+x"'), "gel.width_mm: the solid measures 3 mm along x"),
        (("thickness_mm: 1.0", "thickness_mm: 0.5"), "gel.layers: the solid measures 3 mm along z (got 2.5)"),
        (("knob.stl", "nob.stl"), "nob.stl: no such object file"),
        (("  width_mm: 8.0", "  corner_radius_mm: 1\n  width_mm: 8.0"), "gel.corner_radius_mm: cannot be given beside"),
        (("source: made by a test}", f"sha256: '{'0' * 64}', source: x}}"), "gel.solid.sha256: knob.stl is another"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_sensor_file(change: tuple[str, str], says: str, tmp_path: Path) -> None:
    folder(tmp_path, sensor=SENSOR.replace(*change))
    with pytest.raises(UserError) as caught:
        loading.read_sensor(tmp_path / "sensors" / "knob.yaml")
    assert any(says in line for line in caught.value.lines), caught.value.lines
    assert all(line.startswith(str(tmp_path)) or line.startswith(" ") for line in caught.value.lines)


@pytest.mark.parametrize(
    ("sets", "profile", "says"),
    [
        (("mesh=hex",), KNOB, "mesh: cannot be hex: the gel of knob is a solid"),
        (("start={x_mm: 3.9}",), KNOB, "would carry the indenter's axis off the gel's coated face, to (3.9, 0)"),
        ((), [(4.0, 0.0), (3.9, 0.5), (1.0, 1.0), (3.0, 2.0), (2.9, 2.9), (1.0, 3.0)], None),
        (("sensor.gel.solid.coated_deg=89.99",), [(4.0, 0.0), (4.0, 0.5), (2.0, 0.9), (2.0 - 1e-4, 1.5), (1.9, 3.0)],
         None),
    ],
)  # fmt: skip
def test_what_cannot_be_pressed(
    sets: tuple[str, ...], profile: list[tuple[float, float]], says: str | None, tmp_path: Path
) -> None:
    recipe = folder(tmp_path, profile)
    if says is None:  # a ledge under an overhang is no part of the face; a cone in steps is one
        gel = scene_of_row.build(plan.load(recipe, sets).rows[0]).gel
        assert gel.top(np.zeros(1), np.zeros(1)) == pytest.approx(0.0)
        return
    with pytest.raises(UserError) as caught:
        scene_of_row.build(plan.load(recipe, sets).rows[0])
    assert any(says in line for line in caught.value.lines), caught.value.lines


def test_a_face_that_lies_over_itself_is_refused(tmp_path: Path) -> None:
    """A wave that breaks: the triangles that face up are joined by a corner and lie over each other."""
    recipe = folder(tmp_path)
    gel = scene_of_row.build(plan.load(recipe).rows[0]).gel
    v, t = gel.solid.vertices, gel.solid.triangles
    highest, n = int(v[:, 2].argmax()), len(v)
    under = v[highest] * [0.3, 0.3, 1.0] - [[0, 0, 1.0]]
    shelf = np.repeat(under, 3, 0) + 2.0 * np.eye(3)[[2, 1, 0]] * [1, 1, 0]
    faces = np.array([[n, n + 2, n + 1], [n, n + 2, highest]])
    x = np.concatenate([v, shelf])
    turned = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])[:, 2] < 0
    faces[turned] = faces[turned][:, ::-1]
    joined = replace(gel.solid, vertices=x, triangles=np.concatenate([t, faces]))
    with pytest.raises(UserError, match=r"its coated face lies over itself at \(.*\), which no camera below sees"):
        _ = replace(gel, solid=joined).face


@pytest.mark.slow
def test_digits_gel_from_its_own_file(tmp_path: Path) -> None:
    """Taccel's model of it: a flat prism with a round end, in metres, out along x."""
    if not DIGIT.exists():
        pytest.skip(f"{DIGIT} is not here")
    sensor = SENSOR.replace('knob.stl, up: "-y", scale: 10', f'{DIGIT}, up: "+x", scale: 1000')
    sensor = sensor.replace("width_mm: 8.0", "width_mm: 18.4").replace("height_mm: 8.0", "height_mm: 25.0")
    recipe = folder(tmp_path, sensor=sensor)
    row = plan.load(recipe, ("quality=default", "indenter.radius_mm=4", "trajectory[0].press.depth_mm=0.8")).rows[0]
    made = scene_of_row.build(row)
    assert made.gel.thickness == pytest.approx(3.0)
    grid = mesh.of(made)
    assert len(grid.points) < 12_000
    said = mesh.quality(made.gel, grid)
    assert abs(said["volume_error"]) < 1e-3
    assert said["smallest_dihedral_deg"] > 5
    result = pipeline.run_scene(row, tmp_path)
    assert result.status == "ok", result.reason
    assert bundle.read(result.path)["/frames/force"][0, 2] < -1
