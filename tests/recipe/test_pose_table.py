"""Replays: tables read and refused by line, poses in the sensor's frame, and what comes before and after them."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.small_recipe import HEAD
from scipy.spatial.transform import Rotation

from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.bundle.check import check
from tacgen.geometry.pose import Pose, about
from tacgen.mechanics.scene import Scene
from tacgen.recipe import plan, pose_table, scene_of_row, trajectory_checks
from tacgen.recipe.model import Recipe
from tacgen.recipe.trajectory import Placement, unit
from tacgen.sensor.validation_messages import validate

Array = np.ndarray
TITLES = "time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz"
ROWS = [(0, 0.5, 0, 0.2, 1, 0, 0, 0), (0.1, 0.5, 0, -0.3, 1, 0, 0, 0), (0.25, 0.7, 0.1, -0.4, 0.995, 0, 0, 0.0998749)]


def table(rows: list[tuple[float, ...]], titles: str = TITLES) -> str:
    return "\n".join([titles, *(",".join(repr(float(v)) for v in row) for row in rows)]) + "\n"


def load(folder: Path, text: str, *sets: str, replay: str = "{file: poses.csv}", more: str = "") -> plan.Plan:
    (folder / "poses.csv").write_text(text)
    (folder / "recipe.yaml").write_text(f"{HEAD}  - replay: {replay}\n{more}")
    return plan.load(folder / "recipe.yaml", sets)


def built(folder: Path, text: str, *sets: str, **how: str) -> Scene:
    return scene_of_row.build(load(folder, text, *sets, **how).rows[0])


def matrix(position: Array, q: Array) -> Array:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_quat(q, scalar_first=True).as_matrix(), position
    return out


def test_rotations_equal_those_of_scipy() -> None:
    """One that is written out so that a recipe is checked without loading SciPy."""
    rng = np.random.default_rng(0)
    axes, angles = rng.normal(size=(200, 3)), rng.normal(size=200) * 10 ** rng.uniform(-5, 1, 200)
    for axis, angle in zip(axes, angles, strict=True):
        axis /= np.linalg.norm(axis)
        assert about(axis, angle) == pytest.approx(Rotation.from_rotvec(axis * angle).as_matrix(), rel=0, abs=1e-15)
    q = unit((1.0005, 0.0, 0.0, 0.0))
    assert q == unit(q) == (1, 0, 0, 0)


# -- tables --


@pytest.mark.parametrize(
    ("titles", "units", "scale"),
    [
        (TITLES, None, 1),
        ("Time,X,Y,Z,qw,qx,qy,qz", "mm", 1),
        ("timestamp,tx,ty,tz,qw,qx,qy,qz", "m", 1000),
        ("t,x_m,y_m,z_m,qw,qx,qy,qz", None, 1000),
        ("time, position.x, position.y, position.z, orientation.w, orientation.x, orientation.y, orientation.z", "mm",
         1),
        ("time,/arm/pose/position/x,/arm/pose/position/y,/arm/pose/position/z,"
         "/arm/pose/orientation/w,/arm/pose/orientation/x,/arm/pose/orientation/y,/arm/pose/orientation/z", "m", 1000),
    ],
)  # fmt: skip
def test_columns_go_by_many_names(tmp_path: Path, titles: str, units: str | None, scale: float) -> None:
    path = tmp_path / "t.csv"
    path.write_text("# recorded\n" + table(ROWS, titles), encoding="utf-8-sig")
    found = pose_table.read(path, units).poses
    assert [pose.line for pose in found] == [3, 4, 5]
    assert [pose.time for pose in found] == [0, 0.1, 0.25]
    assert found[2].pose == pytest.approx(matrix(np.array([0.7, 0.1, -0.4]) * scale, np.array(ROWS[2][4:])), abs=1e-12)


def test_what_ros_writes_is_read(tmp_path: Path) -> None:
    """`rostopic echo -p` of a PoseStamped: %time and the stamp in ns, lengths in m."""
    (tmp_path / "poses.csv").write_text(
        "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x,field.pose.position.y,"
        "field.pose.position.z,field.pose.orientation.x,field.pose.orientation.y,field.pose.orientation.z,"
        "field.pose.orientation.w\n"
        "1700000000000000000,0,1700000000000000000,base,0.0005,0,0.0002,0,0,0,1\n"
        "1700000000100000000,1,1700000000100000000,base,0.0005,0,-0.0003,0,0,0,1\n"
    )
    one, two = pose_table.read(tmp_path / "poses.csv", "m").poses
    assert two.time - one.time == pytest.approx(0.1, abs=1e-6)
    assert two.pose[:3, 3] == pytest.approx([0.5, 0, -0.3])
    with pytest.raises(UserError, match="does not say whether x, y and z are in mm or m: add units: m, or units: mm"):
        pose_table.read(tmp_path / "poses.csv")


def test_titles_may_be_named_by_columns(tmp_path: Path) -> None:
    """Of columns with names of their own, beside others that go by a known one."""
    titles = "stamp_ms,ee_x_m,ee_y_m,ee_z_m,rot.real,qx,qy,qz"
    (tmp_path / "poses.csv").write_text(table(ROWS, titles))
    columns = "{time: stamp_ms, x: ee_x_m, y: ee_y_m, z: ee_z_m, qw: rot.real}"
    (row,) = load(tmp_path, table(ROWS, titles), replay=f"{{file: poses.csv, columns: {columns}, frames: 1}}").rows
    assert row.replayed(0)[0].pose[:3, 3] == pytest.approx([500, 0, 200])
    found = pose_table.read(tmp_path / "poses.csv", None, dict(row.recipe.trajectory[0].replay.columns)).poses
    assert found[1].time == pytest.approx(1e-4)
    with pytest.raises(UserError) as caught:
        pose_table.read(tmp_path / "poses.csv", None, {"qw": "ee_w"})
    assert [line.partition(" (its")[0] for line in caught.value.lines] == [
        "has no column ee_w, which columns names",
        "has no column time, x, y, z: name it under columns",
        "does not say whether x, y and z are in mm or m: add units: m, or units: mm",
    ]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        (TITLES + "\n", "holds no pose"),
        ("time,x,y,z\n0,0,0,0\n", "has no column qw, qx, qy, qz: name it under columns (its header: time,x,y,z)"),
        (table(ROWS).replace(",", ";"), "has one column: commas must separate its cells (its header: time_s;x_mm;"),
        ("x,x_mm,y,z,time,qw,qx,qy,qz\n", "the columns x and x_mm are both x"),
        ("time,x_mm,y_m,z_mm,qw,qx,qy,qz\n", "must be in one unit"),
        (table(ROWS).replace("0.7", "red"), "line 4: x must be a number (got 'red')"),
        (table(ROWS).replace("0.7", "inf"), "line 4: x must be a number (got 'inf')"),
        (table(ROWS).replace("0.995", "0.95"), "line 4: a quaternion must be of length 1 (got 0.9552)"),
        (table(ROWS).replace("0.25,", "0.1,"), "line 4: time must increase (got 0.1 after 0.1)"),
        (table(ROWS).replace("0.25,", "1700000000.2,").replace("0.1,", "1700000000.3,", 1),
         "line 4: time must increase (got 1700000000.2 after 1700000000.3)"),
        (table(ROWS).replace("0.1,0.5,", "0.1,"), "line 3: has 7 cells, and the header 8"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_table_is_reported_by_line(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(UserError) as caught:
        load(tmp_path, text)
    first = caught.value.lines[0]
    assert first.startswith(f"{tmp_path}/recipe.yaml:9:20: trajectory[0].replay.file: poses.csv: ")
    assert says in first
    assert caught.value.lines[1].strip() == "- replay: {file: poses.csv}"


def test_all_bad_lines_are_reported_up_to_a_few(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(table([(i, 0, 0, 0, 2, 0, 0, 0) for i in range(9)]))
    with pytest.raises(UserError) as caught:
        pose_table.read(path)
    said = [*(f"line {n}" for n in range(2, 7)), "and 4 more lines"]
    assert [line.split(":")[0] for line in caught.value.lines] == said


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ((0.4, 0, 0, -4.5, 1, 0, 0, 0), "line 5: the indenter's lowest point, at z = -4.5 mm, would be at the base"),
        ((0.4, 40, 0, -0.5, 1, 0, 0, 0), "line 5: at (40, 0, -0.5) the indenter would be beside the pad of "),
    ],
)
def test_a_pose_that_cannot_be_is_refused_by_line(tmp_path: Path, row: tuple[float, ...], says: str) -> None:
    with pytest.raises(UserError) as caught:
        load(tmp_path, table([*ROWS, row]))
    assert f"trajectory[0].replay.file: poses.csv: {says}" in caught.value.lines[0]
    load(tmp_path, table([*ROWS, (0.4, 40, 0, 0.5, 1, 0, 0, 0)]))  # above the face it may be anywhere


def test_a_ball_that_rolls_touches_below_its_centre(tmp_path: Path) -> None:
    """Its frame's origin turns with it: to beside the pad, though the ball is over it."""
    centre = "{file: poses.csv, indenter_pose: {position_mm: [0, 0, -4]}}"
    half = math.sqrt(0.5)
    load(tmp_path, table([(0, 9, 0, 3.7, half, 0, -half, 0)]), replay=centre)
    with pytest.raises(UserError, match=r"at \(13, 0, -0.3\) the indenter would be beside the pad"):
        load(tmp_path, table([(0, 13, 0, 3.7, half, 0, half, 0)]), replay=centre)


