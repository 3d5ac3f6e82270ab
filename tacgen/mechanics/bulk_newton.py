"""Newton's method on the bulk; within each step the contact is solved on the Schur complement of the tangent.

    until the residual is small:
        K <- tangent of the bulk at x, factorised            (kept while it contracts well)
        S <- Schur complement of K on the nodes near contact
        solve  (S + d S_0) u + load + contact(u) + friction(u) = 0        (see contact_newton)
            where that is unstable, or steps go in circles, d grows (Levenberg-Marquardt)
        p <- the step of all nodes that goes with u
        x <- x + a p   with the first a = 1, 1/2, 1/4... that lowers the energy, normal forces frozen

Folding of the gel's surface and wrinkling of its skin are instabilities: no quasi-static path continues, however short
the load steps are. There the damped steps decrease the energy until the next equilibrium, like a slightly viscous gel.
"""

import logging
from dataclasses import dataclass, replace

import numpy as np

from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.bulk import Bulk, BulkPoint
from tacgen.mechanics.condensation import DAMPING_FACTOR, LEAST_DAMPING
from tacgen.mechanics.contact_newton import ContactSolution, Quadratic, solve_contact
from tacgen.mechanics.coupled import CoupledContact
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.line_search import backtrack
from tacgen.mechanics.linear_solvers import NotPositiveDefinite
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History

Array = np.ndarray
MIN_GAIN = 1e-3  # decrease of the energy over the predicted one, below which a step is halved [-]
SHORTEST = 1 / 16  # shortest part of a step; below, it is repeated with more damping [-]
DAMPING_MAX = 2e3  # largest damping, over the stiffness at rest [-]
RATE_GUESS = 0.1  # assumed contraction of the residual by a kept tangent, before it is measured [-]
ROUNDING = 1e-12  # relative rounding error of the energy [-]
SQUEEZED = 0.2  # J below which the message of a failure reports it [-]
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Step:
    """Result of a step: the contact's equilibrium, or its state where only part of the step was taken; the new
    positions, the decrease of the energy over the predicted one (-inf if the contact diverged), the damping, and the
    part of the step that was taken."""

    inner: ContactSolution
    there: BulkPoint
    gain: float
    damping: float
    part: float = 1.0


