"""Which rows of an episode are solved, by distance alone, and at which rate."""

import numpy as np
import pytest
from helpers.small_recipe import row

from tacgen.recipe import scene_of_row
from tacgen.recipe.trajectory import Placement
from tacgen.replay import selection
from tacgen.touch import intervals
from tacgen.touch.episode import EpisodeLog, Thing
from tacgen.touch.intervals import BETWEEN_ROWS, AtFinger, Rate
from touch.made_source import FINGER, ball, episode, over

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
