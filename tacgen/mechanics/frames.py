"""The states of all frames along the path.

Each frame is at exactly the given pose, or at the height of the prescribed force. If a frame has no solution the
scene is rejected; for a force of a table that no height has, it is at the nearest one that was found, with a note.
`path` says what is to be solved, and whichever engine there is solves it.
"""

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from tacgen.geometry.pose import Pose, shortest_turn
from tacgen.mechanics.course import Course
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.force_control import HERTZ_LINEAR_POWER, End, meet
from tacgen.mechanics.load_stepping import at_once, to_pose
from tacgen.mechanics.options import DEFAULT_OPTIONS, tighter
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.scene import MAX_FORCE_SEARCH_DEPTH, Scene
from tacgen.mechanics.solver import solve
from tacgen.mechanics.state import History, State

Array = np.ndarray
INTERMEDIATE_FORCE_TOL = 1e-2  # tolerance of a force in the frames before the end of a movement [-]
GUESSED_DEPTH_RATIO = 0.1  # first depth in the search for a force without contact, over the gel's thickness [-]
MAX_GUESSED_DEPTH_RATIO = 0.5  # largest first depth by the pose of a table, over the gel's thickness [-]
ROUNDED_HEIGHT = 1e-9  # rounding error of a height [mm]
UNIT_RISE = np.outer(np.eye(4)[2], np.eye(4)[3])  # added to a pose: 1 mm along z


@dataclass
class Task:
    """A solve that a path needs: its problem and its record, which the caller replaces by the solved record."""

    problem: Problem
    now: Course


@dataclass(frozen=True)
class Aim:
    """A prescribed force: the `target` of a frame [N] within `tol` of it, from the force `before` [N]; `floor`: lowest
    height of the indenter's origin [mm]; `trusted`: the guess is better than what the force before tells."""

    target: float
    before: float
    floor: float
    tol: float
    trusted: bool = False


def _reach_force(
    problem: Problem, history: History, last: Array, guess: Array, index: int, duration: float, aim: Aim
) -> Generator[Task, None, Course]:
    """From pose `last` to the height with the force aimed at, else at pose `guess`: the last of the tasks.

    Every trial starts from the same history, so that rejected trials do not influence friction; all trials share one
    budget of Newton steps. Raises NotConverged: no height has that force.
    """
    target, before, floor = aim.target, aim.before, aim.floor
    trials: list[Course] = []

    def force_at(u: float) -> Generator[Task, None, float | None]:
        pose = guess.copy()
        pose[2, 3] = -u
        near = next((t.state for t in reversed(trials) if t.failure is None), None)
        effort = trials[-1].effort if trials else 0
        trials.append((yield from trial(problem, history, last, pose, index, duration, near, effort)))
        if (failure := trials[-1].failure) is not None:
            return None if failure.failure is Failure.effort else math.nan
        return normal_force(trials[-1].reached()[1])

    known, at = (-float(last[2, 3]), before), -float(guess[2, 3])
    face, elsewhere = (
        floor + MAX_FORCE_SEARCH_DEPTH * problem.thickness,
        not np.allclose((guess - last) * (1 - UNIT_RISE), 0),
    )
    contradicts = (at <= known[0]) == (target > before)
    if before > 0 and (not aim.trusted if elsewhere else contradicts):
        at = -face + (known[0] + face) * (target / before) ** HERTZ_LINEAR_POWER
    if elsewhere:
        known = -face, 0.0
    low = -max(last[2, 3], guess[2, 3], floor + problem.thickness)
    end = yield from meet(force_at, target, known=known, guess=at, low=low, high=-floor, tol=aim.tol)
    found = [t.reached()[1] for t in trials if t.failure is None]
    if end is End.met:
        history, state = trials[-1].reached()
        return replace(trials[-1], state=replace(state, iterations=sum(one.iterations for one in found)))
    most = max(map(normal_force, found), default=before)
    known_as = {"asked": target, "near": min(found, key=lambda one: abs(normal_force(one) - target), default=None)}
    if end is End.out_of_reach:
        most = normal_force(found[-1])
        raise NotConverged(Failure.too_much, **known_as, part=MAX_FORCE_SEARCH_DEPTH, most=most, index=index)
    refused = [t.failure for t in trials if t.failure is not None]
    if end is End.stopped:
        raise NotConverged(Failure.force_effort, **known_as, why=refused[-1], most=most)
    if not refused and (finer := _finer(problem)) is not None:  # tolerances are large beside light forces
        return (yield from _reach_force(finer, history, last, guess, index, duration, aim))
    why = refused[-1] if refused else f"not met within {aim.tol:g} of it in {len(trials)} trials"
    raise NotConverged(Failure.force, **known_as, most=most, why=why)


def _matched_force(
    problem: Problem, history: History, last: Array, pose: Array, index: int, duration: float, aim: Aim, lowest: float
) -> Generator[Task, None, tuple[Course, str]]:
    """As `_reach_force`, with a pose of a table as guess; if no height from `lowest` up has the force, the nearest one
    that was found, or that at the guess, and why. Raises NotConverged: there is no solution at that either."""
    face, guess = aim.floor + MAX_FORCE_SEARCH_DEPTH * problem.thickness, pose.copy()
    if not face - MAX_GUESSED_DEPTH_RATIO * problem.thickness < guess[2, 3] < face:
        guess[2, 3] = face - GUESSED_DEPTH_RATIO * problem.thickness
    try:
        found = yield from _reach_force(problem, history, last, guess, index, duration, aim)
        if (deep := lowest - found.reached()[1].pose[2, 3]) > ROUNDED_HEIGHT:
            raise NotConverged(Failure.deeper, asked=aim.target, depth=deep)
    except NotConverged as error:
        near = error.data.get("near")  # solved once more, so that it is the last that was solved
        at = guess if near is None else near.pose
        found = yield from trial(problem, history, last, at, index, duration, near)
        if found.failure is not None:
            raise error from None
        return found, str(error)
    return found, ""


