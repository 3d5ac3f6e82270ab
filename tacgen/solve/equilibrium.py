"""One load step: the gel at equilibrium under the indenter at one pose.

    x <- prediction                                          (the gel carried along with the indenter)
    until the residual is small:
        K <- tangent of the bulk at x, factorised            (kept while it contracts well)
        S <- Schur complement of K on the nodes near contact
        solve  S u + load + contact(u) + friction(u) = 0     (Newton's method, non-symmetric; see contact_newton)
        p <- the step of all nodes that goes with u
        x <- x + a p                                         (a: backtracking on the energy, normal forces frozen)
"""

from dataclasses import dataclass, replace

import numpy as np

from tacgen.fem import friction as fr
from tacgen.fem.contact import Contact, Pose
from tacgen.fem.coupled_contact import ContactForces, CoupledContact
from tacgen.fem.jacobian import least_jacobian
from tacgen.fem.potential import Potential, Total
from tacgen.fem.tunnelling import blocked, depth_inside
from tacgen.solve import full_newton
from tacgen.solve.bulk import Bulk, BulkPoint
from tacgen.solve.condensation import Schur
from tacgen.solve.contact_newton import ContactSolution, Quadratic, solve_contact
from tacgen.solve.linear_solvers import NotPositiveDefinite
from tacgen.solve.mesh_contact import LaggedContact, MeshLoadStep
from tacgen.solve.predictor import Prediction, predict
from tacgen.solve.problem import Problem
from tacgen.solve.state import History, NotConverged, State, TooFar

Array = np.ndarray
NEGLIGIBLE = 1e-3  # of the largest contact force so far: below it forces are not told apart
INSIDE = 0.45  # of the indenter's reach: how deep integration points may be inside it
SQUEEZED = 0.2  # of its volume: J below it is named where no equilibrium is found
STIFFENINGS = 8  # of the barrier, each time by STIFFER, until no point is inside the indenter
STIFFER = 4.0
BAD = 1e-3  # of the predicted decrease of the energy: a step that brings less is taken again, with more damping
DAMPING_MAX = 1e5  # times the smallest
USUAL = 0.1  # contraction of the residual by a kept tangent, until it is known
ROUNDING = 1e-12  # of the energy


@dataclass(frozen=True)
class Found:
    """Where a solve ended: positions, the contact as it is there (offset included) and its forces, smallest gap [mm]
    and Newton steps."""

    x: Array
    contact: CoupledContact | LaggedContact
    forces: ContactForces
    least_gap: float
    steps: int

    @classmethod
    def coupled(cls, x: Array, contact: CoupledContact, steps: int) -> "Found":
        forces = contact.evaluate(x)
        return cls(x, contact, forces, float(forces.gap.min()), steps)


