"""Prescribed forces in the batch engine: it makes the trials of the CPU engine's search, each from the same history."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")


from tacgen.geometry.analytic_sdf import CylinderSdf, SphereSdf
from tacgen.geometry.pose import Pose
from tacgen.mechanics import DEFAULT_OPTIONS, NotConverged, Problem, normal_force, solver, states
from tacgen.mechanics.course import Course
from tacgen.mechanics.failures import Failure
from tacgen.mechanics.frames import Task
from tacgen.mechanics.load_stepping import at_once, to_pose
from tacgen.mechanics.scene import Forced, Match, Scene
from tacgen.tensor_engine import engine, pool
from tacgen.tensor_engine.engine import Solved
from tensor_engine.batches import alone, batch, path, problem, small, solve
from tensor_engine.test_engine import all_same, same

torch.set_num_threads(1)
BALL = SphereSdf(2.5)


def forced(made: Scene, asked: Sequence[float], part: Sequence[float] = (), **how: Any) -> Scene:
    """With forces at frames [N], nan where there is none; heights of the frames behind are carried along."""
    one = np.ones(len(asked))
    parts = np.array(part) if part else one
    return replace(made, forced=Forced(np.array(asked), parts, one, -1.6 * one, **({"below": 1.5 * one} | how)))


RUBBED = forced(small(BALL, path((0, 0, -0.3), (0.3, 0, -0.3), (0.3, 0.2, -0.3)), friction=0.5), [0.3, 0.5, np.nan])
IN_STEPS = replace(
    forced(small(SphereSdf(2.0), path((0, 0, -0.3), (0, 0, -0.5), (0, 0, -0.6))), [0.2, 0.6, 0.6], [1, 0.5, 1]),
    segment=np.array([0, 1, 1]),
)
PUNCH = forced(small(CylinderSdf(1.2, 0.2), path((0, 0, -0.1), (0, 0, -0.5)), friction=0.8), [0.5, 0.05])


def test_forces_are_met_as_by_the_cpu_engine_and_again_with_the_same_bytes() -> None:
    scenes = [RUBBED, IN_STEPS, PUNCH]
    found, again = (solve(batch(scenes), scenes) for _ in range(2))
    all_same(scenes, found, 1e-8)
    forces = [[normal_force(state) for state in each.states] for each in found]
    assert forces[0][:2] == pytest.approx([0.3, 0.5], rel=DEFAULT_OPTIONS.force_tol)
    assert forces[1] == pytest.approx([0.2, 0.4, 0.6], rel=1e-2)
    assert forces[2] == pytest.approx([0.5, 0.05], rel=DEFAULT_OPTIONS.force_tol)
    assert found[0].states[2].pose[2, 3] == pytest.approx(found[0].states[1].pose[2, 3], abs=1e-12)
    for one, two in zip(found, again, strict=True):
        assert all(a.x.tobytes() == b.x.tobytes() for a, b in zip(one.states, two.states, strict=True))


def test_trials_that_do_not_converge_at_once_go_in_steps() -> None:
    options = replace(DEFAULT_OPTIONS, max_newton=2)
    (found,) = solve(batch([PUNCH], options), [PUNCH])
    assert found.why is None
    one = alone(PUNCH, options)
    assert max(state.substeps for state in one) > 1
    for a, b in zip(one, found.states, strict=True):
        same(a, b, 1e-8)


def test_a_trial_begins_near_another_one_is_not_halved_and_shares_its_count_of_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of four trials from one history the second and the fourth fail."""

    def trials(made: Scene, problem: Problem) -> Iterator[Task]:
        history = problem.rest(Pose.of(made.start))
        first = Task(problem, at_once(history, made.poses[0], 0))
        yield first
        yield Task(problem, at_once(history, made.poses[1], 1))
        yield Task(problem, at_once(history, made.poses[2], 2, near=first.now.state))
        effort = problem.options.max_effort - 1
        yield Task(problem, to_pose(problem, history, made.start, made.poses[2], np.zeros(3), 3, 0.0, effort=effort))

    made = small(BALL, path((0, 0, -0.3), (0, 0, -1.2), (0, 0, -0.32)))
    options, made = replace(DEFAULT_OPTIONS, max_newton=4), forced(made, [np.nan] * 3)
    ends: dict[str, list[Course]] = {"one": [], "many": []}

    def noted(made: Scene, problem: Problem) -> Iterator[Task]:
        for task in trials(made, problem):
            yield task
            ends["many"].append(task.now)

    monkeypatch.setattr(engine, "path", noted)
    solve(batch([made], options), [made])
    for task in trials(made, problem(made, options)):
        task.now = solver.solve(task.problem, task.now)
        ends["one"].append(task.now)
    assert [str(now.failure) for now in ends["many"]] == [str(now.failure) for now in ends["one"]]
    assert [now.failure is None for now in ends["one"]] == [True, False, True, False]
    for one, many in zip(ends["one"], ends["many"], strict=True):
        assert many.effort == one.effort
        assert (one.state is None) == (many.state is None)
        if one.state is not None and many.state is not None:
            same(one.state, many.state, 1e-9)


