"""Forces of a replayed table: which each row asks for, and what is refused in one line."""

from pathlib import Path

import numpy as np
import pytest
from helpers.small_recipe import BALL, HEAD

from tacgen.base.errors import UserError
from tacgen.mechanics.scene import Scene
from tacgen.recipe import grasp_of_row, matching, plan, scene_of_row
from tacgen.recipe.trajectory import Placement, Replay

Array = np.ndarray
TITLES = "time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz"
FORCES = f"{TITLES},force_x_n,force_y_n,force_z_n"
DOWN = "1,0,0,0"
GRASP = f"""{BALL.replace("4.0", "5")}grasp: {{mass_kg: 0.05}}
outputs: [force]
trajectory: [replay: {{file: poses.csv, match: grip}}]
"""


def load(folder: Path, rows: list[str], *sets: str, titles: str = FORCES, text: str = "") -> plan.Plan:
    (folder / "poses.csv").write_text("\n".join([titles, *rows]) + "\n")
    path = folder / "recipe.yaml"
    path.write_text(text or f"{HEAD}  - replay: {{file: poses.csv, match: force}}\n")
    return plan.load(path, sets)


def built(folder: Path, rows: list[str], *sets: str, **how: str) -> Scene:
    return scene_of_row.build(load(folder, rows, *sets, **how).rows[0])


def wanted(folder: Path, forces: list[str], *sets: str) -> Array:
    scene = built(folder, [f"{t},0,0,-0.2,{DOWN},0,0,{force}" for t, force in enumerate(forces)], *sets)
    assert scene.match is not None
    return scene.match.force


def test_a_spike_of_one_row_goes_and_what_is_unknown_stays_so(tmp_path: Path) -> None:
    forces = ["-1", "-1.1", "-50", "-1.2", "", "-1.4", "0.3"]
    assert wanted(tmp_path, forces) == pytest.approx([1, 1.1, 1.2, 1.2, np.nan, 1.4, 0], nan_ok=True)
    plain = wanted(tmp_path, forces, "trajectory[0].replay.filter_rows=1")
    assert plain == pytest.approx([1, 1.1, 50, 1.2, np.nan, 1.4, 0], nan_ok=True)  # one that pulls is none
    thin = wanted(tmp_path, forces, "trajectory[0].replay.every=2")
    assert thin == pytest.approx([1, 1.2, np.nan, 0], nan_ok=True)  # of the rows that were recorded


def test_a_force_is_turned_from_the_tables_frame_to_the_sensors(tmp_path: Path) -> None:
    """The sensor's z is the table's x; then that of a body that moves, with the same mount."""
    half = float(np.sqrt(0.5))
    mount = Placement(quaternion=(half, 0, half, 0))
    move = f"trajectory[0].replay.sensor_pose={{quaternion: {list(mount.quaternion)}}}"
    scene = built(tmp_path, [f"0,0,0,0,{DOWN},-2,0.3,0.4"], move)
    assert scene.match is not None
    assert scene.match.force == pytest.approx([2.0])
    titles = f"{FORCES},sensor_x_mm,sensor_y_mm,sensor_z_mm,sensor_qw,sensor_qx,sensor_qy,sensor_qz"
    turned = f"0,0,0,0,{DOWN},0.2,-3,0.4,0,0,0,{half},0,0,{half}"  # a quarter about z: the table's y
    scene = built(tmp_path, [turned], move, titles=titles)
    assert scene.match is not None
    assert scene.match.force == pytest.approx([3.0])


def test_a_row_without_force_is_lifted_to_first_touch_or_left(tmp_path: Path) -> None:
    rows = [f"{t},0,0,{z},{DOWN},0,0,-0.0005" for t, z in enumerate((-0.3, 0.7, -9))]
    scene = built(tmp_path, rows)
    assert scene.poses[:, 2, 3] == pytest.approx([0, 0.7, 0], abs=1e-9)
    assert scene.forced is None
    assert scene.match is not None
    assert scene.match.poses[:, 2, 3] == pytest.approx([-0.3, 0.7, -9])


def test_depths_may_be_any_where_a_force_is_asked_for(tmp_path: Path) -> None:
    scene = built(tmp_path, [f"0,0,0,-30,{DOWN},0,0,-1", f"1,90,0,-1,{DOWN},0,0,-1"])
    assert scene.forced is not None
    assert scene.forced.asked == pytest.approx([1, np.nan], nan_ok=True)
    assert scene.match is not None
    assert scene.match.notes == ("", "nothing of the indenter is over the gel, so that it would never touch it")
    assert scene.poses[1, 2, 3] == pytest.approx(0)  # clear of the pad's side
    with pytest.raises(UserError, match=r"line 2: the indenter's lowest point, at z = -30 mm"):
        load(tmp_path, [f"0,0,0,-30,{DOWN},0,0,", f"1,0,0,0,{DOWN},0,0,-1"])