class LoadStep:
    """The contact, the bulk and the prediction at one pose."""

    def __init__(self, problem: Problem, history: History, pose: Pose, duration: float) -> None:
        assert isinstance(problem.contact, Contact)
        self.problem, self.history, self.duration = problem, history, duration
        self.options = problem.options
        contact = replace(problem.contact.moved(pose, history.offset), kappa=history.kappa)
        self.dhat, self.prediction = contact.dhat, None
        inert: tuple[Potential, ...] = ()
        self.ahead = None
        if problem.body is not None:
            assert history.velocity is not None
            inertia = problem.body.step(history.x, history.velocity, duration)
            inert, self.ahead = (inertia,), inertia.coasting
        self.inert = Total(inert)
        self.bulk = Bulk(problem.elastic, problem.folding, inert)
        if problem.condensed:
            self.prediction = self._predict(contact, pose)
        self.contact = CoupledContact(contact, problem.friction, self._anchors(contact), self.options.slip * self.dhat)

    def _predict(self, contact: Contact, pose: Pose) -> Prediction | None:
        """Where the tangent at the last equilibrium carries the gel; that tangent is made ready for the first step.

        Taken at a guess instead, it is often indefinite: the guess has pressures of its own.
        """
        history, tangent, conn = self.history, self.problem.tangent, contact.faces.conn
        touching = (history.normal_force > 0).any(1) | (contact.gaps(history.x)[0] < contact.dhat).any(1)
        if not touching.any():
            return None
        if not tangent.usable or not self._covered(conn[touching]):
            tangent.condensation.cover(_with_neighbours(conn, touching))
            try:
                tangent.take(self.bulk, self.bulk.at(history.x), None)
            except NotPositiveDefinite:
                return None
        return predict(contact, tangent, history, pose) if self.options.predict else None

    def _anchors(self, contact: Contact) -> Array:
        """Anchors in the sensor frame; a new point gets one where it will first touch, as predicted."""
        history = self.history
        x = history.x if self.prediction is None else self.prediction.x
        ahead, gap_ahead = contact.pose.local(contact.faces.at(x)), contact.gaps(x)[0]
        touch = fr.onset(history.anchor, ahead, history.gap - contact.offset, gap_ahead - contact.offset)
        return contact.pose.world(np.where(history.normal_force[..., None] > 0, history.anchor, touch))

    def start(self, near: Array | None) -> Array:
        """Where Newton starts: the candidate of lowest energy to which the indenter lets the gel come.

        Raises TooFar: there is none.
        """
        history, contact = self.history, self.contact.contact
        guesses = [near, None if self.prediction is None else self.prediction.x, self.ahead, history.x]
        starts = [
            x for x in guesses
            if x is not None and not blocked(contact, history.pose, history.x, history.gap, x)
        ]  # fmt: skip
        if not starts:
            raise TooFar("the indenter would pass through the gel")
        energies = [self.bulk.at(x).energy + contact.value(x) for x in starts]
        if not np.isfinite(min(energies)):
            raise TooFar("the gel cannot follow the indenter that far at once")
        return starts[int(np.argmin(energies))]

    def solve(self, x: Array) -> Found:
        """Raises NotConverged."""
        if not self.problem.condensed:
            found = full_newton.solve(self.problem, self.bulk, self.contact, x)
            if not found.converged:
                raise NotConverged(self._why(found.x, found.steps))
            return Found.coupled(found.x, found.contact, found.steps)
        try:
            return self._condensed(x)
        except NotPositiveDefinite:
            raise NotConverged(self._why(x, 0)) from None

    def _condensed(self, x: Array) -> Found:
        options, tangent = self.options, self.problem.tangent
        conn, contact = self.contact.contact.faces.conn, self.contact
        at = self.bulk.at(x)
        J = self.bulk.at(self.history.x).J if options.mixed_pressure else at.J
        tangent.contraction, fresh, residual, damping = USUAL, not options.keep_tangent, np.inf, 0.0
        for step in range(1, options.max_newton + 1):
            self.problem.effort.count()
            touching = self._touching(contact.contact, x)
            if not self._covered(conn[touching]):
                tangent.condensation.cover(_with_neighbours(conn, touching))
            if new := fresh or not tangent.usable:
                tangent.take(self.bulk, at, J if options.mixed_pressure else None)
            inner, there, gain, damping = self._bulk_step(at, J, contact, damping, new)
            if TRACE:
                c = tangent.condensation
                print(f"   step {step} new {new} proj {tangent.projected} k {c.size} inner {inner.steps}{'b' if inner.bounded else '' if inner.converged else '!'} |p| {np.abs(there.x-x).max():.2e} gain {gain:.3f} damp {damping/c.schur.least_damping:.2g}", end=" ")
            if gain < BAD:
                if TRACE: print("bad")
                if new:
                    break
                fresh = True
                continue
            contact = contact.shrunk(inner.contact.contact.offset)
            J = tangent.predicted(at, there) if options.mixed_pressure else there.J
            moved = float(np.abs(there.x - x).max())
            x, at, before, residual = there.x, there, residual, self._residual(there, inner)
            if TRACE: print(f"r {residual:.1e} c {tangent.contraction:.2g}")
            if np.isfinite(before):  # a step with the same tangent as one before contracts about half as well
                tangent.contraction = (2 if new else 1) * residual / before
            small = moved <= options.step_tol * self.dhat and residual <= options.residual_max / 2
            if inner.converged and (residual <= options.residual_tol or (small and damping == 0)):
                if self._covered(conn[self._touching(contact.contact, x)]):
                    return Found.coupled(x, contact, step)
            if damping > 0:
                damping = 0.0 if damping <= tangent.condensation.schur.least_damping else damping / 4
            fresh = not options.keep_tangent or self._slow(residual)
        raise NotConverged(self._why(x, step))

    def _slow(self, residual: float) -> bool:
        """Whether the kept tangent would take more than `patience` further steps."""
        options, rate = self.options, self.problem.tangent.contraction
        return rate >= 1 or bool(np.log(options.residual_tol / residual) < options.patience * np.log(rate))

    def _bulk_step(
        self, at: BulkPoint, J: tuple[Array, ...], contact: CoupledContact, damping: float, insist: bool
    ) -> tuple[ContactSolution, BulkPoint, float, float]:
        """Contact brought to equilibrium on the condensed bulk, where that leads, by how much it lowers the energy as a
        part of what the model predicts, and the damping [N/mm] it took: if asked to `insist`, more until it does."""
        tangent, options = self.problem.tangent, self.options
        condensed, x = tangent.condensation, at.x
        g = tangent.unbalanced(at, J)
        y = condensed.forward(g)
        load, here, part = condensed.load(y), x[condensed.nodes], self._on_condensed(contact)
        schur = Schur(condensed.schur.undamped, damping) if damping else condensed.schur
        while True:
            quadratic = Quadratic(here, condensed.dofs, schur, load)
            xtol = options.step_tol * self.dhat
            inner = solve_contact(
                quadratic, part, here, xtol=xtol, max_steps=options.max_contact, radius=self.problem.edge
            )
            there, gain = at, -np.inf
            if not inner.bounded:
                u = (inner.x - here)[condensed.dofs >= 0]
                p = condensed.expand(u, y)
                there = self.bulk.at(x + p)
                felt = inner.contact.merit(inner.x, inner.forces) - inner.contact.merit(here, inner.forces)
                # of the quadratic bulk, and contact with the normal forces found: (g . p + p . K p)/2 is half of what
                # the condensed unknowns do against their load
                model = float((g * p).sum() + u @ (schur.S @ u + load)) / 2 + felt
                change, rounding = there.energy - at.energy + felt, ROUNDING * abs(at.energy)
                gain = 1.0 if abs(change) <= rounding else change / min(model, -rounding)
            if gain >= BAD or not insist or schur.damping > DAMPING_MAX * schur.least_damping:
                return inner, there, gain, schur.damping
            schur = Schur(condensed.schur.undamped, max(4 * schur.damping, schur.least_damping))

    def _on_condensed(self, contact: CoupledContact) -> CoupledContact:
        """The contact on the facets that are condensed to, in their nodes' own numbers."""
        condensed, whole = self.problem.tangent.condensation, contact.contact
        which = np.flatnonzero((condensed.local[whole.faces.conn] >= 0).all(1))
        faces = whole.faces.only(which)
        faces = replace(faces, conn=condensed.local[faces.conn])
        return replace(contact, contact=replace(whole, faces=faces), anchor=contact.anchor[which])

    def _touching(self, contact: Contact, x: Array) -> Array:
        """Which facets (f,) the indenter acts on; if none, where it acted last, or where it is nearest."""
        gap = contact.gaps(x)[0]
        now = (gap < contact.dhat).any(1)
        if now.any():
            return np.asarray(now)
        last = (self.history.normal_force > 0).any(1)
        return np.asarray(last if last.any() else gap.min(1) <= gap.min())

    def _covered(self, facets: Array) -> bool:
        local = self.problem.tangent.condensation.local
        return bool((local[facets] >= 0).all())

    def _scale(self, force: float) -> float:
        return max(force, self.history.least_force)

    def _residual(self, at: BulkPoint, inner: ContactSolution) -> float:
        """2-norm of the free nodes' forces, as a part of the contact force."""
        condensed = self.problem.tangent.condensation
        r = at.gradient.copy()
        r[condensed.nodes] -= inner.contact.contact.faces.scatter(inner.forces.force, len(condensed.nodes))
        force = float(inner.forces.N.sum())
        return float(np.linalg.norm(r.ravel()[self.problem.pattern.free])) / self._scale(force)

    def _why(self, x: Array, steps: int) -> str:
        """What is known of why no equilibrium was found."""
        least = min(float(J.min()) for J in self.bulk.at(x).J)
        squeezed = f", the gel squeezed to {least:.1%} of its volume" if least < SQUEEZED else ""
        return f"Newton did not converge in {steps} steps{squeezed}; try less depth, less friction or a finer mesh"


