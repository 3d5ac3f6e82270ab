"""A frame turns by the way that the recipe says, once around and more, in as many steps as friction needs."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers import small_recipe
from helpers.load_steps import watched
from helpers.presses import gel, poses, problem_of, scene
from helpers.solves import advance
from scipy.spatial.transform import Rotation

from tacgen.geometry.analytic_sdf import BoxSdf, Shape, SphereSdf
from tacgen.geometry.pose import Pose, along, between, shortest_turn
from tacgen.mechanics import Failure, NotConverged, Problem, SolverOptions
from tacgen.mechanics.course import Course
from tacgen.mechanics.load_stepping import steps_needed
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.state import History
from tacgen.recipe import scene_of_row

Array = np.ndarray
ANGLES = [30.0, 179.0, 181.0, 190.0, -190.0, 360.0, 720.0, -1000.0]


def built(*moves: str, sets: tuple[str, ...] = ()) -> Scene:
    return scene_of_row.build(small_recipe.row(", ".join(moves), *sets))


def about(axis: Array, degrees: float) -> Array:
    return np.asarray(Rotation.from_rotvec(np.radians(degrees) * np.asarray(axis)).as_matrix())


def turned(pose: Array) -> float:
    """By how much about z an upright indenter is turned (-180 to 180) [deg]."""
    return float(np.degrees(np.arctan2(pose[1, 0], pose[0, 0])))


def from_to(made: Scene, frame: int) -> tuple[Array, Array, Array]:
    """Of a frame: the pose before it, its own, and the turn between."""
    assert made.turns is not None
    return made.poses[frame - 1] if frame else made.start, made.poses[frame], made.turns[frame]


@pytest.mark.parametrize("angle", ANGLES)
def test_a_twist_goes_all_the_way_around_that_is_asked_for(angle: float) -> None:
    made = built(small_recipe.PRESS, f"twist: {{angle_deg: {angle}, frames: 1}}")
    a, b, turn = from_to(made, 1)
    assert turn == pytest.approx([0, 0, np.radians(angle)])
    assert b[:3, :3] == pytest.approx(about([0, 0, 1], angle), abs=1e-12)
    steps = along(a, b, turn, 12)
    assert len(steps) == 12
    assert (steps[-1] == b).all()
    for k, pose in enumerate(steps, 1):
        assert pose[:3, :3] == pytest.approx(about([0, 0, 1], angle * k / 12), abs=1e-12)
        assert pose[:3, 3] == pytest.approx([0, 0, -0.4], abs=1e-12)
        assert pose[3] == pytest.approx([0, 0, 0, 1])
        assert (between(a, b, turn, k / 12) == pose).all()
    ways = [np.degrees(np.linalg.norm(shortest_turn(one, two))) for one, two in pairwise([a, *steps])]
    assert sum(ways) == pytest.approx(abs(angle))


def test_a_leaning_indenter_is_twisted_about_its_own_axis_and_tilted_about_the_gels() -> None:
    tilt = "tilt: {angle_deg: 8, axis_deg: 90, frames: 2}"
    made = built(small_recipe.PRESS, tilt, "twist: {angle_deg: 200, frames: 1}")
    lean = about([0, 1, 0], 8)
    for frame in (1, 2):
        a, b, turn = from_to(made, frame)
        assert np.degrees(turn) == pytest.approx([0, 4, 0], abs=1e-12)
        assert between(a, b, turn, 0.5)[:3, :3] == pytest.approx(about([0, 1, 0], 4 * frame - 2), abs=1e-12)
    a, b, turn = from_to(made, 3)
    assert np.degrees(turn) == pytest.approx(200 * lean[:, 2])
    for part in (0.1, 0.5, 0.8, 1.0):
        expected = lean @ about([0, 0, 1], 200 * part)
        assert between(a, b, turn, part)[:3, :3] == pytest.approx(expected, abs=1e-12)


def test_a_replay_turns_by_the_shorter_way(tmp_path: Path) -> None:
    rows = enumerate(np.radians([0.0, 100.0, 290.0]))
    lines = [f"{t},0,0,-0.3,{np.cos(a / 2)},0,0,{np.sin(a / 2)}" for t, a in rows]
    (tmp_path / "poses.csv").write_text("\n".join(["t,x,y,z,qw,qx,qy,qz", *lines]) + "\n")
    made = built(f"replay: {{file: {tmp_path}/poses.csv, units: mm}}")
    assert made.turns is not None
    assert np.degrees(made.turns)[:, 2] == pytest.approx([0, 100, -170])


def small(shape: Shape, friction: float = 0.6, options: SolverOptions | None = None) -> tuple[Scene, Problem]:
    """An indenter pressed in by .3 mm, to be turned."""
    made = scene(shape, poses([(0.0, 0.0, -0.3)]), pad=gel(8, 8, 2.0), friction=friction, edge=0.6)
    return made, problem_of(made, 1.8, options or SolverOptions())


def pressed(made: Scene, problem: Problem) -> History:
    rest = problem.rest(Pose.of(made.start))
    return advance(problem, rest, made.start, made.poses[0], np.zeros(3), 0, 0.0).history


def rotated(pose: Array, turn: Array) -> Array:
    out = pose.copy()
    out[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ pose[:3, :3]
    return out


def test_the_steps_a_turn_needs_grow_with_its_angle_and_its_arm() -> None:
    """So many that no point in contact is carried on by more than the options say; 720 deg end where they began."""
    made, problem = small(SphereSdf(2.5))
    history, a = pressed(made, problem), made.poses[0]

    def steps(degrees: float, move: tuple[float, float, float] = (0, 0, 0)) -> int:
        turn = np.array([0, 0, np.radians(degrees)])
        b = rotated(a, turn)
        b[:3, 3] += move
        return steps_needed(problem, history, a, b, turn)

    at = problem.contact.faces.at(history.x)[history.normal_force > 0]
    arm, farthest = np.hypot(at[:, 0], at[:, 1]).max(), problem.options.slide * problem.edge
    assert arm > 0.5
    angles = np.array([0.0, 5.0, 60.0, 190.0, 360.0, 720.0, -720.0])
    expected = np.maximum(1, np.ceil(np.radians(np.abs(angles)) * arm / farthest))
    assert [steps(angle) for angle in angles] == expected.tolist()
    assert expected[-1] > 3 * expected[3] > 9
    assert steps(0, (0, 0, -0.2)) == 1  # a press carries nothing along the face
    assert steps(0, (2.5 * farthest, 0, 0)) == 3
    assert steps(190, (2.5 * farthest, 0, 0)) == np.ceil(np.radians(190) * arm / farthest + 2.5)


def test_a_turn_needs_short_steps_only_where_it_rubs_and_sharp_edges_shorter_ones() -> None:
    turn = np.array([0, 0, np.radians(720)])
    made, smooth = small(SphereSdf(2.5), friction=0.0)
    a = made.poses[0]
    assert steps_needed(smooth, pressed(made, smooth), a, a, turn) == 1
    made, problem = small(BoxSdf(1.6, 1.6, 0.5), options=SolverOptions(slide=0.6, slide_sharp=0.6))
    assert steps_needed(problem, problem.rest(Pose.of(made.start)), a, a, turn) == 1
    history = pressed(made, problem)
    usual = steps_needed(problem, history, a, a, turn)
    finer = replace(problem, options=SolverOptions(slide=0.6, slide_sharp=0.2))
    assert steps_needed(finer, history, a, a, turn) == pytest.approx(3 * usual, abs=3)


@pytest.mark.parametrize("angle", [190.0, -190.0])
def test_a_turn_that_fails_is_halved_on_its_own_way(angle: float, monkeypatch: pytest.MonkeyPatch) -> None:
    made, problem = small(SphereSdf(2.5), friction=0.0)
    history, a = pressed(made, problem), made.poses[0]
    turn = np.array([0, 0, np.radians(angle)])

    def refuse(now: Course) -> NotConverged | None:
        """Turns of more than 60 degrees at once."""
        way = Rotation.from_matrix(now.legs[0].b[:3, :3] @ now.history.pose.rotation.T).magnitude()
        return NotConverged(Failure.newton, steps=1) if np.degrees(way) > 60 else None

    done = watched(monkeypatch, refuse)
    after, state = advance(problem, history, a, rotated(a, turn), turn, 1, 0.0).reached()
    sign = np.sign(angle)
    assert np.array([turned(leg.b) for leg in done]) == pytest.approx(sign * np.array([47.5, 95, 142.5, -170]))
    assert state.substeps == 4
    assert after.pose.rotation == pytest.approx(about([0, 0, 1], angle), abs=1e-12)
