"""Newton's method on the bulk; within each step the contact is solved on the Schur complement of the tangent.

    until the residual is small:
        K <- tangent of the bulk at x, factorised            (kept while it contracts well)
        S <- Schur complement of K on the nodes near contact
        solve  (S + d S_0) u + load + contact(u) + friction(u) = 0        (see contact_newton)
            where that is unstable, or steps go in circles, the load step is halved; in its quarters d grows
            (Levenberg-Marquardt)
        p <- the step of all nodes that goes with u
        x <- x + a p   with the first a = 1, 1/2, 1/4... that lowers the energy, normal forces frozen

Each function is one kernel: it takes the problem and a solve's SolveState, and returns what it found and the SolveState
after it; phases.PHASE_TRANSITIONS says which comes next.

Folding of the gel's surface and wrinkling of its skin are instabilities: no quasi-static path continues, however short
the load steps are. There the damped steps decrease the energy until the next equilibrium, like a slightly viscous gel.
In a load step that is merely long they would too, so damping waits until it has been halved.
"""

import logging
from dataclasses import replace

import numpy as np

from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.bulk import Bulk, BulkPoint
from tacgen.mechanics.condensation import DAMPING_FACTOR, MIN_DAMPING, Condensation, more
from tacgen.mechanics.contact_newton import (
    ContactIterate,
    ContactStatus,
    Quadratic,
    QuadraticPoint,
    contact_start,
    contact_step,
)
from tacgen.mechanics.coupled import CoupledContact
from tacgen.mechanics.failures import Failure, no_equilibrium
from tacgen.mechanics.line_search import backtrack
from tacgen.mechanics.linear_solvers import NotPositiveDefinite
from tacgen.mechanics.load_step import Found
from tacgen.mechanics.load_stepping import may_damp
from tacgen.mechanics.options import SolverOptions
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.solve_state import BulkIterate, Linearised, SolveState, Stepped, known
from tacgen.mechanics.state import History, State

Array = np.ndarray
Result = tuple[Outcome, SolveState]
MIN_ENERGY_GAIN = 1e-3  # decrease of the energy over the predicted one, below which a step is halved [-]
MIN_BULK_STEP = 1 / 16  # shortest part of a step; below, it is repeated with more damping [-]
MAX_DAMPING = 2e3  # largest damping, over the stiffness at rest [-]
ENERGY_ROUNDING = 1e-12  # relative rounding error of the energy [-]
log = logging.getLogger(__name__)


def begun(problem: Problem, bulk: Bulk, history: History, contact: CoupledContact, x: Array) -> BulkIterate:
    """Newton's method at its start x (n, 3)."""
    at, options = bulk.at(x), problem.options
    J = bulk.at(history.x).J if options.mixed_pressure else at.J
    return BulkIterate(x, at, J, contact, not options.keep_tangent)


def begin_step(problem: Problem, now: SolveState) -> Result:
    """Counts a step of the bulk; the nodes to condense to follow the contact."""
    newton, options, condensed = known(now.newton), problem.options, problem.tangent.condensation
    if newton.steps == options.max_newton:
        return Outcome.failure, failed(now, newton.at.x, newton.steps)
    now = replace(now, effort=now.effort + 1)
    if now.effort > options.max_effort:
        return Outcome.failure, now.failed(Failure.effort, steps=options.max_effort)
    conn = newton.contact.contact.faces.conn
    touching = touched(now.history, newton.contact.contact, newton.at.x)
    if not condensed.covers(conn[touching]):
        condensed.cover(with_neighbours(conn, touching))
    newton = replace(newton, steps=newton.steps + 1, new=newton.new or not problem.tangent.usable)
    return Outcome.missing if newton.new else Outcome.ready, replace(now, newton=newton)


def factor(problem: Problem, now: SolveState) -> Result:
    """The tangent at the iterate, with the pressures predicted."""
    newton = known(now.newton)
    try:
        problem.tangent.take(newton.at, newton.J if problem.options.mixed_pressure else None)
    except NotPositiveDefinite:
        return Outcome.indefinite, failed(now, newton.start, 0)
    return Outcome.ready, now


