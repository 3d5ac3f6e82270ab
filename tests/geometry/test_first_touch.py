"""First touch of the gel as it is: a part of an indenter that hangs down beside the pad touches nothing."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.command import refused
from helpers.flanged_rod import flanged
from helpers.small_recipe import HEAD

from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.geometry import first_touch, mesh_file, mesh_import
from tacgen.geometry.analytic_sdf import BoxSdf, CapsuleSdf, ConeSdf, CylinderSdf, SphereSdf, TorusSdf, WedgeSdf
from tacgen.geometry.outline import Pad
from tacgen.geometry.pose import about
from tacgen.recipe import plan, scene_of_row

Array = np.ndarray
PADS = {"square": Pad(18.6, 14.3), "rounded": Pad(18.6, 14.3, 3.0), "stadium": Pad(16.0, 22.0, tip=-1)}
SHAPES = [
    SphereSdf(4.0), CapsuleSdf(2.0, 60.0), TorusSdf(4.0, 1.0), CylinderSdf(3.0, 0.3), BoxSdf(40.0, 30.0, 0.2),
    ConeSdf(0.5, 0.05), WedgeSdf(0.5, 0.1, 40.0),
]  # fmt: skip

pytestmark = pytest.mark.usefixtures("own_cache")


def pose(tilt_deg: float = 0.0, axis_deg: float = 90.0, yaw_deg: float = 0.0, x: float = 0.0, y: float = 0.0) -> Array:
    found, a = np.eye(4), np.radians(axis_deg)
    turn = about(np.array([0.0, 0.0, 1.0]), np.radians(yaw_deg))
    found[:3, :3] = about(np.array([np.cos(a), np.sin(a), 0.0]), np.radians(tilt_deg)) @ turn
    found[:2, 3] = x, y
    return found


def field(drawn: trimesh.Trimesh, tmp_path: Path, half: float = 12.0):
    drawn.export(tmp_path / "drawn.stl")
    solid = mesh_import.placed(mesh_file.read(tmp_path / "drawn.stl"))
    return mesh_import.field(solid, cell=0.5, height=np.inf, half=half, radius=0.05)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_where_the_lowest_point_is_over_the_pad_it_is_what_touches(shape) -> None:
    """Exactly, whatever the search on grids would give."""
    for pad, tilt, yaw in product(PADS.values(), (0.0, 3.0, 12.0), (0.0, 35.0)):
        at = pose(tilt, 90.0, yaw, 1.3, -0.7)
        if isinstance(shape, CapsuleSdf | BoxSdf | WedgeSdf) and tilt:
            continue  # their ends are beside the pad then
        assert first_touch.contact_height(shape, pad, at) == shape.support(-at[2, :3])


@pytest.mark.parametrize("name", PADS)
def test_a_leaning_capsule_touches_at_the_rim(name: str) -> None:
    """By the least height of its axis over the pad's outline, less the radius."""
    pad, shape, tilt = PADS[name], CapsuleSdf(2.0, 60.0), np.radians(4.0)
    rim = pad.outline(1e-6)
    sides = [a + np.linspace(0, 1, 4001)[:, None] * (b - a)
             for a, b in zip(rim, np.roll(rim, -1, 0), strict=True) if np.linalg.norm(b - a) > 1]  # fmt: skip
    rim = np.concatenate([rim, *sides])
    for yaw in (0.0, 90.0):
        at = pose(4.0, 90.0 + yaw, yaw)
        way = np.array([np.cos(np.radians(yaw)), np.sin(np.radians(yaw))])
        u, v = rim @ way, rim @ [-way[1], way[0]]  # along and across the capsule, as seen from above
        on = np.abs(v) < 2.0
        centre = at[:3, :3] @ [0.0, 0.0, 2.0]
        height = (u[on] - centre[:2] @ way) * -np.tan(tilt) + centre[2] - np.sqrt(4.0 - v[on] ** 2) / np.cos(tilt)
        found = first_touch.contact_height(shape, pad, at)
        assert found == pytest.approx(-height.min(), abs=2e-5)
        assert found < shape.support(-at[2, :3]) - 1
        lowered = at.copy()
        lowered[2, 3] = found
        assert first_touch.lowest_over(shape, pad, lowered) == pytest.approx(0, abs=1e-9)


