"""Newton's method on the bulk; within each step the contact is solved on the Schur complement of the tangent.

    until the residual is small:
        K <- tangent of the bulk at x, factorised            (kept while it contracts well)
        S <- Schur complement of K on the nodes near contact
        solve  (S + d S_0) u + load + contact(u) + friction(u) = 0        (see contact_newton)
            where that is unstable, or steps go in circles, the load step is halved; in its quarters d grows
            (Levenberg-Marquardt)
        p <- the step of all nodes that goes with u
        x <- x + a p   with the first a = 1, 1/2, 1/4... that lowers the energy, normal forces frozen

Each function is one kernel: it takes the numerics and the rows of scenes that wait for it, and returns an outcome for
each; phases.PHASE_TRANSITIONS says which comes next.

Folding of the gel's surface and wrinkling of its skin are instabilities: no quasi-static path continues, however short
the load steps are. There the damped steps decrease the energy until the next equilibrium, like a slightly viscous gel.
In a load step that is merely long they would too, so damping waits until it has been halved.
"""

import logging

import numpy as np

from tacgen.mechanics.condensation import DAMPING_FACTOR, MIN_DAMPING, more
from tacgen.mechanics.course import Course
from tacgen.mechanics.failures import Failure, no_equilibrium
from tacgen.mechanics.load_stepping import may_damp
from tacgen.mechanics.numerics import Numerics, StepEnd
from tacgen.mechanics.options import SolverOptions
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.state import State
from tacgen.physics.decisions import ContactStatus

MIN_BULK_STEP = 1 / 16  # shortest part of a step; below, it is repeated with more damping [-]
MAX_DAMPING = 2e3  # largest damping, over the stiffness at rest [-]
CONTACT_OUTCOMES = {
    ContactStatus.running: Outcome.more, ContactStatus.searching: Outcome.more,
    ContactStatus.unstable: Outcome.unstable,
}  # fmt: skip
log = logging.getLogger(__name__)


def begin_step(n: Numerics, rows: list[int]) -> list[Outcome]:
    """Counts a step of the bulk; the nodes to condense to follow the contact."""
    going = [row for row in rows if _counted(n, row)]
    for row, serves in zip(going, n.follow(going) if going else (), strict=True):
        newton = n.courses[row].newton
        newton.new = newton.new or not serves
    missing = {row: n.courses[row].newton.new for row in going}
    return [(Outcome.missing if missing[row] else Outcome.ready) if row in missing else Outcome.failure for row in rows]


def _counted(n: Numerics, row: int) -> bool:
    """Counts a step; whether there may be one more."""
    course, options = n.courses[row], n.options
    if course.newton.steps == options.max_newton:
        _fail(n, row)
        return False
    course.effort += 1
    if course.effort > options.max_effort:
        course.fail(Failure.effort, steps=options.max_effort)
        return False
    course.newton.steps += 1
    return True


def factor(n: Numerics, rows: list[int]) -> list[Outcome]:
    """The tangents at the iterates, with the pressures predicted."""
    outcomes = []
    for row, definite in zip(rows, n.factor(rows), strict=True):
        if not definite:
            n.courses[row].failure = no_equilibrium(n.least_J(row, True), 0)
        outcomes.append(Outcome.ready if definite else Outcome.indefinite)
    return outcomes


def load(n: Numerics, rows: list[int]) -> list[Outcome]:
    """The unbalanced forces, condensed, and the contact before its first step."""
    for row in rows:
        n.courses[row].newton.inner_damping = n.courses[row].newton.damping
    n.load(rows)
    return [Outcome.ready] * len(rows)


def contact(n: Numerics, rows: list[int]) -> list[Outcome]:
    """One step of the contact, or a part of one."""
    return [CONTACT_OUTCOMES.get(status, Outcome.ended) for status in n.contact(rows)]


def damp(n: Numerics, rows: list[int]) -> list[Outcome]:
    """No step lowers the energy: with a kept tangent, a new one; with a new one, a shorter load step; in one that is
    short, more damping."""
    outcomes, again = [], list[int]()
    for row in rows:
        course, newton = n.courses[row], n.courses[row].newton
        if not newton.new:
            newton.damping, newton.new = newton.inner_damping, True
            outcomes.append(Outcome.missing)
            continue
        if not may_damp(course.history, course.legs[0], n.options):
            course.fail(Failure.folds)
        elif newton.inner_damping > MAX_DAMPING:
            _fail(n, row)
        else:
            newton.inner_damping = more(newton.inner_damping)
            again.append(row)
        outcomes.append(Outcome.failure if course.failure else Outcome.ready)
    if again:
        n.untouch(again)
    return outcomes


