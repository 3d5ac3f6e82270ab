"""The checks that a load step must pass before it is recorded: nothing penetrates or inverts, and forces balance."""

from dataclasses import replace

import numpy as np

from tacgen.fem.jacobian import least_jacobian
from tacgen.fem.potential import Total
from tacgen.mechanics.coupled import dragged, slip
from tacgen.mechanics.failures import Failure
from tacgen.mechanics.load_step import Found, LoadStep
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.solve_state import SolveState, known
from tacgen.mechanics.state import History, State, joined

Array = np.ndarray
MAX_BARRIER_STIFFENINGS = 8  # most solves, with stiffer barriers each time, until nothing penetrates or inverts
MIN_FORCE_SCALE_RATIO = 1e-3  # smallest force scale, over the largest contact force so far [-]
SHARP_RADIUS_EDGES = 1.5  # indenter's smallest radius over the element edge, below which its edges count as sharp [-]
MIN_CROSSING_ANGLE = 0.3  # change of the indenter's normal at a point that counts as crossing an edge in one step [rad]


def admit(problem: Problem, now: SolveState) -> tuple[Outcome, SolveState]:
    """Whether no point is inside the shrunk indenter and no element is inverted, or barriers must be stiffer; whether
    forces balance. If so the load step is recorded."""
    step, solution = now.step, known(now.found)
    most = problem.options.fold_max if solution.damped else problem.options.residual_max
    assert step is not None
    least_J = least_jacobian(problem.mesh.points, solution.x, problem.mesh.cells)
    now = replace(now, solves=now.solves + 1, steps=now.steps + solution.steps, damped=now.damped + solution.damped)
    touching, inverted = not solution.least_gap > 0, not least_J > 0
    if (touching or inverted) and now.solves < MAX_BARRIER_STIFFENINGS:
        return Outcome.stiffer, replace(now, step=step.stiffened(solution, touching, inverted))
    residual, balance = imbalance(step, solution)
    if residual > most or balance > most or solution.least_gap <= 0:
        figures = {"residual": residual, "balance": balance, "least_gap": solution.least_gap}
        return Outcome.failure, now.failed(Failure.unbalanced, **figures)
    if least_J <= 0:
        return Outcome.failure, now.failed(Failure.inverted, least_J=least_J)
    if (wrong := step.wrong(solution)) is not None:
        return Outcome.failure, replace(now, failure=wrong)
    after, state = _record(step, solution, now, (residual, balance, least_J))
    total = state if now.state is None else joined(now.state, state)
    now = replace(now.between(), history=after, state=total, legs=now.legs[1:], near=None)
    return Outcome.more if now.legs else Outcome.ended, now


def imbalance(step: LoadStep, solution: Found) -> tuple[float, float]:
    """Residual on the free dofs and |indenter + inertia + base|, both over the contact force [-]."""
    x, free = solution.x, step.problem.pattern.free
    outer = solution.contact.contact.faces.scatter(-solution.forces.force, len(x))
    inertia = Total(step.bulk.other).gradient(x)
    inner = Total((*step.bulk.elastic, *step.bulk.folding)).gradient(x)
    held = np.ones(x.size, bool)
    held[free] = False
    reaction = np.where(held.reshape(x.shape), inner, 0.0).sum(0)
    residual = float(np.linalg.norm((inner + outer + inertia).ravel()[free]))
    force = max(float(np.linalg.norm(outer.sum(0))), step.history.least_force)
    return residual / force, float(np.linalg.norm((outer + inertia).sum(0) - reaction)) / force


def _record(
    step: LoadStep, solution: Found, now: SolveState, quality: tuple[float, float, float]
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
        max(history.least_force, MIN_FORCE_SCALE_RATIO * float(forces.N.sum())),
        None if history.velocity is None else (solution.x - history.x) / step.duration,
        internal,
        folds_on(history, now.damped),
        None if step.prediction is None else step.prediction.error(solution.x),
        None if step.prediction is None else step.prediction.x,
    )
    mean = forces.mean_gap if forces.N.any() else contact.offset
    residual, balance, least_J = quality
    return after, State(
        now.index, now.legs[0].b, solution.x, forces.N, forces.normal, friction, sliding, now.steps, 1, contact.offset,
        mean, solution.least_gap, residual, balance, least_J, now.damped, rounded=rounded(step.problem, history, after),
        unique=not after.folded, internal=internal, after=after,
    )  # fmt: skip


def folds_on(before: History, damped: int) -> bool:
    """Whether a gel has folded since it was last untouched, after a load step with so many damped steps."""
    return damped > 0 or (before.folded and bool(before.normal_force.any()))


def sharp(problem: Problem) -> bool:
    """Whether the indenter's edges are sharper than the mesh."""
    return problem.contact.shape.smallest_radius < SHARP_RADIUS_EDGES * problem.edge


def rounded(problem: Problem, before: History, after: History) -> float:
    """Friction at points that crossed a sharp edge in one step, over the larger contact force of both ends [-]; above
    .05 the result depends on the step size.

    Whether such a point is dragged or slips depends on its path round the edge.
    """
    if not problem.friction or not sharp(problem):
        return 0.0
    turned = np.linalg.norm(after.normal - before.normal, axis=-1) > MIN_CROSSING_ANGLE
    force = np.maximum(after.normal_force, before.normal_force)[turned].sum()
    whole = max(float(after.normal_force.sum()), float(before.normal_force.sum()), after.least_force)
    return problem.friction * float(force) / whole
