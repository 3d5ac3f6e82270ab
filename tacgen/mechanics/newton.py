"""Newton's method on a potential, for contact between meshes: tangents far from the solution are projected."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from tacgen.fem.assembly import Pattern
from tacgen.fem.potential import Potential, Projection
from tacgen.mechanics.line_search import armijo, backtrack
from tacgen.mechanics.linear_solvers import NotPositiveDefinite, Solver

Array = np.ndarray
Lower = tuple[Array, float]
NEGLIGIBLE = 1e-6  # length of a step over xtol, below which it is rounding [-]
ROUNDING = 1e-13  # relative increase of the energy that is attributed to rounding [-]
SHORTEST = 1e-10  # fraction of a step at which a line search has stalled [-]


class Status(StrEnum):
    converged = "converged"
    out_of_steps = "out of steps"
    stalled = "stalled"
    nonfinite = "not finite"


@dataclass(frozen=True)
class NewtonStep:
    """One iteration: energy before it [N mm], longest nodal move proposed [mm], fraction taken, projected."""

    energy: float
    length: float
    fraction: float
    projected: bool


@dataclass(frozen=True)
class Solution:
    """Positions x (n, 3), how it ended and what each iteration did."""

    x: Array
    status: Status
    steps: tuple[NewtonStep, ...]


def direction(
    potential: Potential, x: Array, g: Array, pattern: Pattern, solver: Solver, exact: bool
) -> tuple[Array, bool]:
    """Newton direction (n, 3) and whether the stiffness was projected: it is where the exact one is not definite."""
    for projection in (Projection.NONE if exact else Projection.STRAINED, Projection.FULL):
        data = np.zeros(len(pattern.indices))
        potential.add_hessian(x, data, projection)
        p = np.zeros(x.size)
        try:
            solver.factor(data)
            p[pattern.free] = solver.solve(-g.ravel()[pattern.free])
        except NotPositiveDefinite:
            if projection is Projection.FULL:
                raise
            continue
        if g.ravel() @ p < 0:
            break
    return p.reshape(x.shape), projection > Projection.NONE


def _downhill(potential: Potential, x: Array, p: Array, energy: float, slope: float) -> tuple[float, Lower | None]:
    """Fraction of the step p that lowers the energy, and positions and energy there; 0 and None if none does."""

    def trial(fraction: float) -> tuple[bool, Lower]:
        there = x + fraction * p
        new = potential.value(there)
        return armijo(new, energy, fraction * slope, ROUNDING), (there, new)

    fraction, lower = backtrack(trial, SHORTEST, potential.max_step(x, p))
    return fraction, lower if fraction else None


def minimise(
    potential: Potential,
    x: Array,
    pattern: Pattern,
    solver: Solver,
    *,
    xtol: float,
    refresh: Callable[[Array], Potential | None] = lambda x: None,
    negligible: Callable[[Array], bool] = lambda g: False,
    near: float = np.inf,
    max_steps: int = 80,
) -> Solution:
    """Lower `potential` over the pattern's free dofs until a full step moves no node by xtol [mm].

    Args:
        x: start (n, 3) [mm], of finite energy.
        refresh: called after each full step shorter than `near`: the potential with new lagged quantities, or None if
            they may stay as they are, without which the iteration does not end.
        negligible: whether a gradient (n, 3) is below the tolerance; after a full step of at most 10 xtol this ends the
            iteration too, since the next step would be shorter still.
        near: steps longer than this [mm] use the projected stiffness.
    """
    steps: list[NewtonStep] = []
    length = np.inf
    energy = potential.value(x)
    settled = False  # the last step was short and changed nothing that is lagged
    while len(steps) < max_steps:
        g = potential.gradient(x)
        if settled and negligible(g):
            return Solution(x, Status.converged, tuple(steps))
        try:
            p, projected = direction(potential, x, g, pattern, solver, exact=length <= near)
        except NotPositiveDefinite:
            return Solution(x, Status.nonfinite, tuple(steps))
        length = float(np.abs(p).max())
        if not np.isfinite(length):
            return Solution(x, Status.nonfinite, tuple(steps))
        if length <= NEGLIGIBLE * xtol:  # rounding: no line search could tell whether that lowers the energy
            if (fresh := refresh(x)) is None:
                return Solution(x, Status.converged, tuple(steps))
            steps.append(NewtonStep(energy, length, 0.0, projected))
            potential, energy = fresh, fresh.value(x)
            continue
        fraction, lower = _downhill(potential, x, p, energy, float((g * p).sum()))
        if lower is None:
            # at rounding level a step may fail to lower the energy though it is as short as asked for
            return Solution(x, Status.converged if length <= xtol else Status.stalled, tuple(steps))
        steps.append(NewtonStep(energy, length, fraction, projected))
        x, energy = lower
        settled = False
        if length <= near and fraction == 1.0:
            fresh = refresh(x)
            if fresh is None and length <= xtol:
                return Solution(x, Status.converged, tuple(steps))
            if fresh is not None:
                potential, energy = fresh, fresh.value(x)
            settled = fresh is None and length <= 10 * xtol
    return Solution(x, Status.out_of_steps, tuple(steps))