HARD = path((0, 0, -0.2), (0, 0, -0.5))
NO_MORE = NotConverged(Failure.hopeless, why="no")
FAILURES = {  # what is asked for, how, and the options
    Failure.too_much: ([np.nan, 50.0], {}, DEFAULT_OPTIONS),
    Failure.deeper: ([0.2, 0.7], {"below": np.full(2, 0.01)}, DEFAULT_OPTIONS),
    Failure.force_effort: ([np.nan, 1.0], {}, replace(DEFAULT_OPTIONS, max_effort=7)),
    Failure.force: ([1.0, np.nan], {}, replace(DEFAULT_OPTIONS, max_newton=1, halvings=0)),
    Failure.hopeless: ([np.nan, 1.0], {"hopeless": (1, NO_MORE)}, DEFAULT_OPTIONS),
}


@pytest.mark.parametrize("failure", FAILURES)
def test_a_force_that_cannot_be_met_fails_as_in_the_cpu_engine(failure: Failure) -> None:
    asked, how, options = FAILURES[failure]
    made = forced(small(BALL, HARD), asked, **how)
    ((solved,), one, why) = solve(batch([made], options), [made]), [], None
    try:
        one += states(made, problem(made, options))
    except NotConverged as error:
        why = error
    assert isinstance(solved.why, NotConverged)
    assert solved.why.failure is failure
    assert isinstance(why, NotConverged)
    if failure is Failure.force:  # which of many trials with a single step each end is a matter of rounding
        assert solved.why.data["most"] == pytest.approx(why.data["most"], abs=1e-4)
    else:
        assert str(solved.why) == str(why)
    assert len(solved.states) == len(one)


def test_each_trial_has_kernel_calls_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the one slot, after another scene: a frame takes some four trials."""
    monkeypatch.setattr(pool, "MAX_FIRST_CALLS", 45)
    made = forced(small(BALL, path((0, 0, -0.3))), [0.3])
    for _, solved in pool.solved([small(BALL, path((0, 0, -0.2))), made], slots=1, share=False, patient=False):
        assert solved.why is None
    assert normal_force(solved.states[0]) == pytest.approx(0.3, rel=DEFAULT_OPTIONS.force_tol)


def test_a_scene_without_a_first_frame_leaves_its_slot() -> None:
    made = forced(small(BALL, HARD), [1.0, 1.0], hopeless=(0, NO_MORE))
    found = dict(pool.solved([made, small(BALL, path((0, 0, -0.2)))], slots=1, share=False))
    assert found[0] == Solved([], NO_MORE)
    assert found[1].why is None


def test_tighter_tolerances_are_left_to_the_cpu_engine() -> None:
    """With which it searches on where a force is too small for the usual ones; a batch has one."""
    made = forced(small(BALL, path((0, 0, -0.2))), [0.3], tol=1e-15)
    (solved,) = solve(batch([made]), [made])
    assert solved == Solved([], "forces need smaller tolerances than the batch has")


def test_a_table_is_met_as_by_the_cpu_engine_with_the_nearest_force_where_none_is_found() -> None:
    """The second row asks for more than the depth allows; the third goes on from what was found instead."""
    poses, force = path((0, 0, -0.1), (0, 0, -1.5), (0.2, 0, 0.4)), np.array([0.3, 50.0, 0.4])
    made = forced(small(BALL, poses, friction=0.5), force.tolist(), below=np.full(3, 2.0))
    assert made.forced is not None
    low = replace(made.forced, floor=np.full(3, -0.6))
    made = replace(made, forced=low, match=Match(np.ones(3, bool), poses, force, ("", "", "")))
    (solved,) = solve(batch([made]), [made])
    assert solved.why is None
    all_same([made], [solved], 1e-8)
    one = alone(made, DEFAULT_OPTIONS)
    assert [state.note for state in solved.states] == [state.note for state in one]
    assert "80% of the gel's thickness gives" in solved.states[1].note
    assert [normal_force(solved.states[k]) for k in (0, 2)] == pytest.approx([0.3, 0.4], rel=DEFAULT_OPTIONS.force_tol)