TRACE = False


def _with_neighbours(conn: Array, which: Array) -> Array:
    """Facets (f, a) that are marked, and those that share a node with them."""
    return np.asarray(conn[np.isin(conn, conn[which]).any(1)])


def _solve_meshes(step: MeshLoadStep, x: Array) -> Found:
    x, contact, steps = step.solve(x)
    return Found(x, contact, contact.forces(x), contact.contact.least(x), steps)


def _imbalance(problem: Problem, history: History, inert: Total, found: Found) -> tuple[float, float]:
    """Residual on the free dofs and |indenter + inertia + base|, as parts of the contact force."""
    x, free = found.x, problem.pattern.free
    outer = found.contact.contact.faces.scatter(-found.forces.force, len(x))
    inertia = inert.gradient(x)
    inner = Total((*problem.elastic, *problem.folding)).gradient(x)
    held = np.ones(x.size, bool)
    held[free] = False
    reaction = np.where(held.reshape(x.shape), inner, 0.0).sum(0)
    residual = float(np.linalg.norm((inner + outer + inertia).ravel()[free]))
    force = max(float(np.linalg.norm(outer.sum(0))), history.least_force)
    return residual / force, float(np.linalg.norm((outer + inertia).sum(0) - reaction)) / force


def equilibrium(
    problem: Problem, history: History, matrix: Array, index: int, duration: float = 0.0, near: State | None = None
) -> tuple[History, State]:
    """The gel under the indenter at pose `matrix` (4, 4), a load step on from `history`.

    `duration` [s] is what the step takes, where inertia matters. `near` is another answer to the same history, at a
    pose close by: Newton starts there, and inherits nothing of it.

    Raises:
        NotConverged: no equilibrium within the tolerances was found. TooFar: the step must be shorter.
    """
    coupled = isinstance(problem.contact, Contact)
    step = (LoadStep if coupled else MeshLoadStep)(problem, history, Pose.of(matrix), duration)
    try:
        found, steps = _until_clear(step, step.start(None if near is None else near.x))
        residual, balance = _imbalance(problem, history, step.inert, found)
        if residual > problem.options.residual_max or balance > problem.options.residual_max or found.least_gap <= 0:
            raise NotConverged(
                f"residual {residual:.1e} and balance {balance:.1e} of the contact force, smallest gap"
                f" {found.least_gap:.1e} mm"
            )
        least_J = least_jacobian(problem.mesh.points, found.x, problem.mesh.cells)
        if least_J <= 0:
            raise NotConverged(
                f"an element is turned inside out, to {least_J:.2g} of its volume; try less depth, less friction or a"
                " finer mesh"
            )
        if coupled:
            _check_inside(problem, found)
    except NotConverged:
        if problem.condensed:
            problem.tangent.condensation.usable = False
        raise
    return _record(step, found, index, matrix, steps, (residual, balance, least_J))