def test_a_long_mesh_is_known_where_the_gel_touches_it(tmp_path: Path) -> None:
    """A bar of 200 mm that lies on the pad with one end: its distance there, 90 mm from its middle."""
    trimesh.creation.box((200, 10, 10)).export(tmp_path / "bar.stl")
    bar = f"indenter={{shape: mesh, file: {tmp_path}/bar.stl}}"
    made = built(tmp_path, table([(0, 90, 0, -0.3, 1, 0, 0, 0)]), bar)
    points = Pose.of(made.poses[0]).local(np.array([[0, 0, 0], [-9.0, 0, 0], [-10.5, 0, 1.2], [-9.5, 0, 1.2]]))
    assert made.shape.distance(points)[0] == pytest.approx([-0.3, -0.3, 0.5, -0.5], abs=0.02)


def test_an_endless_indenter_may_not_tilt_too_far(tmp_path: Path) -> None:
    cone = 'indenter={"shape": "cone", "half_angle_deg": 50, "tip_radius_mm": 0.5}'
    load(tmp_path, table([(0, 0, 0, 0, math.cos(0.3), math.sin(0.3), 0, 0)]), cone)
    with pytest.raises(UserError, match=r"poses.csv: line 2: the indenter's flank would meet the gel before its tip"):
        load(tmp_path, table([(0, 0, 0, 0, math.cos(0.4), math.sin(0.4), 0, 0)]), cone)


