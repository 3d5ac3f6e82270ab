"""One load step: contact and bulk at its pose, the prediction, the start of Newton's method, and what it found."""

from dataclasses import dataclass, replace

import numpy as np

from tacgen.fem.potential import Potential
from tacgen.geometry.pose import Pose
from tacgen.mechanics import full_newton
from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.bulk import Bulk
from tacgen.mechanics.coupled import ContactForces, CoupledContact
from tacgen.mechanics.failures import NotConverged, no_equilibrium
from tacgen.mechanics.measures import onset
from tacgen.mechanics.predictor import Prediction, predict
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History
from tacgen.mechanics.tunnelling import blocked, blocked_along, depth_inside

Array = np.ndarray
BARRIER_STIFFENING_FACTOR = 4.0  # factor of a barrier that does not suffice [-]


@dataclass(frozen=True)
class Equilibrium:
    """Result of a solve: positions, the contact there (with its offset) and its forces, smallest gap [mm], Newton
    steps, and the positions (n, 3) after each of them from the first that needed damping on."""

    x: Array
    contact: CoupledContact
    forces: ContactForces
    least_gap: float
    steps: int
    path: tuple[Array, ...] = ()

    @classmethod
    def coupled(cls, x: Array, contact: CoupledContact, steps: int, path: tuple[Array, ...] = ()) -> "Equilibrium":
        forces = contact.evaluate(x)
        return cls(x, contact, forces, float(forces.gap.min()), steps, path)


@dataclass(frozen=True)
class LoadStep:
    """The contact and the bulk at one pose; `ahead` (n, 3): positions by inertia, None without; the prediction, None
    before it is made and where there is none; the contact with its anchors, None before they are set."""

    problem: Problem
    history: History
    duration: float  # [s]
    contact: Contact
    bulk: Bulk
    ahead: Array | None
    prediction: Prediction | None = None
    coupled: CoupledContact | None = None

    @classmethod
    def of(cls, problem: Problem, history: History, pose: Pose, duration: float) -> "LoadStep":
        """Before its prediction."""
        inert, ahead = list[Potential](), None
        if problem.body is not None:
            assert history.velocity is not None
            inertia = problem.body.step(history.x, history.velocity, duration)
            inert, ahead = [inertia], inertia.coasting
        contact = replace(problem.contact.moved(pose, history.offset), kappa=history.kappa)
        bulk = Bulk(problem.during(history, duration), problem.folding, tuple(inert))
        return cls(problem, history, duration, contact, bulk, ahead)

    def predicted(self) -> "LoadStep":
        """With the prediction by the problem's tangent."""
        return replace(self, prediction=predict(self.contact, self.problem.tangent, self.history))

    def anchored(self) -> "LoadStep":
        """With anchors in the sensor frame; that of a new point is where it first touches on the predicted path."""
        history, contact, problem = self.history, self.contact, self.problem
        x = history.x if self.prediction is None else self.prediction.x
        ahead, gap_ahead = contact.pose.local(contact.faces.at(x)), contact.gap(x)
        touch = onset(history.anchor, ahead, history.gap - contact.offset, gap_ahead - contact.offset)
        anchor = contact.pose.world(np.where(history.normal_force[..., None] > 0, history.anchor, touch))
        coupled = CoupledContact(contact, problem.friction, anchor, problem.options.slip * contact.dhat)
        return replace(self, coupled=coupled)

    def start(self, near: Array | None) -> Array | None:
        """Start of Newton's method: the first of a nearby solution, the prediction, the positions by inertia, and the
        last positions in which nothing tunnels and no element is inverted; None if there is none."""
        history, contact = self.history, self.contact
        for x in (near, None if self.prediction is None else self.prediction.x, self.ahead, history.x):
            if x is None or blocked(contact, history.pose, history.x, history.gap, x):
                continue
            if np.isfinite(self.bulk.at(x).energy):
                return x
        return None

    def solve(self, x: Array) -> Equilibrium | NotConverged:
        """By Newton's method on all unknowns from x (n, 3)."""
        assert self.coupled is not None
        solution = full_newton.solve(self.problem, self.bulk, self.coupled, x)
        if not solution.converged:
            return no_equilibrium(self.bulk.least_J(solution.x), solution.steps)
        return Equilibrium.coupled(solution.x, solution.contact, solution.steps)

    def stiffened(self, solution: Equilibrium, contact: bool, folding: bool) -> "LoadStep":
        """With stiffer barriers of the contact or against folding after a solution."""
        bulk = self.bulk
        if folding:
            bulk = replace(bulk, folding=tuple(b.stiffened(BARRIER_STIFFENING_FACTOR) for b in bulk.folding))
        return replace(
            self,
            coupled=solution.contact.stiffened(BARRIER_STIFFENING_FACTOR) if contact else solution.contact,
            bulk=bulk,
        )

    def penetration(self, solution: Equilibrium) -> tuple[float, bool]:
        """Depth of the gel inside the indenter after a solution [mm], and whether a point has passed through it."""
        contact, history, path = solution.contact.contact, self.history, (*solution.path, solution.x)
        through = blocked_along(contact, history.pose, history.x, history.gap, path)
        return depth_inside(contact, self.problem.elastic, solution.x), through