def search(n: Numerics, rows: list[int]) -> list[Outcome]:
    """Line search: the first of the whole step, a half, a quarter... that lowers the energy, normal forces frozen.

    A step of the bulk that is too long turns elements inside out, mostly away from the contact, where damping does
    not help.
    """
    part, left = 1.0, list(rows)
    while left and part >= MIN_BULK_STEP:  # nearly all take the whole step
        for row, lower in zip(list(left), n.lower(left, part), strict=True):
            if lower:
                n.courses[row].newton.part = part
                left.remove(row)
        part /= 2
    return [Outcome.higher if row in left else Outcome.ready for row in rows]


def measure(n: Numerics, rows: list[int]) -> list[Outcome]:
    """The residual after a step: whether it is small enough, and else the damping and the tangent of the next one."""
    return [_measured(n.options, n.courses[row], told) for row, told in zip(rows, n.measure(rows), strict=True)]


def _measured(options: SolverOptions, course: Course, told: StepEnd) -> Outcome:
    newton, residual = course.newton, told.residual
    damping, before, part = newton.inner_damping, newton.residual, newton.part
    log.debug(
        "step %d: %s tangent, part %g, damping %.1e, residual %.1e",
        newton.steps, "new" if newton.new else "kept", part, damping, residual,
    )  # fmt: skip
    newton.residual, newton.folding = residual, newton.folding + (damping > 0 or newton.folding > 0)
    converged, rests = told.converged and part == 1, told.circling and told.agrees
    folding = in_folds(newton.folding, course.state)
    if settles(options, residual, folding, damping, told.still, converged, rests) and told.covered:
        course.found = True
        return Outcome.ended
    if np.isfinite(before):  # a kept tangent reduces the residual about half as much as a new one
        newton.rate = (2 if newton.new else 1) * residual / before
    newton.new = not options.keep_tangent or part < 1 or slow(options, residual, newton.rate)
    newton.damping = next_damping(damping, part, told.circling, residual < before)
    if newton.damping > 0 and not may_damp(course.history, course.legs[0], options):
        course.fail(Failure.folds)
        return Outcome.failure
    return Outcome.more


def in_folds(steps: int, state: State | None) -> int:
    """Newton steps in the folds of a frame; 0 where the present load step, with `steps`, has not folded."""
    return steps + (state.damped if state and steps else 0)


def settles(
    options: SolverOptions, residual: float, folding: int, damping: float, still: bool, converged: bool, rests: bool
) -> bool:
    """Whether a step ends Newton's method: its contact converged and the residual [-] is small, or the last step was
    (`still`) and the residual is half of what a frame may have.

    The same is enough where contact goes in circles and its mean gap agrees (`rests`). A point then alternates
    between the two sides of an edge of the indenter, and a shorter load step would meet the same edge.

    After `folding` steps in a fold (see in_folds) the residual may be as large as the error that folds have anyway; a
    step that needs no damping is about to converge.
    """
    most = options.residual_tol
    if still or rests:
        most = max(most, options.residual_max / 2)
    if folding:
        most = options.fold_max if folding >= options.fold_steps and damping > 0 else options.fold_tol
    return (converged or rests) and residual <= most


def next_damping(damping: float, part: float, circling: bool, fell: bool) -> float:
    """Less after a full step; more if its contact went in circles and the residual did not fall."""
    if circling:
        return damping if fell else more(damping)
    if part < 1:
        return damping
    return 0.0 if damping <= MIN_DAMPING else damping / DAMPING_FACTOR


def slow(options: SolverOptions, residual: float, rate: float) -> bool:
    """Whether the kept tangent would need more than `patience` further steps, at a contraction of `rate` each."""
    return rate >= 1 or bool(np.log(options.residual_tol / residual) < options.patience * np.log(rate))


def _fail(n: Numerics, row: int) -> None:
    """No equilibrium in the steps so far."""
    course = n.courses[row]
    course.failure = no_equilibrium(n.least_J(row, False), course.newton.steps)