def load(problem: Problem, now: SolveState) -> Result:
    """The unbalanced forces, condensed, and the contact before its first step."""
    newton, condensed = known(now.newton), problem.tangent.condensation
    g = problem.tangent.unbalanced(newton.at, newton.J)
    y = condensed.forward(g)
    start, schur = newton.at.x[condensed.nodes], condensed.schur.damped(newton.damping)
    quadratic = Quadratic(start, condensed.dofs, schur, condensed.load(y))
    linear = Linearised(g, y, quadratic, _untouched(quadratic, condensed, newton.contact))
    return Outcome.ready, replace(now, newton=replace(newton, linear=linear))


def _untouched(
    quadratic: Quadratic, condensed: Condensation, contact: CoupledContact
) -> ContactIterate[QuadraticPoint]:
    """The contact before its first step."""
    return contact_start(quadratic, on_condensed(condensed, contact), quadratic.start)


def contact(problem: Problem, now: SolveState) -> Result:
    """One step of the contact."""
    newton, most = known(now.newton), problem.options.max_contact
    linear, xtol = known(newton.linear), steps_end(problem)
    inner = contact_step(linear.quadratic, linear.inner, xtol=xtol, max_steps=most, radius=problem.edge)
    ends = {ContactStatus.running: Outcome.more, ContactStatus.unstable: Outcome.unstable}
    return ends.get(inner.status, Outcome.ended), replace(
        now, newton=replace(newton, linear=replace(linear, inner=inner))
    )


def damp(problem: Problem, now: SolveState) -> Result:
    """No step lowers the energy: with a kept tangent, a new one; with a new one, a shorter load step; in one that is
    short, more damping."""
    newton = known(now.newton)
    linear = known(newton.linear)
    if not newton.new:
        newton = replace(newton, damping=linear.damping, new=True, linear=None)
        return Outcome.missing, replace(now, newton=newton)
    if not may_damp(now.history, now.legs[0], problem.options):
        return Outcome.failure, now.failed(Failure.folds)
    if linear.damping > MAX_DAMPING:
        return Outcome.failure, failed(now, newton.at.x, newton.steps)
    quadratic = replace(linear.quadratic, schur=linear.quadratic.schur.more_damped())
    inner = _untouched(quadratic, problem.tangent.condensation, newton.contact)
    linear = replace(linear, quadratic=quadratic, inner=inner)
    return Outcome.ready, replace(now, newton=replace(newton, linear=linear))


def search(problem: Problem, now: SolveState) -> Result:
    """Line search: the first of the whole step, a half, a quarter... that lowers the energy, normal forces frozen.

    A step of the bulk that is too long turns elements inside out, mostly away from the contact, where damping does
    not help.
    """
    newton, condensed = known(now.newton), problem.tangent.condensation
    at, linear, bulk = newton.at, known(newton.linear), _bulk(now)
    inner, here, schur = linear.inner, linear.quadratic.start, linear.quadratic.schur
    contact = inner.contact
    u = (inner.x - here)[condensed.dofs >= 0]
    p = condensed.expand(u, linear.y)
    before = contact.merit(here, inner.forces)
    contact_change = contact.merit(inner.x, inner.forces) - before
    # of the bulk g.p + p.Kp/2 = (g.p + p.(g + Kp))/2; g + Kp is 0 but for the condensed unknowns
    model = float((linear.g * p).sum() + u @ (schur.S @ u + linear.quadratic.force)) / 2 + contact_change
    rounding = steps_end(problem) * now.history.least_force + ENERGY_ROUNDING * abs(at.energy)

    def trial(part: float) -> tuple[bool, tuple[BulkPoint, float, float]]:
        there, touch = bulk.at(at.x + part * p), here + part * p[condensed.nodes]
        of_contact = contact_change if part == 1 else contact.merit(touch, inner.forces) - before
        change = there.energy - at.energy + of_contact
        gain = 1.0 if abs(change) <= rounding else change / min(part * model, -rounding)
        return gain >= MIN_ENERGY_GAIN, (there, gain, part)

    found, last = backtrack(trial, MIN_BULK_STEP)
    if not found:
        return Outcome.higher, now
    assert last is not None
    there, gain, part = last
    if part < 1:
        x, status = there.x[condensed.nodes], ContactStatus.stopped if inner.converged else inner.status
        inner = replace(inner, x=x, forces=contact.evaluate(x), status=status)
    return Outcome.ready, replace(now, newton=replace(newton, stepped=Stepped(there, part, gain, inner)))


