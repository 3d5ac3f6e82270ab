"""The checks that a load step must pass before it is recorded: nothing penetrates or inverts, and forces balance."""

from dataclasses import replace

import numpy as np

from tacgen.mechanics.course import Course
from tacgen.mechanics.failures import Failure
from tacgen.mechanics.numerics import Checked, Numerics, Reached
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History, State, joined

MAX_BARRIER_STIFFENINGS = 8  # most solves, with stiffer barriers each time, until nothing penetrates or inverts
# largest depth of the gel inside the indenter, over its reach [-]; at 1 it may come out on the far side
MAX_DEPTH_INSIDE = 0.45
SHARP_RADIUS_EDGES = 1.5  # indenter's smallest radius over the element edge, below which its edges count as sharp [-]
MIN_CROSSING_ANGLE = 0.3  # change of the indenter's normal at a point that counts as crossing an edge in one step [rad]


def admit(n: Numerics, rows: list[int]) -> list[Outcome]:
    """Whether no point is inside the shrunk indenter and no element is inverted, or barriers must be stiffer; whether
    forces balance. If so the load step is recorded."""
    found = dict(zip(rows, n.check(rows), strict=True))
    outcomes = {row: _checked(n, row, each) for row, each in found.items()}
    fine = [row for row, outcome in outcomes.items() if outcome is Outcome.ended]
    for row, reached in zip(fine, n.record(fine) if fine else (), strict=True):
        course = n.courses[row]
        state, after = _recorded(n.problem(row), course, reached, found[row])
        course.state = state if course.state is None else joined(course.state, state)
        course.history, course.legs, course.near = after, course.legs[1:], None
        outcomes[row] = Outcome.more if course.legs else Outcome.ended
    return list(outcomes.values())


def _checked(n: Numerics, row: int, found: Checked) -> Outcome:
    """`ended` for an equilibrium that may be recorded."""
    course, newton, problem = n.courses[row], n.courses[row].newton, n.problem(row)
    course.solves, course.steps = course.solves + 1, course.steps + newton.steps
    course.damped += newton.folding
    most, reach = n.options.fold_max if newton.folding else n.options.residual_max, problem.contact.shape.reach
    touching, inverted = not found.least_gap > 0, not found.least_J > 0
    if (touching or inverted) and course.solves < MAX_BARRIER_STIFFENINGS:
        n.stiffen(row, touching, inverted)
        return Outcome.stiffer
    if found.residual > most or found.balance > most or touching:
        figures = {name: getattr(found, name) for name in ("residual", "balance", "least_gap")}
        course.fail(Failure.unbalanced, **figures)
    elif inverted:
        course.fail(Failure.inverted, least_J=found.least_J)
    elif found.through:
        course.fail(Failure.snaps if newton.folding else Failure.too_far)
    elif found.deep > MAX_DEPTH_INSIDE * reach:  # from a thin wall's middle points may be pushed out on its far side
        course.fail(Failure.inside, width=2 * reach, depth=found.deep, edge=problem.edge)
    return Outcome.failure if course.failure else Outcome.ended


def _recorded(problem: Problem, course: Course, found: Reached, checked: Checked) -> tuple[State, History]:
    """The state at the end of a load step, and what the next one inherits."""
    before, after, friction, sliding = course.history, found.after, None, None
    after = replace(after, folded=folds_on(before, course.damped))
    if problem.friction > 0:
        friction, sliding = found.friction, found.sliding
    least_gap, least_J, residual, balance = checked[:4]
    state = State(
        course.index, course.legs[0].b, after.x, after.normal_force, found.outward, friction, sliding, course.steps, 1,
        after.offset, found.mean_gap, least_gap, residual, balance, least_J, course.damped,
        rounded=rounded(problem, before, after), unique=not after.folded, internal=after.internal, after=after,
    )  # fmt: skip
    return state, after


def folds_on(before: History, damped: int) -> bool:
    """Whether a gel has folded since it was last untouched, after a load step with so many damped steps."""
    return damped > 0 or (before.folded and bool(before.normal_force.any()))


def sharp(problem: Problem) -> bool:
    """Whether the indenter's edges are sharper than the mesh."""
    return problem.contact.shape.smallest_radius < SHARP_RADIUS_EDGES * problem.edge


def rounded(problem: Problem, before: History, after: History) -> float:
    """Friction at points that crossed a sharp edge in one step, over the larger contact force of both ends [-]; above
    .05 the result depends on the step size.

    Whether such a point is dragged or slips depends on its path round the edge.
    """
    if not problem.friction or not sharp(problem):
        return 0.0
    turned = np.linalg.norm(after.normal - before.normal, axis=-1) > MIN_CROSSING_ANGLE
    force = np.maximum(after.normal_force, before.normal_force)[turned].sum()
    whole = max(float(after.normal_force.sum()), float(before.normal_force.sum()), after.least_force)
    return problem.friction * float(force) / whole
