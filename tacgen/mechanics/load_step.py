"""The contact, the bulk and the prediction of one load step, and how its equilibrium is found."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tacgen.fem.folding_barrier import FoldingBarrier
from tacgen.fem.potential import Potential, Total
from tacgen.geometry.pose import Pose
from tacgen.mechanics import full_newton
from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.bulk import Bulk
from tacgen.mechanics.bulk_newton import BulkNewton, failed, with_neighbours
from tacgen.mechanics.coupled import ContactForces, CoupledContact, onset
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.linear_solvers import NotPositiveDefinite
from tacgen.mechanics.predictor import Prediction, predict
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History
from tacgen.mechanics.tunnelling import blocked, depth_inside

if TYPE_CHECKING:
    from tacgen.mechanics.mesh_contact import LaggedContact, MeshLoadStep

Array = np.ndarray
INSIDE = 0.45  # largest depth of the gel inside the indenter, over its reach [-]; at 1 it may come out on the far side
STIFFER = 4.0  # factor of a barrier that does not suffice [-]


@dataclass(frozen=True)
class Found:
    """Result of a solve: positions, the contact there (with its offset) and its forces, smallest gap [mm], Newton
    steps and how many of them needed damping."""

    x: Array
    contact: "CoupledContact | LaggedContact"
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
        self.problem, self.history, self.duration = problem, history, duration
        self.options = problem.options
        contact = replace(problem.contact.distance.moved(pose, history.offset), kappa=history.kappa)
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

    @property
    def folding(self) -> tuple[FoldingBarrier, ...]:
        return self.bulk.folding

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
        touch = onset(history.anchor, ahead, history.gap - contact.offset, gap_ahead - contact.offset)
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
        solution = full_newton.solve(self.problem, self.bulk, self.contact, x)
        if not solution.converged:
            raise failed(self.bulk, solution.x, solution.steps)
        return Found.coupled(solution.x, solution.contact, solution.steps)

    def stiffen(self, solution: Found, contact: bool, folding: bool) -> bool:
        """Make the barriers of the contact or against folding stiffer after a solution; whether that may help."""
        assert isinstance(solution.contact, CoupledContact)
        self.contact = solution.contact.stiffened(STIFFER) if contact else solution.contact
        if folding:
            self.bulk = replace(self.bulk, folding=tuple(b.stiffened(STIFFER) for b in self.bulk.folding))
        return True

    def check(self, solution: Found) -> None:
        """Raises NotConverged: the gel is far inside the indenter."""
        contact, problem = solution.contact.contact.distance, self.problem
        reach = contact.shape.reach
        if (deep := depth_inside(contact, problem.elastic, solution.x)) > INSIDE * reach:
            raise NotConverged(Failure.inside, width=2 * reach, depth=deep, edge=problem.edge)


def imbalance(step: "LoadStep | MeshLoadStep", solution: Found) -> tuple[float, float]:
    """Residual on the free dofs and |indenter + inertia + base|, both over the contact force [-]."""
    x, free = solution.x, step.problem.pattern.free
    outer = solution.contact.contact.faces.scatter(-solution.forces.force, len(x))
    inertia = step.inert.gradient(x)
    inner = Total((*step.elastic, *step.folding)).gradient(x)
    held = np.ones(x.size, bool)
    held[free] = False
    reaction = np.where(held.reshape(x.shape), inner, 0.0).sum(0)
    residual = float(np.linalg.norm((inner + outer + inertia).ravel()[free]))
    force = max(float(np.linalg.norm(outer.sum(0))), step.history.least_force)
    return residual / force, float(np.linalg.norm((outer + inertia).sum(0) - reaction)) / force