def _until_clear(step: LoadStep | MeshLoadStep, x: Array) -> tuple[Found, int]:
    """The equilibrium with a barrier stiff enough that no point is inside the shrunk indenter, and all Newton steps."""
    steps = 0
    for _ in range(STIFFENINGS):
        found = step.solve(x) if isinstance(step, LoadStep) else _solve_meshes(step, x)
        x, steps = found.x, steps + found.steps
        if found.least_gap > 0:
            break
        if isinstance(step, LoadStep):
            assert isinstance(found.contact, CoupledContact)
            step.contact = found.contact.stiffened(STIFFER)
        else:
            step.contact = replace(step.contact, kappa=STIFFER * step.contact.kappa)
    return found, steps


def _check_inside(problem: Problem, found: Found) -> None:
    contact = found.contact.contact
    reach = contact.shape.reach
    if (deep := depth_inside(contact, problem.elastic, found.x)) > INSIDE * reach:
        raise NotConverged(
            f"the indenter, {2 * reach:.3g} mm thin, penetrates the gel by {deep:.3g} mm between contact points of a mesh"
            f" of edge {problem.edge:g} mm: a finer one or less depth is needed"
        )


def _record(
    step: LoadStep | MeshLoadStep, found: Found, index: int, matrix: Array, steps: int, quality: tuple[float, float, float]
) -> tuple[History, State]:
    coupled, contact, forces, history = found.contact, found.contact.contact, found.forces, step.history
    rub = sliding = None
    anchor = history.anchor
    if coupled.friction > 0:
        rub = forces.force - forces.N[..., None] * forces.normal
        sliding = (np.linalg.norm(coupled.slip(forces), axis=-1) >= coupled.eps) & (forces.N > 0)
        anchor = fr.dragged(coupled.anchor, forces.at, forces.normal, forces.N, coupled.eps, contact.pose)
    after = History(
        contact.pose,
        found.x,
        contact.offset,
        forces.N,
        forces.normal @ contact.pose.rotation,
        anchor,
        forces.gap,
        contact.kappa,
        max(history.least_force, NEGLIGIBLE * float(forces.N.sum())),
        None if history.velocity is None else (found.x - history.x) / step.duration,
        history.x,
        None if step.prediction is None else step.prediction.missed(found.x),
    )
    mean = contact.mean_gap(found.x)
    residual, balance, least_J = quality
    return after, State(
        index, matrix, found.x, forces.N, forces.normal, rub, sliding, steps, 1, contact.offset, mean,
        found.least_gap, residual, balance, least_J,
    )  # fmt: skip
