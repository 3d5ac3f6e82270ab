"""Which rows of an episode are solved, at which rate, and two fingers near one object that become one grasp."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.small_recipe import row

from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.cli.touch import _fingers, _range, _window
from tacgen.recipe import pose_table, scene_of_row
from tacgen.recipe.trajectory import Placement
from tacgen.replay import selection
from tacgen.touch import grasps, intervals, labels, scenes
from tacgen.touch.episode import EpisodeLog, Finger, Thing
from tacgen.touch.intervals import BETWEEN_ROWS, AtFinger, Rate
from tacgen.touch.scenes import TouchChoice
from touch.made_source import COARSE, FINGER, Made, ball, episode, over

GAPS = [60.0, 30.0, 9.0, 0.5, -0.2, -0.4, 0.4, 12.0, 40.0, 40.0, 40.0, 40.0, 0.6, -0.3, 8.0, 30.0]


def found(one: EpisodeLog, *things: Thing, near_mm: float = 1.0) -> AtFinger:
    bodies = {thing.body: (thing, intervals.body_of(thing)) for thing in things}
    return intervals.contacts(one, FINGER, bodies, scene_of_row.gel_of(row().sensor), near_mm)


def test_intervals_are_the_rows_near_the_gel_and_a_few_before() -> None:
    made = found(episode({"ball": over(GAPS)}), ball("ball"))
    assert [one.rows for one in made.intervals] == [(1, 7), (10, 14)]
    assert [bool(name) for name in made.near] == [gap <= 0 for gap in GAPS]
    assert set(made.note) == {""}
    assert np.isnan(made.engine).all()


def test_a_ball_beside_or_behind_the_sensor_is_not_near() -> None:
    assert found(episode({"ball": over([-0.5] * 5, 60.0)}), ball("ball")).intervals == ()
    assert found(episode({"ball": over([-60.0] * 5)}), ball("ball")).intervals == ()


def test_rows_that_come_near_and_do_not_touch_are_not_solved_unless_the_engine_has_a_force() -> None:
    gaps = [9.0, 2.0, 1.6, 1.5, 2.0, 9.0]
    force = np.zeros((6, 3))
    force[3] = [0.1, 0.0, -2.0]
    assert found(episode({"ball": over(gaps)}), ball("ball")).intervals == ()
    made = found(episode({"ball": over(gaps)}, forces=force), ball("ball"))
    assert [one.rows for one in made.intervals] == [(0, 4)]
    assert made.engine == pytest.approx([0, 0, 0, 2, 0, 0])
    assert made.near[3] == "ball"
    far = found(episode({"ball": over([30.0] * 6)}, forces=force), ball("ball"))
    assert far.note[3] == "the engine has ball press on hand, but not on its gel"


def test_two_objects_at_once_are_said_and_left_out() -> None:
    second = [9.0, 9.0, 9.0, 9.0, -0.1, -0.1, 9.0, 9.0, 9.0]
    first = [9.0, 0.5, -0.2, -0.2, -0.2, -0.2, -0.2, -0.2, 9.0]
    both = episode({"a": over(first, -6.0), "b": over(second, 6.0)})
    made = found(both, ball("a"), ball("b"))
    assert [(one.thing.body, one.rows) for one in made.intervals] == [("a", (0, 3)), ("a", (6, 8))]
    assert made.note[4] == made.note[5] == "a and b touch at once: one object at a time is solved"
    assert made.near[4] == "a and b"


def test_rows_without_a_pose_are_said_and_end_an_interval() -> None:
    one = episode({"ball": over([9.0, 0.5, -0.2, -0.2, -0.2, 0.5, 9.0])})
    one.bodies["ball"][3] = np.nan
    made = found(one, ball("ball"))
    assert [part.rows for part in made.intervals] == [(0, 2), (4, 6)]
    assert made.note[3] == "the pose of hand or of ball is not recorded"


def test_a_higher_rate_puts_poses_between_rows() -> None:
    (interval,) = found(episode({"ball": over([9.0, 0.5, -0.2, -0.4, 9.0])}), ball("ball")).intervals
    dense = intervals.at_rate(interval, Rate(30.0)).log
    assert dense.row[::3].tolist() == [0, 1, 2, 3, 4]
    assert set(dense.row[dense.row != BETWEEN_ROWS].tolist()) == {0, 1, 2, 3, 4}
    assert len(dense) == 13
    assert dense.time == pytest.approx(np.arange(13) / 30)
    assert (dense.body[::3] == interval.log.body).all()
    poses = selection.relative(dense, FINGER.mount, Placement())
    assert poses[:, 2, 3][3:10] == pytest.approx(np.interp(np.arange(3, 10), [3, 6, 9], [4.5, 3.8, 3.6]), abs=2e-3)


def test_a_window_has_a_rate_of_its_own_and_a_lower_rate_leaves_rows_out() -> None:
    (interval,) = found(episode({"ball": over([-0.1] * 9)}), ball("ball")).intervals
    fast = intervals.at_rate(interval, Rate(None, ((0.3, 0.5, 40.0),))).log
    assert np.diff(fast.time) == pytest.approx([0.1] * 2 + [0.025] * 12 + [0.1] * 3)
    slow = intervals.at_rate(interval, Rate(3.4)).log
    assert slow.row.tolist() == [0, 3, 6, 8]
    assert intervals.at_rate(interval, Rate(10.0)) is interval


Array = np.ndarray
LEFT, RIGHT = Finger("left", "gelsight_mini", "a"), Finger("right", "gelsight_mini", "b")
WIDTHS = [40.0, 12.0, 8.5, 7.6, 7.6, 7.6, 9.0, 30.0]  # between the faces; the ball is 8 mm wide
HEIGHTS = [0.0, 0.0, 0.0, 0.0, 2.0, 4.0, 4.0, 4.0]


def grasped(grip: bool = True, turned: bool = False) -> EpisodeLog:
    """Two sensors close on a ball and lift it: x is from the left to the right one, the images' x is y."""
    n = len(WIDTHS)
    poses = {name: np.tile(np.eye(4), (n, 1, 1)) for name in ("a", "b", "ball")}
    poses["a"][:, :3, :3] = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])  # its x, y and z are y, z and x
    poses["b"][:, :3, :3] = np.array([[0, 0, -1], [1 if turned else -1, 0, 0], [0, -1 if turned else 1, 0]])
    poses["a"][:, 0, 3], poses["b"][:, 0, 3] = -np.array(WIDTHS) / 2, np.array(WIDTHS) / 2
    for each in poses.values():
        each[:, 2, 3] = HEIGHTS
    return EpisodeLog(0, "lift", np.arange(n) / 10, poses, grip=np.full(n, 3.0) if grip else None)


