"""The phases of a load step before the steps of the bulk, and Newton's method on all unknowns instead of them.

Each function is one kernel of the method (see phases).
"""

from dataclasses import replace

import numpy as np

from tacgen.geometry.pose import Pose
from tacgen.mechanics.bulk_newton import begun, with_neighbours
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.linear_solvers import NotPositiveDefinite
from tacgen.mechanics.load_step import LoadStep
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.solve_state import SolveState, known

Result = tuple[Outcome, SolveState]


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
    conn, near = contact.faces.conn, contact.gap(history.x) < contact.dhat
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
