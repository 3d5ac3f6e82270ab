"""One load step: the equilibrium of the gel for one pose of the indenter, with checks of the result."""

import math
from dataclasses import dataclass, replace

import numpy as np

from tacgen.fem.jacobian import least_jacobian
from tacgen.fem.potential import Potential, Total
from tacgen.geometry.pose import Pose
from tacgen.mechanics import friction as fr
from tacgen.mechanics import full_newton
from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.bulk import Bulk
from tacgen.mechanics.bulk_newton import BulkNewton, failed, with_neighbours
from tacgen.mechanics.coupled import ContactForces, CoupledContact
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.linear_solvers import NotPositiveDefinite
from tacgen.mechanics.mesh_contact import LaggedContact, MeshLoadStep
from tacgen.mechanics.predictor import Prediction, predict
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History, State
from tacgen.mechanics.tunnelling import blocked, depth_inside

Array = np.ndarray
NEGLIGIBLE = 1e-3  # smallest force scale, over the largest contact force so far [-]
INSIDE = 0.45  # largest depth of the gel inside the indenter, over its reach [-]; at 1 it may come out on the far side
STIFFENINGS = 8  # most solves, with barriers STIFFER times as stiff each time, until nothing penetrates or inverts
STIFFER = 4.0  # [-]
TRIES = 4  # most solves with contact between meshes, each with smaller tolerances


@dataclass(frozen=True)
class Found:
    """Result of a solve: positions, the contact there (with its offset) and its forces, smallest gap [mm], Newton
    steps and how many of them needed damping."""

    x: Array
    contact: CoupledContact | LaggedContact
    forces: ContactForces
    least_gap: float
    steps: int
    damped: int = 0

    @classmethod
    def coupled(cls, x: Array, contact: CoupledContact, steps: int, damped: int = 0) -> "Found":
        forces = contact.evaluate(x)
        return cls(x, contact, forces, float(forces.gap.min()), steps, damped)


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
        self.elastic = problem.during(history, duration)
        self.bulk = Bulk(self.elastic, problem.folding, inert)
        if problem.condensed:
            self.prediction = self._predict(contact, pose)
        self.contact = CoupledContact(contact, problem.friction, self._anchors(contact), self.options.slip * self.dhat)

    def _predict(self, contact: Contact, pose: Pose) -> Prediction | None:
        """Prediction by the tangent at the last equilibrium, which also serves the first step.

        At a first guess the tangent is often indefinite, because of the guess's pressures.
        """
        history, tangent, conn = self.history, self.problem.tangent, contact.faces.conn
        near = contact.gaps(history.x)[0] < contact.dhat
        touching = np.asarray((near | (history.normal_force > 0)).any(1))
        if not touching.any():
            return None
        covered = tangent.usable and tangent.condensation.covers(conn[touching])
        if not covered:
            tangent.condensation.cover(with_neighbours(conn, touching))
        if not covered or (tangent.followed and tangent.exact_at is not history.x):
            try:
                tangent.take(self.bulk.at(history.x), None)
            except NotPositiveDefinite:
                return None
        return predict(contact, tangent, history, pose) if self.options.predict else None

    def _anchors(self, contact: Contact) -> Array:
        """Anchors in the sensor frame; that of a new point is at its predicted place of first touch."""
        history = self.history
        x = history.x if self.prediction is None else self.prediction.x
        ahead, gap_ahead = contact.pose.local(contact.faces.at(x)), contact.gaps(x)[0]
        touch = fr.onset(history.anchor, ahead, history.gap - contact.offset, gap_ahead - contact.offset)
        return contact.pose.world(np.where(history.normal_force[..., None] > 0, history.anchor, touch))

    def start(self, near: Array | None) -> Array:
        """Start of Newton's method: the first of a nearby solution, the prediction, the positions by inertia, and the
        last positions in which nothing tunnels and no element is inverted. Raises NotConverged: too far."""
        history, contact = self.history, self.contact.contact
        for x in (near, None if self.prediction is None else self.prediction.x, self.ahead, history.x):
            if x is None or blocked(contact, history.pose, history.x, history.gap, x):
                continue
            if np.isfinite(self.bulk.at(x).energy):
                return x
        raise NotConverged(Failure.too_far)

    def solve(self, x: Array) -> Found:
        """Raises NotConverged."""
        if self.problem.condensed:
            newton = BulkNewton(self.problem, self.bulk, self.history)
            return Found.coupled(*newton.solve(x, self.contact), newton.damped)
        found = full_newton.solve(self.problem, self.bulk, self.contact, x)
        if not found.converged:
            raise failed(self.bulk, found.x, found.steps)
        return Found.coupled(found.x, found.contact, found.steps)


def _solve_meshes(step: MeshLoadStep, x: Array) -> Found:
    """Solves with decreasing tolerances until forces balance: steps that are cut by collisions look converged."""
    steps, most = 0, step.problem.options.residual_max
    for _ in range(TRIES):
        x, contact, more = step.solve(x)
        found = Found(x, contact, contact.forces(x), contact.contact.least(x), steps := steps + more)
        if max(_imbalance(step, found)) <= most:
            break
        step.xtol /= 30
    return found


