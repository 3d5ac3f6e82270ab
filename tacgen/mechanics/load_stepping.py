"""Load steps between frames: as short as contact and friction need, halved if a step does not converge."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from tacgen.geometry.pose import Pose, along, between
from tacgen.mechanics.admission import sharp
from tacgen.mechanics.failures import Failure
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.solve_state import Leg, SolveState, known
from tacgen.mechanics.state import History

Array = np.ndarray
FOLD_HALVINGS = 2  # most halvings of a load step until a damped step counts as a fold
TOO_FAR = 12  # most halvings of a load step in which the indenter might tunnel through the gel


def divided(
    problem: Problem, history: History, a: Array, b: Array, turn: Array, duration: float, shared: bool = False
) -> tuple[Leg, ...]:
    """The load steps from pose a to pose b; `shared`: they share their count of Newton steps with what came before."""
    n = max(problem.steps(duration), steps_needed(problem, history, a, b, turn))
    poses = pairwise([a, *along(a, b, turn, n)])
    return tuple(Leg(start, end, turn / n, duration / n, budget=not shared) for start, end in poses)


def halve(problem: Problem, now: SolveState) -> tuple[Outcome, SolveState]:
    """The failed load step as two halves, unless it has been halved as often as its failure allows."""
    if problem.condensed:
        problem.tangent.condensation.usable = False
    now, failure, leg = now.between(), known(now.failure).failure, now.legs[0]
    farther = failure == Failure.too_far
    most = FOLD_HALVINGS if failure == Failure.folds else problem.options.halvings
    spent = leg.far == TOO_FAR if farther else leg.halved >= most
    if spent or not now.may_halve or failure == Failure.effort:
        return Outcome.failure, now
    turn, middle = leg.turn / 2, between(leg.a, leg.b, leg.turn, 0.5)
    halved, far = leg.halved + (not farther), leg.far + farther
    half = leg._replace(turn=turn, duration=leg.duration / 2, halved=halved, far=far, budget=False)
    return Outcome.more, replace(now, legs=(half._replace(b=middle), half._replace(a=middle), *now.legs[1:]))


def steps_needed(problem: Problem, history: History, a: Array, b: Array, turn: Array) -> int:
    """Number of load steps from pose a to pose b, within the options `sink`, `slide` and `slide_sharp`."""
    deep = 0.0
    if problem.contact.overlaps:
        deep = -float(problem.contact.distance.moved(Pose.of(b), history.offset).gaps(history.x)[0].min())
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