@pytest.mark.parametrize(
    ("replay", "says"),
    [
        ("{file: nowhere.csv}", "replay.file: nowhere.csv: cannot be read: No such file"),
        ('{file: "a\\0b"}', "cannot be read: embedded null"),
        ("{file: poses.csv, frames: 9}", "poses.csv: gives 3 frames, and 9 are asked for"),
        ("{file: poses.csv, units: m}", "must be in one unit"),
        (f"{{file: poses.csv, sha256: {'a' * 64}}}", "poses.csv: is another file now"),
        ("{file: poses.csv, sensor_pose: {quaternion: [1, 1, 0, 0]}}", "a quaternion must be of length 1 (got 1.414)"),
    ],
)
def test_the_table_must_match_the_recipe(tmp_path: Path, replay: str, says: str) -> None:
    with pytest.raises(UserError) as caught:
        load(tmp_path, table(ROWS), replay=replay)
    assert says in caught.value.lines[0]


def test_a_table_too_long_for_a_segment_is_thinned_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trajectory_checks, "MAX_SEGMENT_FRAMES", 2)
    with pytest.raises(UserError, match=r"poses.csv: gives 3 frames, at most 2 can be: thin it out by `every`"):
        load(tmp_path, table(ROWS))
    assert load(tmp_path, table(ROWS), replay="{file: poses.csv, every: 2}").rows[0].frames == 2


def test_a_start_before_a_replay_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="start: has no effect before a replay"):
        load(tmp_path, table(ROWS), "start.x_mm=1")


# -- paths --


