"""One load step: the equilibrium of the gel for one pose of the indenter, with checks of the result."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tacgen.fem.jacobian import least_jacobian
from tacgen.geometry.pose import Pose
from tacgen.mechanics.coupled import dragged, slip
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.load_step import Found, LoadStep, imbalance
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.state import History, State

if TYPE_CHECKING:
    from tacgen.mechanics.mesh_contact import MeshLoadStep

Array = np.ndarray
NEGLIGIBLE = 1e-3  # smallest force scale, over the largest contact force so far [-]
STIFFENINGS = 8  # most solves, with stiffer barriers each time, until nothing penetrates or inverts


def equilibrium(
    problem: Problem, history: History, matrix: Array, index: int, duration: float = math.inf, near: State | None = None
) -> tuple[History, State]:
    """The gel under the indenter at pose `matrix` (4, 4), a load step on from `history`.

    `duration` [s] of the step, with inertia or viscosity. `near`: a solution for the same history at a nearby pose,
    which is used only as the start of Newton's method.

    Raises:
        NotConverged: no equilibrium within the tolerances was found, or (too_far) the step must be shorter.
    """
    step = _load_step(problem, history, Pose.of(matrix), duration)
    try:
        solution, least_J = _until_admissible(step, step.start(None if near is None else near.x))
        residual, balance = imbalance(step, solution)
        if residual > problem.options.residual_max or balance > problem.options.residual_max or solution.least_gap <= 0:
            raise NotConverged(Failure.unbalanced, residual=residual, balance=balance, least_gap=solution.least_gap)
        if least_J <= 0:
            raise NotConverged(Failure.inverted, least_J=least_J)
        step.check(solution)
    except NotConverged:
        if problem.condensed:
            problem.tangent.condensation.usable = False
        raise
    return _record(step, solution, index, matrix, (residual, balance, least_J))


def _load_step(problem: Problem, history: History, pose: Pose, duration: float) -> "LoadStep | MeshLoadStep":
    if problem.contact.overlaps:
        return LoadStep(problem, history, pose, duration)
    from tacgen.mechanics.mesh_contact import MeshLoadStep

    return MeshLoadStep(problem, history, pose, duration)


def _until_admissible(step: "LoadStep | MeshLoadStep", x: Array) -> tuple[Found, float]:
    """The equilibrium, with barriers stiff enough that no point is inside the shrunk indenter and no element is
    inverted, and the Newton steps of all solves; and the certified lower bound of J."""
    steps, damped, mesh = 0, 0, step.problem.mesh
    for _ in range(STIFFENINGS):
        solution = step.solve(x)
        x, steps, damped = solution.x, steps + solution.steps, damped + solution.damped
        least_J = least_jacobian(mesh.points, x, mesh.cells)
        touching, inverted = not solution.least_gap > 0, not least_J > 0
        if not (touching or inverted) or not step.stiffen(solution, touching, inverted):
            break
    return replace(solution, steps=steps, damped=damped), least_J


def _record(
    step: "LoadStep | MeshLoadStep",
    solution: Found,
    index: int,
    matrix: Array,
    quality: tuple[float, float, float],
) -> tuple[History, State]:
    coupled, contact, forces, history = solution.contact, solution.contact.contact, solution.forces, step.history
    friction = sliding = None
    anchor = history.anchor
    if coupled.friction > 0:
        friction = forces.force - forces.N[..., None] * forces.normal
        # the anchor of a sliding point lags by eps; the slip of one that has stopped is still eps, within the tolerance
        least = coupled.eps + step.problem.options.step_tol * contact.dhat
        sliding = (np.linalg.norm(slip(forces.at, coupled.anchor, forces.normal), axis=-1) > least) & (forces.N > 0)
        anchor = dragged(coupled.anchor, forces.at, forces.normal, forces.N, coupled.eps, contact.pose)
    internal = step.problem.internal(history, solution.x, step.duration)
    after = History(
        contact.pose,
        solution.x,
        contact.offset,
        forces.N,
        forces.normal @ contact.pose.rotation,
        anchor,
        forces.gap,
        contact.kappa,
        max(history.least_force, NEGLIGIBLE * float(forces.N.sum())),
        None if history.velocity is None else (solution.x - history.x) / step.duration,
        history.x,
        internal,
        None if step.prediction is None else step.prediction.error(solution.x),
        None if step.prediction is None else step.prediction.x,
    )
    mean = contact.mean_gap(solution.x)
    residual, balance, least_J = quality
    return after, State(
        index, matrix, solution.x, forces.N, forces.normal, friction, sliding, solution.steps, 1, contact.offset, mean,
        solution.least_gap, residual, balance, least_J, solution.damped, internal=internal, after=after,
    )  # fmt: skip