def measure(problem: Problem, now: SolveState) -> Result:
    """The residual after a step: whether it is small enough, and else the damping and the tangent of the next one."""
    newton, options = known(now.newton), problem.options
    step, damping, at = known(newton.stepped), known(newton.linear).damping, newton.at
    there, moved = step.there, float(np.abs(step.there.x - at.x).max())
    J = problem.tangent.predicted(at, there) if options.mixed_pressure else there.J
    before, residual = newton.residual, _residual(problem, now.history, step)
    log.debug(
        "step %d: %s tangent, %d in contact, moved %.1e mm, part %g, gain %.2f, damping %.1e, residual %.1e",
        newton.steps, "new" if newton.new else "kept", step.inner.steps, moved, step.part, step.gain, damping, residual,
    )  # fmt: skip
    newton = replace(
        newton, at=there, J=J, contact=newton.contact.shrunk(step.inner.contact.contact.offset), residual=residual,
        path=(*newton.path, there.x) if damping > 0 or newton.path else (), linear=None, stepped=None,
    )  # fmt: skip
    end, circling = steps_end(problem), step.inner.status is ContactStatus.circling
    still, converged, rests = moved <= end, step.inner.converged, circling and step.inner.off <= end
    folding = in_folds(len(newton.path), now.state)
    if settles(options, residual, folding, damping, still, converged, rests) and _covered(problem, now.history, newton):
        found = Found.coupled(there.x, newton.contact, newton.steps, newton.path)
        return Outcome.ended, replace(now, newton=newton, found=found)
    rate = newton.rate
    if np.isfinite(before):  # a kept tangent reduces the residual about half as much as a new one
        rate = (2 if newton.new else 1) * residual / before
    new = not options.keep_tangent or step.part < 1 or slow(options, residual, rate)
    damping = next_damping(damping, step.part, circling, residual < before)
    if damping > 0 and not may_damp(now.history, now.legs[0], options):
        return Outcome.failure, now.failed(Failure.folds)
    return Outcome.more, replace(now, newton=replace(newton, rate=rate, damping=damping, new=new))


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


def _covered(problem: Problem, history: History, newton: BulkIterate) -> bool:
    """Whether the indenter acts on condensed facets only."""
    contact = newton.contact.contact
    touching = touched(history, contact, newton.at.x)
    return problem.tangent.condensation.covers(contact.faces.conn[touching])


def _residual(problem: Problem, history: History, step: Stepped) -> float:
    """2-norm of the forces at the free nodes, over the contact force [-]."""
    nodes, inner = problem.tangent.condensation.nodes, step.inner
    r = step.there.gradient.copy()
    r[nodes] -= inner.contact.contact.faces.scatter(inner.forces.force, len(nodes))
    force = max(float(inner.forces.N.sum()), history.least_force)
    return float(np.linalg.norm(r.ravel()[problem.pattern.free])) / force


def steps_end(problem: Problem) -> float:
    """Motion of a node below which a step is small [mm]."""
    return problem.options.step_tol * problem.contact.dhat


def on_condensed(condensed: Condensation, contact: CoupledContact) -> CoupledContact:
    """The contact on the condensed facets, with the numbers of the condensed nodes."""
    whole = contact.contact
    which = np.flatnonzero((condensed.local[whole.faces.conn] >= 0).all(1))
    faces = whole.faces.only(which)
    faces = replace(faces, conn=condensed.local[faces.conn])
    return replace(contact, contact=replace(whole, faces=faces), anchor=contact.anchor[which])


def touched(history: History, contact: Contact, x: Array) -> Array:
    """The facets (f,) on which the indenter acts; if none, those on which it acted last, or the nearest."""
    gap = contact.gap(x)
    now = (gap < contact.dhat).any(1)
    if now.any():
        return np.asarray(now)
    last = (history.normal_force > 0).any(1)
    return np.asarray(last if last.any() else gap.min(1) <= gap.min())


def with_neighbours(conn: Array, which: Array) -> Array:
    """Facets (f, a) that are marked, and those that share a node with them."""
    return np.asarray(conn[np.isin(conn, conn[which]).any(1)])


def _bulk(now: SolveState) -> Bulk:
    """The bulk of a load step whose contact is condensed."""
    assert now.step is not None
    assert isinstance(now.step.bulk, Bulk)
    return now.step.bulk


def failed(now: SolveState, x: Array, steps: int) -> SolveState:
    """No equilibrium in so many steps, which ended at x (n, 3)."""
    return replace(now, failure=no_equilibrium(_bulk(now).at(x).J, steps))