def test_frames_are_the_rows(tmp_path: Path) -> None:
    made = built(tmp_path, table(ROWS))
    assert made.poses == pytest.approx(np.array([matrix(np.array(r[1:4]), np.array(r[4:])) for r in ROWS]), abs=1e-12)
    assert built(tmp_path, table(ROWS), replay="{file: poses.csv, every: 2}").poses == pytest.approx(made.poses[::2])
    assert built(tmp_path, table(ROWS), replay="{file: poses.csv, frames: 2}").poses == pytest.approx(made.poses[:2])


def test_poses_of_another_body_in_another_frame(tmp_path: Path) -> None:
    """Rows are poses of a body in the world, in metres; sensor and indenter stand somewhere in these."""
    rng = np.random.default_rng(3)
    sensor, inner = (matrix(rng.normal(size=3) * 30, Rotation.random(rng=rng).as_quat(scalar_first=True)) for _ in "12")
    wanted = np.array([matrix(np.array(r[1:4]), np.array(r[4:])) for r in ROWS])
    rows = []
    for row, pose in zip(ROWS, sensor @ wanted @ np.linalg.inv(inner), strict=True):
        q = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
        rows.append((row[0], *pose[:3, 3] / 1000, *q))
    frames = {"sensor_pose": sensor, "indenter_pose": inner}
    given = {name: placement(frame).model_dump(mode="json") for name, frame in frames.items()}
    replay = json.dumps({"file": "poses.csv", "units": "m", **given})
    made = built(tmp_path, table(rows, TITLES.replace("_mm", "")), replay=replay)
    assert made.poses == pytest.approx(wanted, abs=1e-9)


SENSOR_TITLES = TITLES + "".join(f",sensor_{title}" for title in TITLES.split(",")[1:])


def placement(pose: Array) -> Placement:
    x, y, z = pose[:3, 3].tolist()
    w, i, j, k = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True).tolist()
    return Placement(position_mm=(x, y, z), quaternion=(w, i, j, k))


def test_a_moving_sensor_is_read_from_the_table(tmp_path: Path) -> None:
    """A sensor in motion, its gel on a mount, toward which a body moves in the world."""
    rng = np.random.default_rng(5)
    mount = matrix(np.array([1.0, -2.0, 20.0]), Rotation.random(rng=rng).as_quat(scalar_first=True))
    wanted = np.array([matrix(np.array(r[1:4]), np.array(r[4:])) for r in ROWS])
    rows = []
    for row, pose in zip(ROWS, wanted, strict=True):
        sensor = matrix(rng.normal(size=3) * 300, Rotation.random(rng=rng).as_quat(scalar_first=True))
        here: list[float] = [row[0]]
        for frame in (sensor @ mount @ pose, sensor):
            here += [*frame[:3, 3], *Rotation.from_matrix(frame[:3, :3]).as_quat(scalar_first=True)]
        rows.append(tuple(here))
    replay = json.dumps({"file": "poses.csv", "sensor_pose": placement(mount).model_dump(mode="json")})
    assert built(tmp_path, table(rows, SENSOR_TITLES), replay=replay).poses == pytest.approx(wanted, abs=1e-9)


def test_the_pose_of_the_sensor_is_complete_or_not_there(tmp_path: Path) -> None:
    rows = [(*row, *row[1:6]) for row in ROWS]
    with pytest.raises(UserError) as caught:
        load(tmp_path, table(rows, ",".join(SENSOR_TITLES.split(",")[:13])))
    assert "poses.csv: has no column sensor_qy, sensor_qz: name it under columns" in caught.value.lines[0]
    mixed = SENSOR_TITLES.replace("sensor_z_mm", "sensor_z_m")
    with pytest.raises(UserError, match="must be in one unit"):
        load(tmp_path, table([(*row, *row[1:]) for row in ROWS], mixed))


def test_forces_of_a_table_are_kept_and_not_needed(tmp_path: Path) -> None:
    titles = f"{TITLES},force_x_n,force_y_n,force_z_n"
    (tmp_path / "t.csv").write_text(table([(*row, 0.5, math.nan, -2) for row in ROWS], titles))
    force = pose_table.read(tmp_path / "t.csv").poses[1].force
    assert force == pytest.approx((0.5, math.nan, -2), nan_ok=True)
    (tmp_path / "t.csv").write_text(table([(*row, 0.5) for row in ROWS], f"{TITLES},force_x_n"))
    assert pose_table.read(tmp_path / "t.csv").poses[1].force is None


