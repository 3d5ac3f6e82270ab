"""Load steps between frames: as short as contact and friction need, halved if a step does not converge."""

import math
from itertools import pairwise
from typing import Any

import numpy as np

from tacgen.geometry.pose import Pose, along, between
from tacgen.mechanics.admission import sharp
from tacgen.mechanics.course import Course, Leg
from tacgen.mechanics.failures import Failure
from tacgen.mechanics.numerics import Numerics
from tacgen.mechanics.options import SolverOptions
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History

Array = np.ndarray
MAX_TUNNELLING_HALVINGS = 12  # most halvings of a load step in which the indenter might tunnel through the gel


def to_pose(
    problem: Problem, history: History, a: Array, b: Array, turn: Array, index: int, duration: float, **how: Any
) -> Course:
    """Before the first load step from pose a to pose b (4, 4) at constant speed, rotating by `turn` (3,) [rad], in
    `duration` [s].

    how: other fields of Course; with an `effort`, all load steps share the count of Newton steps, which begins
    with it.
    """
    n = max(problem.steps(duration), steps_needed(problem, history, a, b, turn))
    poses = pairwise([a, *along(a, b, turn, n)])
    legs = tuple(Leg(start, end, turn / n, duration / n, budget="effort" not in how) for start, end in poses)
    return Course(index, history, legs, **how)


def at_once(history: History, b: Array, index: int, duration: float = math.inf, **how: Any) -> Course:
    """Before a load step, which is not halved, from `history` to pose b (4, 4) in `duration` [s]; how: as to_pose."""
    leg = Leg(b, b, np.zeros(3), duration, budget="effort" not in how)
    return Course(index, history, (leg,), may_halve=False, **how)


def halve(n: Numerics, rows: list[int]) -> list[Outcome]:
    """Failed load steps as two halves each, unless one has been halved as often as its failure allows."""
    outcomes = []
    for row in rows:
        course = n.courses[row]
        n.forget(row)
        assert course.failure is not None
        halves = halved(course.legs[0], course.failure.failure, n.options) if course.may_halve else ()
        course.legs = (*halves, *course.legs[1:]) if halves else course.legs
        outcomes.append(Outcome.more if halves else Outcome.failure)
    return outcomes


def halved(leg: Leg, failure: Failure, options: SolverOptions) -> tuple[Leg, ...]:
    """Two halves of a load step that failed; none if it has been halved as often as its failure allows."""
    farther = failure == Failure.too_far
    most = options.fold_halvings if failure in (Failure.folds, Failure.snaps) else options.halvings
    if (leg.far == MAX_TUNNELLING_HALVINGS if farther else leg.halved >= most) or failure == Failure.effort:
        return ()
    middle, times, far = between(leg.a, leg.b, leg.turn, 0.5), leg.halved + (not farther), leg.far + farther
    half = leg._replace(turn=leg.turn / 2, duration=leg.duration / 2, halved=times, far=far, budget=False)
    return half._replace(b=middle), half._replace(a=middle)


def may_damp(history: History, leg: Leg, options: SolverOptions) -> bool:
    """Whether a load step may be damped: it is so short that only a fold needs that, or the gel has folded before."""
    return options.through_folds and (history.folded or leg.halved >= options.fold_halvings)


def steps_needed(problem: Problem, history: History, a: Array, b: Array, turn: Array) -> int:
    """Number of load steps from pose a to pose b, within the options `sink`, `slide` and `slide_sharp`."""
    deep = -problem.contact.moved(Pose.of(b), history.offset).least(history.x)
    pressing = math.ceil(deep / (problem.options.sink * problem.edge) - 1e-9)
    return max(1, pressing, _steps_to_slide(problem, history, a, b, turn))


def _steps_to_slide(problem: Problem, history: History, a: Array, b: Array, turn: Array) -> int:
    touching = history.normal_force > 0
    if problem.friction == 0 or not touching.any():
        return 1
    at = problem.contact.faces.at(history.x)[touching] - a[:3, 3]
    angle = float(np.linalg.norm(turn))
    arm = np.linalg.norm(np.cross(at, turn / angle), axis=-1).max() if angle > 1e-12 else 0.0
    move = b[:3, 3] - a[:3, 3]
    normal = history.normal[touching] @ history.pose.rotation.T
    weight = history.normal_force[touching]
    mean = (weight[:, None] * normal).sum(0) / weight.sum()
    sliding = float(np.linalg.norm(move - (move @ mean) * mean)) + angle * float(arm)
    options = problem.options
    farthest = (options.slide_sharp if sharp(problem) else options.slide) * problem.edge
    return math.ceil(sliding / farthest - 1e-9)
