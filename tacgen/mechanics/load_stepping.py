"""Load steps between frames: as short as contact and friction need, halved if a step does not converge."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from tacgen.geometry.pose import Pose, along, between
from tacgen.mechanics.equilibrium import equilibrium
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History, State

Array = np.ndarray
FOLD_HALVINGS = 2  # most halvings of a load step until a damped step counts as a fold
TOO_FAR = 12  # most halvings of a load step in which the indenter might tunnel through the gel
SHARP = 1.5  # indenter's smallest radius over the element edge, below which its edges count as sharp [-]
TURNED = 0.3  # change of the indenter's normal at a point that counts as crossing an edge in one step [rad]


def rounded(problem: Problem, before: History, after: History) -> float:
    """Friction at points that crossed a sharp edge in one step, over the larger contact force of both ends [-]; above
    .05 the result depends on the step size.

    Whether such a point is dragged or slips depends on its path round the edge.
    """
    if not problem.friction or not _sharp(problem):
        return 0.0
    turned = np.linalg.norm(after.normal - before.normal, axis=-1) > TURNED
    force = np.maximum(after.normal_force, before.normal_force)[turned].sum()
    whole = max(float(after.normal_force.sum()), float(before.normal_force.sum()), after.least_force)
    return problem.friction * float(force) / whole


def _sharp(problem: Problem) -> bool:
    return problem.contact.shape.smallest_radius < SHARP * problem.edge


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
    farthest = (options.slide_sharp if _sharp(problem) else options.slide) * problem.edge
    return math.ceil(sliding / farthest - 1e-9)


def _reach(
    problem: Problem, history: History, a: Array, b: Array, turn: Array, index: int, duration: float, halved: int = 0,
    far: int = 0,
) -> tuple[History, State]:  # fmt: skip
    """From pose a to pose b in one load step, or in two halves if it fails or is too long."""
    try:
        after, state = equilibrium(problem, history, b, index, duration)
        return after, replace(state, rounded=rounded(problem, history, after))
    except NotConverged as error:
        farther = error.failure == Failure.too_far
        most = FOLD_HALVINGS if error.failure == Failure.folds else problem.options.halvings
        spent = far == TOO_FAR if farther else halved >= most
        if spent or error.failure == Failure.effort:
            raise
        halved, far = halved + (not farther), far + farther
    middle = between(a, b, turn, 0.5)
    there, first = _reach(problem, history, a, middle, turn / 2, index, duration / 2, halved, far)
    there, second = _reach(problem, there, middle, b, turn / 2, index, duration / 2, halved, far)
    return there, _joined(first, second)


def advance(
    problem: Problem,
    history: History,
    a: Array,
    b: Array,
    turn: Array,
    index: int,
    duration: float,
    trial: bool = False,
) -> tuple[History, State]:
    """From pose a to pose b at constant speed, rotating by `turn` (3,) [rad].

    A `trial` shares its budget of Newton steps with other trials; otherwise each load step has its own.
    """
    n, total = max(problem.steps(duration), steps_needed(problem, history, a, b, turn)), None
    for start, end in pairwise([a, *along(a, b, turn, n)]):
        if not trial:
            problem.effort.steps = 0
        history, state = _reach(problem, history, start, end, turn / n, index, duration / n)
        total = state if total is None else _joined(total, state)
    assert total is not None
    return history, total


def _joined(first: State, second: State) -> State:
    """The second state, with the iterations and substeps of both."""
    both = {name: getattr(first, name) + getattr(second, name) for name in ("iterations", "damped", "substeps")}
    assert first.after is not None
    passed = (*first.passed, first.after, *second.passed)
    return replace(second, **both, rounded=max(first.rounded, second.rounded), passed=passed)