@pytest.mark.parametrize(
    ("titles", "sets", "said"),
    [
        (TITLES, [], ":9:38: trajectory[0].replay.match: needs forces, and poses.csv has none in force_x_n, force_y_n"),
        (TITLES, ["trajectory[0].replay.match=grip"], "match: cannot be grip without a grasp"),
        (TITLES, ["trajectory[0].replay.match=pose", "trajectory[0].replay.filter_rows=3"],
         "filter_rows has no effect without match"),
        (TITLES, ["trajectory[0].replay.filter_rows=2"], "filter_rows must be odd"),
        (TITLES, ["trajectory[0].replay.match=depth"], "replay.match: "),
    ],
)  # fmt: skip
def test_what_is_lacking_is_said_in_one_line(tmp_path: Path, titles: str, sets: list[str], said: str) -> None:
    with pytest.raises(UserError) as refused:
        load(tmp_path, [f"0,0,0,0,{DOWN}"], *sets, titles=titles)
    assert said in refused.value.lines[0]
    assert sum("trajectory[0]" in line for line in refused.value.lines[:1] + refused.value.lines[3:]) == 1


GRIPPED = f"{TITLES},grip_n,width_mm,object_x_mm,object_y_mm,object_z_mm,object_qw,object_qx,object_qy,object_qz"
FIRST = f"0,100,0,5,{DOWN},1,,100.3,0,0,{DOWN}"


def test_a_recorded_gripper_is_in_the_world_and_its_object_in_the_middle(tmp_path: Path) -> None:
    half = repr(float(np.sqrt(0.5)))
    later = f"1,100,0,25,{half},{half},0,0,2,", f"2,100,0,25,{DOWN},0,30", f"3,100,0,25,{DOWN},,9"
    row = load(tmp_path, [FIRST, *(f"{each},,,,,,," for each in later)], titles=GRIPPED, text=GRASP).rows[0]
    grasp = grasp_of_row.build(row)
    assert grasp.opening == pytest.approx(10)
    assert grasp.begin[:3, 3] == pytest.approx([100, 0, 5])
    assert grasp.start[:3, 3] == pytest.approx([0, 0, -5], abs=1e-9)  # not 0.3 beside the middle
    assert grasp.gripper[1] == pytest.approx(np.array([[1, 0, 0, 100], [0, 0, -1, 0], [0, 1, 0, 25], [0, 0, 0, 1]]))
    assert grasp.force == pytest.approx([1, 1, np.nan, np.nan], nan_ok=True)
    assert grasp.width == pytest.approx([np.nan, np.nan, 30, 9], nan_ok=True)
    assert grasp.match is not None
    assert np.isnan(grasp.match.poses[1]).all()


@pytest.mark.parametrize(
    ("row", "sets", "said"),
    [
        (FIRST, ["grasp.yaw_deg=3"], "grasp.yaw_deg: has no effect: the table's first row says where the object is"),
        (FIRST.replace("100.3,0", "100.3,70"), [], "nothing of the object is between the fingers: check the poses"),
        (FIRST.replace("100.3", "180"), [], "the object is 80 mm from the middle of the fingers: check the poses"),
        (FIRST.replace("1,,100.3", ",,100.3"), [], "match: needs forces or widths, and poses.csv has none in grip_n"),
        (FIRST, ["trajectory[0].replay.match=force"], "match: cannot be force in a grasp: take grip"),
        (FIRST, ["trajectory=[close: {force_n: 1, frames: 1}, replay: {file: poses.csv, match: grip}]"],
         "trajectory[1].replay.match: can be grip in the first movement alone"),
        (FIRST, ["indenter={shape: cylinder, radius_mm: 5}"], "grasp: must say where an object without a top has its"),
    ],
)  # fmt: skip
def test_a_recorded_grasp_that_cannot_be_is_refused(tmp_path: Path, row: str, sets: list[str], said: str) -> None:
    with pytest.raises(UserError) as refused:
        grasp_of_row.build(load(tmp_path, [row], *sets, titles=GRIPPED, text=GRASP).rows[0])
    assert said in str(refused.value)


def test_medians_reach_over_more_rows_where_they_are_asked_to() -> None:
    from tacgen.recipe.pose_table import TimedPose

    grips = [0.0, 0, 9, 9, 0, 0, 0, 5]
    rows = [TimedPose(n, n, np.eye(4), grip=grip) for n, grip in enumerate(grips)]
    move = Replay(file="any.csv", match="grip", filter_rows=5)
    assert matching.asked(rows, move).tolist() == [0, 0, 0, 0, 0, 0, 0, 5]