def at_both(episode: EpisodeLog, thing: Thing) -> list[AtFinger]:
    things, gel = {"ball": (thing, intervals.body_of(thing))}, scene_of_row.gel_of(row().sensor)
    return [intervals.contacts(episode, finger, things, gel, 1.0) for finger in (LEFT, RIGHT)]


def test_the_table_has_the_gripper_between_the_sensors(tmp_path: Path) -> None:
    episode, thing = grasped(), ball("ball", 0.02)
    at = at_both(episode, thing)
    (one,), refused = grasps.paired(episode, at)
    assert refused == []
    assert one.rows == (0, 7)
    (tmp_path / "t.csv").write_text(grasps.table(one, episode, at))
    rows = pose_table.read(tmp_path / "t.csv").poses
    gripper = np.array([each.pose for each in rows])
    assert gripper[:, :3, :3] == pytest.approx(np.tile(np.eye(3), (8, 1, 1)), abs=1e-12)
    assert gripper[:, 2, 3] == pytest.approx(HEIGHTS)
    lines = [line.split(",") for line in (tmp_path / "t.csv").read_text().splitlines()[1:]]
    table = {name: [float(cells[k]) for cells in lines[1:]] for k, name in enumerate(lines[0])}
    assert table["width_mm"] == pytest.approx(WIDTHS)
    assert table["grip_n"] == [0, 0, 0, 3, 3, 3, 0, 0]
    assert table["object_z_mm"] == pytest.approx(np.array(HEIGHTS) - 4)


def test_what_is_no_grasp_is_said() -> None:
    def why(episode: EpisodeLog, thing: Thing) -> list[str]:
        found, refused = grasps.paired(episode, at_both(episode, thing))
        assert found == []
        return [text for _, text in refused]

    assert why(grasped(), ball("ball")) == [grasps.NO_MASS]
    assert why(grasped(turned=True), ball("ball", 0.02)) == [grasps.NOT_FACING]
    alone = grasped()
    alone.bodies["b"][:, 0, 3] += 50
    assert why(alone, ball("ball", 0.02)) == [grasps.ALONE]


def test_a_grasp_is_a_scene_whose_fingers_bear_the_weight_of_its_object(tmp_path: Path) -> None:
    source = Made([grasped()], [ball("ball", 0.02)])
    sets = (*COARSE, "quality={edge_mm: 1.5, dhat_mm: 0.15}")
    prepared = scenes.prepare(source, [LEFT, RIGHT], TouchChoice("grip", sets=sets), tmp_path)
    (scene,) = prepared.scenes
    assert prepared.plan.rows[scene].recipe.grasp.mass_kg == 0.02
    assert [each.name for each in prepared.plan.rows[scene].bundles] == ["scene-00001-L", "scene-00001-R"]
    touches = labels.felt(prepared, pipeline.run(prepared.plan.rows, tmp_path))
    ((left, right),) = touches
    assert [one.touched for one in (left, right)] == [[""] * 3 + ["ball"] * 3 + [""] * 2] * 2
    for one in (left, right):
        assert -one.force[3:6, 2] == pytest.approx(3.0, rel=0.01)
        assert one.engine[3:6] == pytest.approx(3.0)
        assert one.lifted[4:6].all()
    weight = 0.02 * 9.80665
    assert left.force[4:6, 1] + right.force[4:6, 1] == pytest.approx(-weight, rel=0.02)


def test_options_are_read_or_refused() -> None:
    left, right = _fingers(["left=digit@pad_1", "right=sensors/my.yaml@robot/pad"], ["right=0,0,5,0,1,0,0"])
    assert left == replace(left, name="left", sensor="digit", body="pad_1")
    assert (right.sensor, right.body) == ("sensors/my.yaml", "robot/pad")
    assert right.mount.quaternion == (0, 1, 0, 0)
    assert _window("1.2:1.5@200") == (1.2, 1.5, 200)
    assert _range("3:5") == range(3, 6)
    for wrong in (lambda: _fingers(["left=digit"], []), lambda: _fingers(["a=digit@b"], ["c=0,0,1"]),
                  lambda: _window("1:1@5"), lambda: _range("x")):  # fmt: skip
        with pytest.raises(UserError):
            wrong()