class BulkNewton:
    """One solve; the tangent belongs to the problem and is kept between solves."""

    def __init__(self, problem: Problem, bulk: Bulk, history: History) -> None:
        self.problem, self.bulk, self.history = problem, bulk, history
        self.options, self.tangent = problem.options, problem.tangent
        self.xtol = self.options.step_tol * problem.contact.dhat
        self.floor = self.xtol * history.least_force  # [N mm], smaller differences of the energy are ignored
        self.damped = 0  # number of steps that needed damping

    def solve(self, x: Array, contact: CoupledContact) -> tuple[Array, CoupledContact, int]:
        """Positions, the contact with its offset there, and the number of steps. Raises NotConverged."""
        try:
            return self._solve(x, contact)
        except NotPositiveDefinite:
            raise failed(self.bulk, x, 0) from None

    def _solve(self, x: Array, contact: CoupledContact) -> tuple[Array, CoupledContact, int]:
        options, tangent, conn = self.options, self.tangent, contact.contact.faces.conn
        at = self.bulk.at(x)
        J = self.bulk.at(self.history.x).J if options.mixed_pressure else at.J
        new, residual, damping, rate, step = not options.keep_tangent, np.inf, 0.0, RATE_GUESS, 0
        for step in range(1, options.max_newton + 1):
            self.problem.effort.count()
            touching = self._touching(contact.contact, at.x)
            if not tangent.condensation.covers(conn[touching]):
                tangent.condensation.cover(with_neighbours(conn, touching))
            if new := new or not tangent.usable:
                tangent.take(at, J if options.mixed_pressure else None)
            found = self._step(at, J, contact, damping, insist=new)
            damping = found.damping
            if found.gain < MIN_GAIN:
                if new:
                    break
                new = True
                continue
            if found.damping > 0 and not options.through_folds:
                raise NotConverged(Failure.folds)
            self.damped += found.damping > 0
            moved = float(np.abs(found.there.x - at.x).max())
            contact = contact.shrunk(found.inner.contact.contact.offset)
            J = tangent.predicted(at, found.there) if options.mixed_pressure else found.there.J
            at, before, residual = found.there, residual, self._residual(found)
            log.debug(
                "step %d: %s tangent, %d in contact, moved %.1e mm, part %g, gain %.2f, damping %.1e, residual %.1e",
                step, "new" if new else "kept", found.inner.steps, moved, found.part, found.gain, damping, residual,
            )  # fmt: skip
            if self._ended(found, moved, residual) and self._covered(contact, at.x):
                return at.x, contact, step
            if np.isfinite(before):  # a kept tangent reduces the residual about half as much as a new one
                rate = (2 if new else 1) * residual / before
            damping = self._next_damping(found, residual < before)
            new = not options.keep_tangent or found.part < 1 or self._slow(residual, rate)
        raise failed(self.bulk, at.x, step)

    def _ended(self, found: Step, moved: float, residual: float) -> bool:
        options = self.options
        small = moved <= self.xtol and residual <= options.residual_max / 2 and found.damping == 0
        return found.inner.converged and (residual <= options.residual_tol or small)

    def _next_damping(self, found: Step, fell: bool) -> float:
        """Less after a full step; more if its contact did not converge and the residual did not fall: such steps go
        in circles, each with normal forces of its own."""
        if not found.inner.converged and found.inner.steps >= self.options.max_contact:
            return found.damping if fell else max(DAMPING_FACTOR * found.damping, LEAST_DAMPING)
        if found.part < 1:
            return found.damping
        return 0.0 if found.damping <= LEAST_DAMPING else found.damping / DAMPING_FACTOR

    def _slow(self, residual: float, rate: float) -> bool:
        """Whether the kept tangent would need more than `patience` further steps, at a contraction of `rate` each."""
        options = self.options
        return rate >= 1 or bool(np.log(options.residual_tol / residual) < options.patience * np.log(rate))

    def _step(self, at: BulkPoint, J: tuple[Array, ...], contact: CoupledContact, damping: float, insist: bool) -> Step:
        """A step with this damping; with `insist`, damping is increased until the energy decreases."""
        condensed = self.tangent.condensation
        g = self.tangent.unbalanced(at, J)
        y = condensed.forward(g)
        load, here, part = condensed.load(y), at.x[condensed.nodes], self._on_condensed(contact)
        schur = condensed.schur.damped(damping)
        while True:
            quadratic = Quadratic(here, condensed.dofs, schur, load)
            inner = solve_contact(
                quadratic, part, here, xtol=self.xtol, max_steps=self.options.max_contact, radius=self.problem.edge
            )
            found = (
                Step(inner, at, -np.inf, schur.damping) if inner.unstable else self._along(at, g, y, quadratic, inner)
            )
            if found.gain >= MIN_GAIN or not insist or schur.damping > DAMPING_MAX:
                return found
            schur = schur.more_damped()

    def _along(self, at: BulkPoint, g: Array, y: Array, quadratic: Quadratic, inner: ContactSolution) -> Step:
        """Line search: the first of the whole step, a half, a quarter... that lowers the energy, normal forces frozen.

        A step of the bulk that is too long turns elements inside out, mostly away from the contact, where damping does
        not help.
        """
        condensed, here, schur = self.tangent.condensation, quadratic.start, quadratic.schur
        u = (inner.x - here)[condensed.dofs >= 0]
        p, contact = condensed.expand(u, y), inner.contact
        before = contact.merit(here, inner.forces)
        contact_change = contact.merit(inner.x, inner.forces) - before
        # of the bulk g.p + p.Kp/2 = (g.p + p.(g + Kp))/2; g + Kp is 0 but for the condensed unknowns
        model = float((g * p).sum() + u @ (schur.S @ u + quadratic.force)) / 2 + contact_change
        rounding = self.floor + ROUNDING * abs(at.energy)

        def trial(part: float) -> tuple[bool, tuple[BulkPoint, float, float]]:
            there, touch = self.bulk.at(at.x + part * p), here + part * p[condensed.nodes]
            of_contact = contact_change if part == 1 else contact.merit(touch, inner.forces) - before
            change = there.energy - at.energy + of_contact
            gain = 1.0 if abs(change) <= rounding else change / min(part * model, -rounding)
            return gain >= MIN_GAIN, (there, gain, part)

        _, last = backtrack(trial, SHORTEST)
        assert last is not None
        there, gain, part = last
        if part < 1:
            x = there.x[condensed.nodes]
            inner = replace(inner, x=x, forces=contact.evaluate(x), converged=False)
        return Step(inner, there, gain, schur.damping, part)

    def _on_condensed(self, contact: CoupledContact) -> CoupledContact:
        """The contact on the condensed facets, with the numbers of the condensed nodes."""
        condensed, whole = self.tangent.condensation, contact.contact
        which = np.flatnonzero((condensed.local[whole.faces.conn] >= 0).all(1))
        faces = whole.faces.only(which)
        faces = replace(faces, conn=condensed.local[faces.conn])
        return replace(contact, contact=replace(whole, faces=faces), anchor=contact.anchor[which])

    def _touching(self, contact: Contact, x: Array) -> Array:
        """The facets (f,) on which the indenter acts; if none, those on which it acted last, or the nearest."""
        gap = contact.gaps(x)[0]
        now = (gap < contact.dhat).any(1)
        if now.any():
            return np.asarray(now)
        last = (self.history.normal_force > 0).any(1)
        return np.asarray(last if last.any() else gap.min(1) <= gap.min())

    def _covered(self, contact: CoupledContact, x: Array) -> bool:
        """Whether the indenter acts on condensed facets only."""
        touching = self._touching(contact.contact, x)
        return self.tangent.condensation.covers(contact.contact.faces.conn[touching])

    def _residual(self, found: Step) -> float:
        """2-norm of the forces at the free nodes, over the contact force [-]."""
        nodes, inner = self.tangent.condensation.nodes, found.inner
        r = found.there.gradient.copy()
        r[nodes] -= inner.contact.contact.faces.scatter(inner.forces.force, len(nodes))
        force = max(float(inner.forces.N.sum()), self.history.least_force)
        return float(np.linalg.norm(r.ravel()[self.problem.pattern.free])) / force


def with_neighbours(conn: Array, which: Array) -> Array:
    """Facets (f, a) that are marked, and those that share a node with them."""
    return np.asarray(conn[np.isin(conn, conn[which]).any(1)])


def failed(bulk: Bulk, x: Array, steps: int) -> NotConverged:
    """The failure to find an equilibrium in so many steps, which ended at x (n, 3)."""
    least = min(float(J.min()) for J in bulk.at(x).J)
    return NotConverged(Failure.squeezed if least < SQUEEZED else Failure.newton, steps=steps, least_J=least)
