"""Positions of least energy by Newton's method on the energy alone, independent of the product's solvers."""

from typing import Any

import numpy as np

from tacgen.fem.assembly import Pattern
from tacgen.fem.projection import Projection
from tacgen.mechanics.linear_solvers import Cholmod, NotPositiveDefinite, Solver

Array = np.ndarray
MOST = 80  # steps
SHORTEST = 1e-10  # fraction of a step [-]
ROUNDING = 1e-13  # relative increase of the energy that is attributed to rounding [-]


def minimise(potential: Any, x: Array, pattern: Pattern, xtol: float) -> Array:
    """Lower an energy from x (n, 3) over the pattern's free dofs until a step moves no node by more than xtol [mm]."""
    solver, energy = Cholmod(pattern), potential.value(x)
    for _ in range(MOST):
        p = _direction(potential, x, pattern, solver)
        if np.abs(p).max() <= xtol:
            return x + p
        fraction = 1.0
        while not (lower := potential.value(x + fraction * p)) <= energy + ROUNDING * abs(energy):
            fraction /= 2
            assert fraction > SHORTEST, "no part of a step lowers the energy"
        x, energy = x + fraction * p, lower
    raise AssertionError(f"no minimum after {MOST} steps")


def _direction(potential: Any, x: Array, pattern: Pattern, solver: Solver) -> Array:
    """Newton step (n, 3); by the projected tangent where the exact one is not positive definite."""
    g, p = potential.gradient(x).ravel()[pattern.free], np.zeros(x.size)
    for projection in (Projection.NONE, Projection.FULL):
        data = np.zeros(len(pattern.indices))
        potential.add_hessian(x, data, projection)
        try:
            solver.factor(data)
        except NotPositiveDefinite:
            continue
        p[pattern.free] = solver.solve(-g)
        return p.reshape(x.shape)
    raise AssertionError("the projected tangent is not positive definite")
