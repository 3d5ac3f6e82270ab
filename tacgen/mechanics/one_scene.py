"""The numerics of one scene on a core: NumPy's arrays, CHOLMOD's factors, LAPACK for the contact; see Numerics."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tacgen.fem.jacobian import least_jacobian
from tacgen.geometry.pose import Pose
from tacgen.mechanics import contact_newton
from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.bulk import Bulk, BulkPoint
from tacgen.mechanics.condensation import Condensation
from tacgen.mechanics.contact_newton import ContactIterate, Quadratic, QuadraticPoint
from tacgen.mechanics.coupled import ContactForces, CoupledContact
from tacgen.mechanics.course import Course
from tacgen.mechanics.failures import NotConverged, no_equilibrium
from tacgen.mechanics.full_newton import WholeBulk
from tacgen.mechanics.linear_solvers import NotPositiveDefinite
from tacgen.mechanics.measures import (
    MIN_FORCE_SCALE_RATIO,
    dragged,
    imbalance,
    lowers,
    onset,
    predicted_change,
    touched,
)
from tacgen.mechanics.numerics import BARRIER_STIFFENING_FACTOR, Checked, Reached, StepEnd
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.predictor import Prediction, predict
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History
from tacgen.mechanics.tunnelling import blocked, blocked_along, depth_inside
from tacgen.physics.decisions import ContactStatus

Array = np.ndarray


@dataclass(frozen=True)
class Making:
    """A step of the bulk in the making: the unbalanced forces g (n, 3) [N], their forward substitution y, the bulk
    condensed to the contact, and the contact's iterate."""

    g: Array
    y: Array
    quadratic: Quadratic
    inner: ContactIterate[QuadraticPoint]


class Direction(NamedTuple):
    """A step p (n, 3) of all nodes [mm], the change of the energy that its quadratic model predicts, the contact's
    energy before it and its change after all of it [N mm]."""

    p: Array
    predicted: float
    before: float
    change: float


