"""One load step: contact and bulk at its pose, the prediction and the start of Newton's method.

Each function that takes a SolveState is one kernel of the method (see phases).
"""

from dataclasses import dataclass, replace

import numpy as np

from tacgen.fem.potential import Potential
from tacgen.geometry.pose import Pose
from tacgen.mechanics import full_newton
from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.bulk import Bulk
from tacgen.mechanics.bulk_newton import begun, with_neighbours
from tacgen.mechanics.coupled import CoupledContact, onset
from tacgen.mechanics.failures import Failure, NotConverged, no_equilibrium
from tacgen.mechanics.linear_solvers import NotPositiveDefinite
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.predictor import Prediction, predict
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.solve_state import Found, SolveState, known
from tacgen.mechanics.state import History
from tacgen.mechanics.tunnelling import blocked, blocked_along, depth_inside

Array = np.ndarray
Result = tuple[Outcome, SolveState]
INSIDE = 0.45  # largest depth of the gel inside the indenter, over its reach [-]; at 1 it may come out on the far side
STIFFER = 4.0  # factor of a barrier that does not suffice [-]


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

    def predicted(self, pose: Pose) -> "LoadStep":
        """With the prediction by the problem's tangent."""
        return replace(self, prediction=predict(self.contact, self.problem.tangent, self.history, pose))

    def anchored(self) -> "LoadStep":
        """With anchors in the sensor frame; that of a new point is where it first touches on the predicted path."""
        history, contact, problem = self.history, self.contact, self.problem
        x = history.x if self.prediction is None else self.prediction.x
        at = contact.faces.at(x)
        ahead, gap_ahead = contact.pose.local(at), contact.gap(at)
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

    def solve(self, x: Array) -> Found | NotConverged:
        """By Newton's method on all unknowns from x (n, 3)."""
        solution = full_newton.solve(self.problem, self.bulk, known(self.coupled), x)
        if not solution.converged:
            return no_equilibrium(self.bulk.at(solution.x).J, solution.steps)
        return Found.coupled(solution.x, solution.contact, solution.steps)

    def stiffened(self, solution: Found, contact: bool, folding: bool) -> "LoadStep":
        """With stiffer barriers of the contact or against folding after a solution."""
        bulk = self.bulk
        if folding:
            bulk = replace(bulk, folding=tuple(b.stiffened(STIFFER) for b in bulk.folding))
        return replace(self, coupled=solution.contact.stiffened(STIFFER) if contact else solution.contact, bulk=bulk)

    def wrong(self, solution: Found) -> NotConverged | None:
        """The failure where the gel is far inside the indenter or has passed through it: from the middle of a thin wall
        points may be pushed out on the far side."""
        contact, problem, history = solution.contact.contact, self.problem, self.history
        reach, path = contact.shape.reach, (*solution.path, solution.x)
        if blocked_along(contact, history.pose, history.x, history.gap, path):
            return NotConverged(Failure.snaps if solution.damped else Failure.too_far)
        if (deep := depth_inside(contact, problem.elastic, solution.x)) > INSIDE * reach:
            return NotConverged(Failure.inside, width=2 * reach, depth=deep, edge=problem.edge)
        return None


def begin(problem: Problem, now: SolveState) -> Result:
    """Contact and bulk at the pose of the next load step, and whether the kept tangent serves its prediction."""
    leg = now.legs[0]
    pose, effort = Pose.of(leg.b), 0 if leg.budget else now.effort
    now = replace(now, effort=effort, failure=None)
    step = LoadStep.of(problem, now.history, pose, leg.duration)
    now = replace(now, step=step)
    if not problem.condensed:
        return Outcome.not_condensed, now
    history, tangent, contact = now.history, problem.tangent, step.contact
    conn, near = contact.faces.conn, contact.gap(contact.faces.at(history.x)) < contact.dhat
    touching = np.asarray((near | (history.normal_force > 0)).any(1))
    if not touching.any():
        return Outcome.apart, now
    covered = tangent.usable and tangent.condensation.covers(conn[touching])
    if not covered:
        tangent.condensation.cover(with_neighbours(conn, touching))
    exact = not tangent.followed or tangent.exact_at is history.x
    return Outcome.ready if covered and exact else Outcome.missing, now


def renew(problem: Problem, now: SolveState) -> Result:
    """The tangent at the last equilibrium, which also serves the first step: at a first guess the tangent is often
    indefinite, because of the guess's pressures."""
    assert now.step is not None
    try:
        problem.tangent.take(now.step.bulk.at(now.history.x), None)
    except NotPositiveDefinite:
        return Outcome.indefinite, now
    return Outcome.ready, now


def foresee(problem: Problem, now: SolveState) -> Result:
    """The prediction, if the options ask for it."""
    assert now.step is not None
    if not problem.options.predict:
        return Outcome.ready, now
    return Outcome.ready, replace(now, step=now.step.predicted(Pose.of(now.legs[0].b)))


def start(problem: Problem, now: SolveState) -> Result:
    """Newton's method at its start: what a softer barrier found, or see LoadStep.start."""
    step = now.step
    assert step is not None
    x = now.found.x if now.found else step.start(None if now.near is None else now.near.x)
    if x is None:
        return Outcome.failure, now.failed(Failure.too_far)
    if step.coupled is None:
        step = step.anchored()
    now = replace(now, step=step, begins=x)
    if not problem.condensed:
        return Outcome.not_condensed, now
    return Outcome.ready, replace(now, newton=begun(problem, step.bulk, now.history, known(step.coupled), x))


def whole(problem: Problem, now: SolveState) -> Result:
    """Newton's method on all unknowns."""
    assert now.step is not None
    found = now.step.solve(known(now.begins))
    if isinstance(found, NotConverged):
        return Outcome.failure, replace(now, failure=found)
    return Outcome.ended, replace(now, found=found)