def test_a_ring_around_the_pad_never_touches() -> None:
    assert first_touch.contact_height(TorusSdf(30.0, 1.0), PADS["square"], pose()) == -np.inf
    assert first_touch.lowest_over(TorusSdf(30.0, 1.0), PADS["square"], pose()) == np.inf
    ball_beside = pose(x=15.0)
    assert first_touch.contact_height(SphereSdf(4.0), PADS["square"], ball_beside) == -np.inf


def test_the_flange_of_a_rod_is_beside_the_pad(tmp_path: Path) -> None:
    """Upright, leaning and turned; on a flat pad from the triangles, on a dome from the distance."""
    shape, pad = field(flanged(), tmp_path), PADS["square"]
    for yaw in (0.0, 25.0):
        assert first_touch.contact_height(shape, pad, pose(yaw_deg=yaw)) == pytest.approx(-5.0, abs=1e-9)
    assert first_touch.contact_height(shape, pad, pose(x=-9.0)) == pytest.approx(-5.0, abs=1e-9)
    assert first_touch.contact_height(shape, Pad(60.0, 14.3), pose()) == 0.0
    tilt = np.radians(3.0)
    exact = -9.0 * np.cos(tilt) + 4 / np.cos(tilt) + (9.3 - 9 * np.sin(tilt)) * np.tan(tilt)
    assert first_touch.contact_height(shape, pad, pose(3.0)) == pytest.approx(exact, abs=1e-6)
    dome = Pad(18.6, 14.3, radii=(200.0, 200.0))
    assert first_touch.contact_height(shape, dome, pose()) == pytest.approx(-5.0, abs=0.05)


def test_the_lowest_point_over_a_pad_is_that_of_its_triangles() -> None:
    """Random triangles, sampled densely."""
    rng = np.random.default_rng(3)
    for pad in PADS.values():
        for _ in range(5):
            vertices = rng.uniform([-14, -14, 6], [14, 14, 34], (12, 3))
            triangles = rng.permutation(12).reshape(4, 3)
            s, t = rng.uniform(0, 1, (2, 60_000))
            s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
            a, b, c = (vertices[triangles[:, k], None] for k in range(3))
            points = (a + s[:, None] * (b - a) + t[:, None] * (c - a)).reshape(-1, 3)
            sampled = points[pad.contains(*points[:, :2].T), 2].min(initial=np.inf)
            found = first_touch.least_over(vertices, triangles, pad, np.eye(4))
            assert found <= sampled + 2e-3
            assert found == pytest.approx(sampled, abs=0.3)


def recipe(tmp_path: Path, moves: str, indenter: str = "{shape: mesh, file: drawn.stl}", more: str = "") -> Path:
    flanged().export(tmp_path / "drawn.stl")
    head = HEAD.replace("{shape: sphere, radius_mm: 4.0}", indenter)
    (tmp_path / "r.yaml").write_text(f"{head}  - {moves}\n{more}\n")
    return tmp_path / "r.yaml"


def test_a_lying_rod_presses_with_its_rod(tmp_path: Path) -> None:
    """By depth and by force: it pressed with nothing, as `ok`, and found no force, its flange on no gel."""
    press, small = "press: {depth_mm: 0.6, frames: 1}", ("sensor.gel.width_mm=6", "sensor.gel.height_mm=8")
    done = pipeline.run_scene(plan.load(recipe(tmp_path, press), small).rows[0], tmp_path / "flanged")
    assert done.status == "ok", done.reason
    found = bundle.read(done.path)
    assert found["/frames/pose"][0, 2, 3] == pytest.approx(-5.6)
    force = found["/frames/force"][0, 2]
    capsule = "{shape: capsule, radius_mm: 4.0, length_mm: 60.0}"
    alike = pipeline.run_scene(plan.load(recipe(tmp_path, press, capsule), small).rows[0], tmp_path / "capsule")
    assert force == pytest.approx(bundle.read(alike.path)["/frames/force"][0, 2], rel=0.05)