class OneScene:
    """A scene in row 0, and the iterates of its load step in hand."""

    placed: Contact  # at the pose of the load step, shrunk as at its start
    bulk: Bulk
    ahead: Array | None  # x (n, 3) by inertia; None without
    prediction: Prediction | None
    last: BulkPoint | None  # the last equilibrium in this load step's bulk; None: not evaluated yet
    begins: BulkPoint  # where Newton's method begins
    first: CoupledContact  # there, with its anchors
    at: BulkPoint  # the iterate
    J: tuple[Array, ...]  # there, as the last step predicted it
    coupled: CoupledContact  # there
    touching: Array | None  # the facets on which the indenter acts there; None: not known yet
    path: tuple[Array, ...]  # x (n, 3) after each step, from the first that needed damping on
    making: Making
    direction: Direction
    there: BulkPoint  # after the part of it that was taken
    forces: ContactForces  # of the contact at the equilibrium

    def __init__(self, problem: Problem, course: Course) -> None:
        self._problem, self.course, self.courses = problem, course, {0: course}
        self.options, self.condensed = problem.options, problem.condensed

    def problem(self, row: int) -> Problem:
        return self._problem

    @property
    def _end(self) -> float:
        """Motion of a node below which a step is small [mm]."""
        return self.options.step_tol * self._problem.contact.dhat

    def place(self, rows: list[int]) -> list[Outcome]:
        problem, course = self._problem, self.course
        history, leg = course.history, course.legs[0]
        contact = replace(problem.contact.moved(Pose.of(leg.b), history.offset), kappa=history.kappa)
        inertia, self.placed, self.ahead, self.prediction, self.last = None, contact, None, None, None
        if problem.body is not None:
            assert history.velocity is not None
            inertia = problem.body.step(history.x, history.velocity, leg.duration)
            self.ahead = inertia.coasting
        self.bulk = Bulk(problem.during(history, leg.duration), problem.folding, inertia)
        if not self.condensed:
            return [Outcome.not_condensed]
        tangent = problem.tangent
        conn, near = contact.faces.conn, contact.gap(history.x) < contact.dhat
        touching = np.asarray((near | (history.normal_force > 0)).any(1))
        if not touching.any():
            return [Outcome.apart]
        covered = tangent.usable and tangent.condensation.covers(conn[touching])
        if not covered:
            tangent.condensation.cover(with_neighbours(conn, touching))
        exact = not problem.differentiable or tangent.exact_at is history.x
        return [Outcome.ready if covered and exact else Outcome.missing]

    def renew(self, rows: list[int]) -> list[bool]:
        return [self._taken(self._at_last(), None)]

    def _at_last(self) -> BulkPoint:
        if self.last is None:
            self.last = self.bulk.at(self.course.history.x)
        return self.last

    def _taken(self, at: BulkPoint, J: tuple[Array, ...] | None) -> bool:
        try:
            self._problem.tangent.take(at, J)
        except NotPositiveDefinite:
            return False
        return True

    def predict(self, rows: list[int]) -> list[bool]:
        self.prediction = predict(self.placed, self._problem.tangent, self.course.history)
        return [self.prediction is not None]

    def choose(self, rows: list[int]) -> list[bool]:
        history, near, predicted = self.course.history, self.course.near, self.prediction
        guess = None if predicted is None else predicted.x
        for x in (None if near is None else near.x, guess, self.ahead, history.x):
            if x is None or blocked(self.placed, history.pose, history.x, history.gap, x):
                continue
            at = self._at_last() if x is history.x else self.bulk.at(x)
            if np.isfinite(at.energy):
                self.begins, self.first = at, self._anchored(history.x if guess is None else guess)
                return [True]
        return [False]

    def _anchored(self, x: Array) -> CoupledContact:
        """With anchors in the sensor frame; that of a new point is where it first touches on the predicted path to x
        (n, 3)."""
        history, contact, problem = self.course.history, self.placed, self._problem
        ahead, gap_ahead = contact.pose.local(contact.faces.at(x)), contact.gap(x)
        touch = onset(history.anchor, ahead, history.gap - contact.offset, gap_ahead - contact.offset)
        anchor = contact.pose.world(np.where(history.normal_force[..., None] > 0, history.anchor, touch))
        return CoupledContact(contact, problem.friction, anchor, problem.options.slip * contact.dhat)

    def start(self, rows: list[int]) -> None:
        self.coupled, self.path, self.touching = self.first, (), None
        if self.condensed:
            self.at = self.begins
            self.J = self._at_last().J if self.options.mixed_pressure else self.at.J

    def whole(self, row: int) -> NotConverged | None:
        bulk, most = WholeBulk(self._problem, self.bulk), self.options.max_newton
        found = contact_newton.solve_contact(bulk, self.first, self.begins.x, xtol=self._end, max_steps=most)
        if not found.converged:
            return no_equilibrium(found.here.least_J, found.steps)
        self.at, self.coupled, self.course.newton.steps = found.here, found.contact, found.steps
        return None

    def follow(self, rows: list[int]) -> list[bool]:
        condensed, conn = self._problem.tangent.condensation, self.coupled.contact.faces.conn
        if self.touching is None:
            self.touching = self._touched(self.at.x)
        if not condensed.covers(conn[self.touching]):
            condensed.cover(with_neighbours(conn, self.touching))
        return [self._problem.tangent.usable]

    def _touched(self, x: Array) -> Array:
        gap, dhat = self.coupled.contact.gap(x), self.coupled.contact.dhat
        return np.asarray(touched(gap, dhat, gap.min(), self.course.history.normal_force))

    def factor(self, rows: list[int]) -> list[bool]:
        return [self._taken(self.at, self.J if self.options.mixed_pressure else None)]

    def load(self, rows: list[int]) -> None:
        tangent, damping = self._problem.tangent, self.course.newton.inner_damping
        condensed, g = tangent.condensation, tangent.unbalanced(self.at, self.J)
        y = condensed.forward(g)
        start, schur = self.at.x[condensed.nodes], condensed.schur.damped(damping)
        self._untouched(g, y, Quadratic(start, condensed.dofs, schur, condensed.load(y)))

    def untouch(self, rows: list[int]) -> None:
        made, damping = self.making, self.course.newton.inner_damping
        self._untouched(made.g, made.y, replace(made.quadratic, schur=made.quadratic.schur.damped(damping)))

    def _untouched(self, g: Array, y: Array, quadratic: Quadratic) -> None:
        contact = on_condensed(self._problem.tangent.condensation, self.coupled)
        self.making = Making(g, y, quadratic, contact_newton.contact_start(quadratic, contact, quadratic.start))

    def contact(self, rows: list[int]) -> list[ContactStatus]:
        options, made = self.options, self.making
        inner = contact_newton.contact_step(
            made.quadratic, made.inner, xtol=self._end, max_steps=options.max_contact, radius=self._problem.edge
        )
        self.making = replace(made, inner=inner)
        self.course.newton.inner_damping = made.quadratic.schur.damping  # which the step may have increased
        return [inner.status]

    def lower(self, rows: list[int], part: float) -> list[bool]:
        made, at, condensed = self.making, self.at, self._problem.tangent.condensation
        inner, contact, start = made.inner, made.inner.contact, made.quadratic.start
        if part == 1:
            self.direction = self._direction()
        p, predicted, before, change = self.direction
        there, touch = self.bulk.at(at.x + part * p), start + part * p[condensed.nodes]
        if part < 1:
            change = contact.merit(touch, inner.forces) - before
        total, least = there.energy - at.energy + change, self.course.history.least_force
        if not lowers(total, np.float64(part * predicted), at.energy, self._end, least):
            return [False]
        if part < 1:
            self.making = replace(made, inner=replace(inner, x=touch, forces=contact.evaluate(touch)))
        self.there = there
        return [True]

    def _direction(self) -> Direction:
        """The step of all nodes that goes with the contact's."""
        made, condensed = self.making, self._problem.tangent.condensation
        inner, start = made.inner, made.quadratic.start
        u = (inner.x - start)[condensed.dofs >= 0]
        p = condensed.expand(u, made.y)
        before = inner.contact.merit(start, inner.forces)
        change = inner.contact.merit(inner.x, inner.forces) - before
        rest = made.quadratic.schur.times(u) + made.quadratic.force
        bulk = float(predicted_change(made.g[None], p[None], u[None], rest[None])[0])
        return Direction(p, bulk + change, before, change)

    def measure(self, rows: list[int]) -> list[StepEnd]:
        course, tangent, inner = self.course, self._problem.tangent, self.making.inner
        there, still = self.there, bool(np.abs(self.there.x - self.at.x).max() <= self._end)
        residual = self._residual(there)
        self.J = tangent.predicted(self.at, there) if self.options.mixed_pressure else there.J
        self.at, self.coupled = there, self.coupled.shrunk(inner.contact.contact.offset)
        self.path = (*self.path, there.x) if course.newton.inner_damping > 0 or self.path else ()
        self.touching = self._touched(there.x)
        covered = tangent.condensation.covers(self.coupled.contact.faces.conn[self.touching])
        circling, agrees = inner.status is ContactStatus.circling, not inner.off > self._end
        return [StepEnd(residual, still, covered, inner.converged, circling, agrees)]

    def _residual(self, there: BulkPoint) -> float:
        """2-norm of the forces at the free nodes, over the contact force [-]."""
        problem, inner = self._problem, self.making.inner
        nodes, r = problem.tangent.condensation.nodes, there.gradient.copy()
        r[nodes] -= inner.contact.contact.faces.scatter(inner.forces.force, len(nodes))
        force = max(float(inner.forces.N.sum()), self.course.history.least_force)
        return float(np.linalg.norm(r.ravel()[problem.pattern.free])) / force

    def least_J(self, row: int, start: bool) -> float:
        return (self.begins if start else self.at).least_J

    def check(self, rows: list[int]) -> list[Checked]:
        problem, history, x, contact = self._problem, self.course.history, self.at.x, self.coupled.contact
        self.forces = forces = self.coupled.evaluate(x)
        least_J = least_jacobian(problem.mesh.points, x, problem.mesh.cells)
        outer = contact.faces.scatter(-forces.force, len(x))
        inertia = self.at.inertial_forces
        held = np.ones(x.size, bool)
        held[problem.pattern.free] = False
        force = max(float(np.linalg.norm(outer.sum(0))), history.least_force)
        inner, outer = (self.at.gradient - inertia)[None], (outer + inertia)[None]
        residual, balance = imbalance(inner, outer, held.reshape(1, -1, 3), force)
        deep = depth_inside(contact, problem.elastic, x)
        through = blocked_along(contact, history.pose, history.x, history.gap, (*self.path, x))
        return [Checked(float(forces.gap.min()), least_J, float(residual[0]), float(balance[0]), deep, through)]

    def stiffen(self, row: int, contact: bool, folding: bool) -> None:
        self.first = self.coupled.stiffened(BARRIER_STIFFENING_FACTOR) if contact else self.coupled
        if folding:
            stiffer = (barrier.stiffened(BARRIER_STIFFENING_FACTOR) for barrier in self.bulk.folding)
            self.bulk, self.last = replace(self.bulk, folding=tuple(stiffer)), None
        self.begins = self.bulk.at(self.at.x)

    def record(self, rows: list[int]) -> list[Reached]:
        history, x, forces, coupled = self.course.history, self.at.x, self.forces, self.coupled
        leg, contact, N = self.course.legs[0], coupled.contact, forces.N
        moved, sliding = dragged(coupled.anchor, forces.at, forces.normal, N, coupled.eps, self._end)
        velocity = None if history.velocity is None else (x - history.x) / leg.duration
        error, predicted = (p.error(x), p.x) if (p := self.prediction) else (None, None)
        anchor = contact.pose.local(moved) if coupled.friction > 0 else history.anchor
        after = History(
            Pose.of(leg.b), x, contact.offset, N, forces.normal @ contact.pose.rotation, anchor, forces.gap,
            contact.kappa, max(history.least_force, MIN_FORCE_SCALE_RATIO * float(N.sum())), velocity,
            self._problem.internal(history, x, leg.duration), predictor_error=error, predicted=predicted,
        )  # fmt: skip
        friction = forces.force - N[..., None] * forces.normal
        return [Reached(after, forces.normal, friction, sliding, forces.mean_gap if N.any() else contact.offset)]

    def forget(self, row: int) -> None:
        if self.condensed:
            self._problem.tangent.condensation.usable = False


def on_condensed(condensed: Condensation, contact: CoupledContact) -> CoupledContact:
    """The contact on the condensed facets, with the numbers of the condensed nodes."""
    whole = contact.contact
    which = np.flatnonzero((condensed.local[whole.faces.conn] >= 0).all(1))
    faces = whole.faces.only(which)
    faces = replace(faces, conn=condensed.local[faces.conn])
    return replace(contact, contact=replace(whole, faces=faces), anchor=contact.anchor[which])


def with_neighbours(conn: Array, which: Array) -> Array:
    """Facets (f, a) that are marked, and those that share a node with them."""
    return np.asarray(conn[np.isin(conn, conn[which]).any(1)])