def test_a_replay_that_begins_in_the_gel_is_approached_from_above(tmp_path: Path) -> None:
    clear = built(tmp_path, table(ROWS))
    assert (clear.start == clear.poses[0]).all()
    leaning = (0, 0.5, 0.2, -0.6, math.cos(0.2), 0, math.sin(0.2), 0)
    inside = built(tmp_path, table([leaning]), 'indenter={"shape": "box", "size_x_mm": 4, "size_y_mm": 4}')
    assert inside.start[:3, :3] == pytest.approx(inside.poses[0][:3, :3])
    assert inside.start[:2, 3] == pytest.approx([0.5, 0.2])
    assert inside.start[2, 3] - inside.shape.support(-inside.start[2, :3]) == pytest.approx(0)


def test_movements_after_a_replay_start_at_its_last_row(tmp_path: Path) -> None:
    after = "  - press: {depth_mm: 0.8, frames: 2}\n  - slide: {x_mm: 0.3, frames: 1}\n  - release: {frames: 1}\n"
    made = built(tmp_path, table(ROWS), more=after)
    places = np.array([[0.7, 0.1, -0.6], [0.7, 0.1, -0.8], [1.0, 0.1, -0.8], [1.0, 0.1, 0.2]])
    assert made.poses[3:, :3, 3] == pytest.approx(places, abs=1e-9)
    assert (made.poses[3:, :3, :3] == made.poses[2, :3, :3]).all()
    assert made.segment.tolist() == [0, 0, 0, 1, 1, 2, 3]


def test_a_replay_after_a_force_is_not_shifted_by_the_depth_found(tmp_path: Path) -> None:
    (tmp_path / "poses.csv").write_text(table(ROWS))
    moves = "  - press: {force_n: 1, frames: 1}\n  - replay: {file: poses.csv}\n"
    (tmp_path / "recipe.yaml").write_text(HEAD + moves)
    made = scene_of_row.build(plan.load(tmp_path / "recipe.yaml").rows[0])
    assert made.forced is not None
    assert made.forced.carry.tolist() == [1, 0, 0, 0]


# -- plans and bundles --


def test_a_row_knows_its_frames_and_its_file(tmp_path: Path) -> None:
    row = load(tmp_path, table(ROWS)).rows[0]
    assert row.frames == 3
    assert load(tmp_path, table(ROWS)).rows[0].key == row.key
    (tmp_path / "poses.csv").write_text(table(ROWS).replace("0.7", "0.6"))
    with pytest.raises(UserError, match=r"poses.csv: is another file now"):
        scene_of_row.build(row)
    assert plan.load(tmp_path / "recipe.yaml").rows[0].key != row.key
    recipe, _ = validate(Recipe, row.document())
    assert recipe == row.recipe


def test_tables_may_be_varied_and_are_found_beside_the_recipe_that_names_them(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    load(inner, table(ROWS))
    (inner / "two.csv").write_text(table(ROWS[:2]))
    outer = tmp_path / "outer.yaml"
    outer.write_text("extends: inner/recipe.yaml\nname: outer\n")
    assert plan.load(outer).rows[0].frames == 3
    tables = "    trajectory[0].replay.file: {choice: [inner/two.csv, inner/poses.csv]}\n"
    over = f"{tables}    contact.friction: {{choice: [0, 1]}}\n"
    outer.write_text(f"extends: inner/recipe.yaml\nname: outer\nvary:\n  method: grid\n  over:\n{over}")
    assert [row.frames for row in plan.load(outer).rows] == [2, 2, 3, 3]


def test_a_table_may_repeat_a_pose(tmp_path: Path) -> None:
    rows = [(k, 0, 0, 0.5, 1, 0, 0, 0) for k in range(3)]
    found = pipeline.run_scene(load(tmp_path, table(rows), "may_miss=true").rows[0], tmp_path / "out")
    assert [finding.level for finding in check(found.path)] == ["note"]  # it touches in no frame
    assert bundle.read(found.path).frames == 3