def test_a_movement_may_lower_what_is_beside_the_pad(tmp_path: Path) -> None:
    """The end of a capsule is below the base of the gel, and not over it; about the rod's own point."""
    capsule = "{shape: capsule, radius_mm: 4.0, length_mm: 60.0}"
    moves = "press: {depth_mm: 0.5, frames: 1}\n  - tilt: {angle_deg: 9, frames: 1}"
    row = plan.load(recipe(tmp_path, moves, capsule, "start: {yaw_deg: 90}")).rows[0]
    made = scene_of_row.build(row)
    end = made.poses[-1] @ [-30.0, 0, 4.0, 1.0]
    assert min(end[2], (made.poses[-1] @ [30.0, 0, 4.0, 1.0])[2]) - 4 < -4.25
    row = plan.load(recipe(tmp_path, "press: {depth_mm: 0.5, frames: 1}\n  - tilt: {angle_deg: 2, frames: 1}")).rows[0]
    made = scene_of_row.build(row)
    assert np.linalg.norm(made.poses[1][:2, 3] - made.poses[0][:2, 3]) < 0.4
    assert abs(made.poses[1][2, 3] - made.poses[0][2, 3]) < 0.1


def test_what_can_never_touch_is_refused_before_the_run(tmp_path: Path) -> None:
    ring = "{shape: torus, radius_mm: 30.0, tube_radius_mm: 2.0}"
    said = refused("validate", recipe(tmp_path, "press: {depth_mm: 0.6, frames: 1}", ring)).splitlines()[0]
    assert "trajectory[0].press: nothing of the indenter is over the gel" in said
    path = recipe(tmp_path, "press: {force_n: 1, frames: 1}")
    trimesh.creation.annulus(18.0, 20.0, 2.0).export(tmp_path / "drawn.stl")
    assert "nothing of the indenter is over the gel" in refused("validate", path)
    with pytest.raises(UserError, match="nothing of the indenter is over the gel"):
        scene_of_row.build(plan.load(path).rows[0])


def test_beside_the_face_of_a_solid_there_is_no_gel() -> None:
    """A half ball's box has corners; a ball that comes down there touches at the rim of its face."""
    from tacgen.recipe import assets, loading

    path = assets.sensor_path("tactip")
    gel = scene_of_row.gel_of(loading.read_sensor(path)[0], path.parent / "tactip_gel.obj")
    face = first_touch.face_near(gel, np.zeros(2), np.array([20.0, 20.0]), 2.0)
    assert np.hypot(face[:, 0], face[:, 1]).max() < 17.4
    assert first_touch.contact_height(SphereSdf(1.0), gel, pose(x=19.5, y=19.5)) == -np.inf


def test_a_wide_body_is_touched_before_the_neck_whose_corners_are_over_the_pad() -> None:
    """A bottle across the pad, its frame in the axis: corners of the neck are over the pad, those of the body beside
    it."""
    body, neck = trimesh.creation.box((40, 24, 24)), trimesh.creation.box((24, 12, 12))
    neck.apply_translation((20, 0, 0))
    bottle, pose = trimesh.util.concatenate([body, neck]), np.eye(4)
    pose[:3, 3] = -5.0, 0.0, 12.0
    least = first_touch.least_over(bottle.vertices, bottle.faces, Pad(30.0, 20.0, 0.0), pose)
    assert least == pytest.approx(0.0, abs=1e-9)
