"""Two fingers near one object become one grasp, whose table has the gripper between them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.small_recipe import row

from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.cli.touch import _fingers, _range, _window
from tacgen.recipe import pose_table, scene_of_row
from tacgen.touch import grasps, intervals, labels, scenes
from tacgen.touch.episode import EpisodeLog, Finger, Thing
from tacgen.touch.intervals import AtFinger
from tacgen.touch.scenes import TouchChoice
from touch.made_source import COARSE, Made, ball

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
