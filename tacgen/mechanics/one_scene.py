"""The numerics of one scene on a core: NumPy's arrays, CHOLMOD's factors, LAPACK for the contact; see Numerics."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tacgen.fem.jacobian import least_jacobian
from tacgen.fem.potential import Total
from tacgen.geometry.pose import Pose
from tacgen.mechanics import contact_newton
from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.bulk import BulkPoint
from tacgen.mechanics.condensation import Condensation
from tacgen.mechanics.contact_newton import ContactIterate, Quadratic, QuadraticPoint
from tacgen.mechanics.coupled import CoupledContact
from tacgen.mechanics.course import Course
from tacgen.mechanics.failures import NotConverged
from tacgen.mechanics.linear_solvers import NotPositiveDefinite
from tacgen.mechanics.load_step import Equilibrium, LoadStep
from tacgen.mechanics.measures import (
    ENERGY_ROUNDING,
    MIN_ENERGY_GAIN,
    MIN_FORCE_SCALE_RATIO,
    dragged,
    gain,
    imbalance,
    predicted_change,
)
from tacgen.mechanics.numerics import Checked, Reached, StepEnd
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History
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

    step: LoadStep
    begins: Array  # x (n, 3) where Newton's method begins
    at: BulkPoint  # the iterate
    J: tuple[Array, ...]  # there, as the last step predicted it
    coupled: CoupledContact  # there
    touching: Array | None  # the facets on which the indenter acts there; None: not known yet
    path: tuple[Array, ...]  # x (n, 3) after each step, from the first that needed damping on
    making: Making
    direction: Direction
    there: BulkPoint  # after the part of it that was taken
    found: Equilibrium

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
        self.step = LoadStep.of(problem, history, Pose.of(leg.b), leg.duration)
        if not self.condensed:
            return [Outcome.not_condensed]
        tangent, contact = problem.tangent, self.step.contact
        conn, near = contact.faces.conn, contact.gap(history.x) < contact.dhat
        touching = np.asarray((near | (history.normal_force > 0)).any(1))
        if not touching.any():
            return [Outcome.apart]
        covered = tangent.usable and tangent.condensation.covers(conn[touching])
        if not covered:
            tangent.condensation.cover(with_neighbours(conn, touching))
        exact = not tangent.followed or tangent.exact_at is history.x
        return [Outcome.ready if covered and exact else Outcome.missing]

    def renew(self, rows: list[int]) -> list[bool]:
        return [self._taken(self.step.bulk.at(self.course.history.x), None)]

    def _taken(self, at: BulkPoint, J: tuple[Array, ...] | None) -> bool:
        try:
            self._problem.tangent.take(at, J)
        except NotPositiveDefinite:
            return False
        return True

    def predict(self, rows: list[int]) -> list[bool]:
        self.step = self.step.predicted()
        return [self.step.prediction is not None]

    def choose(self, rows: list[int]) -> list[bool]:
        near = self.course.near
        if (x := self.step.start(None if near is None else near.x)) is None:
            return [False]
        self.step, self.begins = self.step.anchored(), x
        return [True]

    def start(self, rows: list[int]) -> None:
        assert self.step.coupled is not None
        self.coupled, self.path, self.touching = self.step.coupled, (), None
        if self.condensed:
            self.at = self.step.bulk.at(self.begins)
            mixed = self.options.mixed_pressure
            self.J = self.step.bulk.at(self.course.history.x).J if mixed else self.at.J

    def whole(self, row: int) -> NotConverged | None:
        if isinstance(found := self.step.solve(self.begins), NotConverged):
            return found
        self.found, self.course.newton.steps = found, found.steps
        return None

    def follow(self, rows: list[int]) -> list[bool]:
        condensed, conn = self._problem.tangent.condensation, self.coupled.contact.faces.conn
        if self.touching is None:
            self.touching = touched(self.course.history, self.coupled.contact, self.at.x)
        if not condensed.covers(conn[self.touching]):
            condensed.cover(with_neighbours(conn, self.touching))
        return [self._problem.tangent.usable]

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
        there, touch = self.step.bulk.at(at.x + part * p), start + part * p[condensed.nodes]
        if part < 1:
            change = contact.merit(touch, inner.forces) - before
        total = np.array([there.energy - at.energy + change])
        rounding = self._end * self.course.history.least_force + ENERGY_ROUNDING * abs(at.energy)
        if not gain(total, np.array([part * predicted]), rounding)[0] >= MIN_ENERGY_GAIN:
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
        contact = self.coupled.contact
        self.touching = touched(course.history, contact, there.x)
        covered = tangent.condensation.covers(contact.faces.conn[self.touching])
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
        return self.step.bulk.least_J(self.begins if start else self.at.x)

    def check(self, rows: list[int]) -> list[Checked]:
        problem, course = self._problem, self.course
        if self.condensed:
            self.found = Equilibrium.coupled(self.at.x, self.coupled, course.newton.steps, self.path)
        x, forces, faces = self.found.x, self.found.forces, problem.contact.faces
        least_J = least_jacobian(problem.mesh.points, x, problem.mesh.cells)
        outer = faces.scatter(-forces.force, len(x))
        inner = Total((*self.step.bulk.elastic, *self.step.bulk.folding)).gradient(x)
        held = np.ones(x.size, bool)
        held[problem.pattern.free] = False
        force = max(float(np.linalg.norm(outer.sum(0))), course.history.least_force)
        outer += Total(self.step.bulk.other).gradient(x)
        residual, balance = imbalance(inner[None], outer[None], held.reshape(1, -1, 3), force)
        deep, through = self.step.penetration(self.found)
        return [Checked(self.found.least_gap, least_J, float(residual[0]), float(balance[0]), deep, through)]

    def stiffen(self, row: int, contact: bool, folding: bool) -> None:
        self.step, self.begins = self.step.stiffened(self.found, contact, folding), self.found.x

    def record(self, rows: list[int]) -> list[Reached]:
        problem, step, course = self._problem, self.step, self.course
        history, x, forces, coupled = course.history, self.found.x, self.found.forces, self.found.contact
        contact, N = coupled.contact, forces.N
        moved, slipped = dragged(coupled.anchor, forces.at, forces.normal, N, coupled.eps)
        # the anchor of a sliding point lags by eps; the slip of one that has stopped is still eps, within the tolerance
        sliding = (slipped > coupled.eps + self._end) & (N > 0)
        velocity = None if history.velocity is None else (x - history.x) / step.duration
        error, predicted = (p.error(x), p.x) if (p := step.prediction) else (None, None)
        return [
            Reached(
                x, N, forces.normal, forces.normal @ contact.pose.rotation, forces.force - N[..., None] * forces.normal,
                sliding, contact.pose.local(moved) if coupled.friction > 0 else history.anchor, forces.gap,
                contact.offset, contact.kappa, max(history.least_force, MIN_FORCE_SCALE_RATIO * float(N.sum())),
                forces.mean_gap if N.any() else contact.offset, velocity,
                problem.internal(history, x, step.duration), error, predicted,
            )
        ]  # fmt: skip

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