def _finer(problem: Problem) -> Problem | None:
    """The problem with a tenth of the tolerances; None if they are smaller than the usual ones already."""
    if problem.options.step_tol < DEFAULT_OPTIONS.step_tol:
        return None
    return replace(problem, options=tighter(problem.options))


def _reach_pose(
    problem: Problem, history: History, last: Array, pose: Array, turn: Array, index: int, duration: float
) -> Generator[Task, None, Course]:
    """From pose `last` to `pose`; once more with smaller tolerances where forces do not balance with the usual ones."""
    task = Task(problem, to_pose(problem, history, last, pose, turn, index, duration))
    yield task
    failed, finer = task.now.failure, _finer(problem)
    if finer is None or failed is None or failed.failure is not Failure.unbalanced:
        return task.now
    task = Task(finer, to_pose(finer, history, last, pose, turn, index, duration))
    yield task
    return task.now


def trial(
    problem: Problem, history: History, last: Array, pose: Array, index: int, duration: float, near: State | None,
    effort: int = 0,
) -> Generator[Task, None, Course]:  # fmt: skip
    """From pose `last` to `pose`, counting Newton steps from `effort`; first in one step from a nearby solution."""
    if near is not None and near.substeps == 1:
        task = Task(problem, at_once(history, pose, index, duration, near=near, effort=effort))
        yield task
        if task.now.failure is None or task.now.failure.failure is Failure.effort:
            return task.now
        effort = task.now.effort
    turn = shortest_turn(last, pose)
    task = Task(problem, to_pose(problem, history, last, pose, turn, index, duration, effort=effort))
    yield task
    return task.now


def normal_force(state: State) -> float:
    """Force along z, positive when the gel is pressed down [N]."""
    return 0.0 - float(state.traction_force[..., 2].sum())  # without contact not -0


def states(scene: Scene, problem: Problem) -> Iterator[State]:
    """The gel at every frame of the path, in order.

    Raises:
        NotConverged: a frame has no solution; it and all later frames are missing, since each depends on the last.
    """
    for each in path(scene, problem):
        if isinstance(each, State):
            yield each
        else:
            each.now = solve(each.problem, each.now)


def path(scene: Scene, problem: Problem) -> Iterator[Task | State]:
    """The solves of a scene and the states of its frames: each state follows its solves. A solve must be done before
    the next item is requested. Raises NotConverged: a frame has no solution."""
    history, last = problem.rest(Pose.of(scene.start)), scene.start
    forced, match, shift, before, start_force = scene.forced, scene.match, 0.0, 0.0, 0.0
    for index, pose in enumerate(scene.poses[: forced.end if forced else None]):
        duration = math.inf if scene.duration is None else float(scene.duration[index])
        wanted = match[index] if match else None
        note = wanted.note if wanted else ""
        if forced is not None and forced.hopeless is not None and forced.hopeless[0] == index:
            raise forced.hopeless[1]
        if forced is not None and (index == 0 or scene.segment[index] != scene.segment[index - 1]):
            start_force = before
        if forced is not None and np.isfinite(asked := forced.asked[index]):
            target = start_force + forced.part[index] * (asked - start_force)
            tol = forced.tol or (problem.options.force_tol if forced.part[index] == 1 else INTERMEDIATE_FORCE_TOL)
            aim = Aim(target, before, forced.floor[index], tol, trusted=wanted is not None)
            if wanted is None:
                found = yield from _reach_force(problem, history, last, pose, index, duration, aim)
            else:
                guess, lowest = pose + shift * UNIT_RISE, pose[2, 3] - forced.below[index]
                found, note = yield from _matched_force(problem, history, last, guess, index, duration, aim, lowest)
            history, state = found.reached()
            shift = state.pose[2, 3] - pose[2, 3]
            if wanted is None and -shift > forced.below[index] + ROUNDED_HEIGHT:
                raise NotConverged(Failure.deeper, asked=target, depth=-shift)
        else:
            if forced is not None and shift:
                pose = pose + forced.carry[index] * shift * UNIT_RISE
            turn = shortest_turn(last, pose) if scene.turns is None else scene.turns[index]
            found = yield from _reach_pose(problem, history, last, pose, turn, index, duration)
            history, state = found.reached()
        if forced is not None:
            before = normal_force(state)
        yield replace(state, note=note) if note else state
        last = state.pose


@cache
def warm() -> None:
    """Load the compiled loops, once a process, by a ball that rubs a gel of a few cells: as long as several frames."""
    from tacgen.fem.materials import NeoHooke
    from tacgen.geometry.analytic_sdf import SphereSdf
    from tacgen.geometry.gel import GelBody, GelLayer
    from tacgen.mechanics import mesh

    gel = GelBody(3.0, 3.0, layers=(GelLayer(1.0, NeoHooke(0.05, 1.0), 0.15),))
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, 3] = [(0.0, 0.0, -0.1), (0.05, 0.0, -0.1)]
    start = np.eye(4)
    scene = Scene(gel, SphereSdf(1.5), poses, start, np.zeros(2, int), 0.5, 0.7, 0.05)
    for _ in states(scene, Problem.of(scene, mesh.build(gel, (-0.7, 0.7, -0.7, 0.7), 0.7))):
        pass