def _imbalance(step: LoadStep | MeshLoadStep, found: Found) -> tuple[float, float]:
    """Residual on the free dofs and |indenter + inertia + base|, both over the contact force [-]."""
    problem, x, free = step.problem, found.x, step.problem.pattern.free
    outer = found.contact.contact.faces.scatter(-found.forces.force, len(x))
    inertia = step.inert.gradient(x)
    folding = step.bulk.folding if isinstance(step, LoadStep) else problem.folding
    inner = Total((*step.elastic, *folding)).gradient(x)
    held = np.ones(x.size, bool)
    held[free] = False
    reaction = np.where(held.reshape(x.shape), inner, 0.0).sum(0)
    residual = float(np.linalg.norm((inner + outer + inertia).ravel()[free]))
    force = max(float(np.linalg.norm(outer.sum(0))), step.history.least_force)
    return residual / force, float(np.linalg.norm((outer + inertia).sum(0) - reaction)) / force


def equilibrium(
    problem: Problem, history: History, matrix: Array, index: int, duration: float = math.inf, near: State | None = None
) -> tuple[History, State]:
    """The gel under the indenter at pose `matrix` (4, 4), a load step on from `history`.

    `duration` [s] of the step, with inertia or viscosity. `near`: a solution for the same history at a nearby pose,
    which is used only as the start of Newton's method.

    Raises:
        NotConverged: no equilibrium within the tolerances was found, or (too_far) the step must be shorter.
    """
    coupled = isinstance(problem.contact, Contact)
    step = (LoadStep if coupled else MeshLoadStep)(problem, history, Pose.of(matrix), duration)
    try:
        found, least_J = _until_admissible(step, step.start(None if near is None else near.x))
        residual, balance = _imbalance(step, found)
        if residual > problem.options.residual_max or balance > problem.options.residual_max or found.least_gap <= 0:
            raise NotConverged(Failure.unbalanced, residual=residual, balance=balance, least_gap=found.least_gap)
        if least_J <= 0:
            raise NotConverged(Failure.inverted, least_J=least_J)
        if coupled:
            _check_inside(problem, found)
    except NotConverged:
        if problem.condensed:
            problem.tangent.condensation.usable = False
        raise
    return _record(step, found, index, matrix, (residual, balance, least_J))


def _until_admissible(step: LoadStep | MeshLoadStep, x: Array) -> tuple[Found, float]:
    """The equilibrium, with barriers stiff enough that no point is inside the shrunk indenter and no element is
    inverted, and the Newton steps of all solves; and the certified lower bound of J."""
    steps, damped, mesh = 0, 0, step.problem.mesh
    for _ in range(STIFFENINGS):
        found = step.solve(x) if isinstance(step, LoadStep) else _solve_meshes(step, x)
        x, steps, damped = found.x, steps + found.steps, damped + found.damped
        least_J = least_jacobian(mesh.points, x, mesh.cells)
        if found.least_gap > 0 and least_J > 0:
            break
        if isinstance(step, LoadStep):
            assert isinstance(found.contact, CoupledContact)
            step.contact = found.contact if found.least_gap > 0 else found.contact.stiffened(STIFFER)
            folding = step.bulk.folding if least_J > 0 else tuple(b.stiffened(STIFFER) for b in step.bulk.folding)
            step.bulk = replace(step.bulk, folding=folding)
        elif least_J > 0:
            step.contact = replace(step.contact, kappa=STIFFER * step.contact.kappa)
        else:
            break
    return replace(found, steps=steps, damped=damped), least_J


def _check_inside(problem: Problem, found: Found) -> None:
    contact = found.contact.contact
    assert isinstance(contact, Contact)
    reach = contact.shape.reach
    if (deep := depth_inside(contact, problem.elastic, found.x)) > INSIDE * reach:
        raise NotConverged(Failure.inside, width=2 * reach, depth=deep, edge=problem.edge)


def _record(
    step: LoadStep | MeshLoadStep,
    found: Found,
    index: int,
    matrix: Array,
    quality: tuple[float, float, float],
) -> tuple[History, State]:
    coupled, contact, forces, history = found.contact, found.contact.contact, found.forces, step.history
    friction = sliding = None
    anchor = history.anchor
    if coupled.friction > 0:
        friction = forces.force - forces.N[..., None] * forces.normal
        # the anchor of a sliding point lags by eps; the slip of one that has stopped is still eps, within the tolerance
        least = coupled.eps + step.problem.options.step_tol * contact.dhat
        sliding = (np.linalg.norm(fr.slip(forces.at, coupled.anchor, forces.normal), axis=-1) > least) & (forces.N > 0)
        anchor = fr.dragged(coupled.anchor, forces.at, forces.normal, forces.N, coupled.eps, contact.pose)
    internal = step.problem.internal(history, found.x, step.duration)
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
        internal,
        None if step.prediction is None else step.prediction.error(found.x),
        None if step.prediction is None else step.prediction.x,
        None if step.prediction is None else step.prediction.tied,
    )
    mean = contact.mean_gap(found.x)
    residual, balance, least_J = quality
    return after, State(
        index, matrix, found.x, forces.N, forces.normal, friction, sliding, found.steps, 1, contact.offset, mean,
        found.least_gap, residual, balance, least_J, found.damped, internal=internal, after=after,
    )  # fmt: skip
