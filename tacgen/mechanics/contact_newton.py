"""Newton's method for contact with friction on a linearised bulk: the inner loop.

The step uses the consistent, non-symmetric tangent. It is taken in full if it halves the residual, as it does near the
solution, where convergence is quadratic. Otherwise Armijo's rule decreases the merit function: the energy of bulk and
barrier, and of friction with its normal forces frozen at the start of the step. If the coupled step is no descent
direction, Newton's step for the merit function is used. Where that function is not convex, the equilibrium is unstable:
the search ends, and the bulk needs damping.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from tacgen.mechanics.condensation import Schur
from tacgen.mechanics.coupled import ContactForces, CoupledContact
from tacgen.mechanics.line_search import armijo, backtrack

Array = np.ndarray
ROUNDING = 1e-12  # relative increase of the merit function that is attributed to rounding [-]
FULL_STEP = 0.5  # residual over the one before, up to which a coupled step is taken in full [-]
SHORTEST = 1e-8  # fraction of a step at which a line search has stalled [-]
MIN_COUPLED = 0.1  # smallest fraction of a coupled step; below, the symmetric step is tried [-]


class EnergyPoint(Protocol):
    """The bulk at given positions: its energy [N mm] and the gradient (n, 3) [N]."""

    @property
    def energy(self) -> float: ...

    @property
    def gradient(self) -> Array: ...


P = TypeVar("P", bound=EnergyPoint)


class BulkModel(Protocol[P]):
    """The body that resists the contact, as a function of the positions x (n, 3) of some nodes."""

    def at(self, x: Array) -> P: ...

    def along(self, here: P, x: Array, p: Array) -> Callable[[float], float]:
        """The energy at x + fraction p; `here` is the bulk at x."""

    def solve(self, here: P, contact: CoupledContact, D: Array, g: Array, symmetric: bool) -> Array | None:
        """The step (n, 3) that balances the gradient g (n, 3), with the contact's tangent D (f, q, 3, 3); None where
        the tangent is singular or, if symmetric, not positive definite."""


@dataclass(frozen=True)
class QuadraticPoint:
    """The condensed bulk at some positions."""

    energy: float
    gradient: Array


@dataclass(frozen=True)
class Quadratic:
    """The condensed bulk: u . force + u . S u / 2 of displacements u (k,) of the condensed unknowns from `start`."""

    start: Array  # (m, 3) [mm]
    dofs: Array  # (m, 3) number of the unknown, -1 where held
    schur: Schur
    force: Array  # (k,) [N]

    def at(self, x: Array) -> QuadraticPoint:
        free = self.dofs >= 0
        u, gradient = (x - self.start)[free], np.zeros(x.shape)
        g = self.schur.times(u) + self.force
        gradient[free] = g
        return QuadraticPoint(float(u @ (g + self.force)) / 2, gradient)

    def along(self, here: QuadraticPoint, x: Array, p: Array) -> Callable[[float], float]:
        """A parabola."""
        v = p[self.dofs >= 0]
        slope, curvature = float((here.gradient * p).sum()), float(v @ self.schur.times(v))
        return lambda fraction: here.energy + fraction * slope + fraction**2 * curvature / 2

    def solve(self, here: QuadraticPoint, contact: CoupledContact, D: Array, g: Array, symmetric: bool) -> Array | None:
        faces = contact.contact.faces
        loaded = np.flatnonzero(D.any((1, 2, 3)))
        K = self.schur.stiffness(D[loaded], faces.N, self.dofs[faces.conn[loaded]])
        p = np.zeros(g.shape)
        try:
            p[self.dofs >= 0] = self.schur.solver(K, symmetric)(-g[self.dofs >= 0])
        except np.linalg.LinAlgError:
            return None
        return p if np.isfinite(p).all() else None


@dataclass(frozen=True)
class ContactSolution:
    """Positions x (n, 3), the contact with its offset there, its forces, and how the iteration ended."""

    x: Array
    contact: CoupledContact
    forces: ContactForces
    converged: bool
    steps: int
    unstable: bool = False  # a node reached the radius, or no step decreases the merit function


def solve_contact(
    bulk: BulkModel[P], contact: CoupledContact, x: Array, *, xtol: float, max_steps: int, radius: float = np.inf
) -> ContactSolution:
    """Equilibrium of bulk, barrier and friction, with the indenter shrunk by the resulting mean gap.

    Ends when a full step moves no node by more than xtol [mm] and the mean gap agrees, or when a node has moved by
    `radius` [mm].
    """

    def residual(at: P, forces: ContactForces) -> Array:
        return np.asarray(at.gradient - contact.contact.faces.scatter(forces.force, len(x)))

    steps, length, drift, start = 0, np.inf, 0.0, x
    here, forces = bulk.at(x), contact.evaluate(x)
    g = residual(here, forces)
    while True:
        if length <= contact.contact.dhat and forces.N.any():  # far from the solution the mean gap is meaningless
            drift = forces.mean_gap - contact.contact.offset
            contact = contact.shrunk(forces.mean_gap)
            forces = contact.evaluate(x)
            g = residual(here, forces)
        if steps == max_steps:
            return ContactSolution(x, contact, forces, False, steps)
        steps += 1
        p = bulk.solve(here, contact, forces.tangent, g, False)
        full = None
        if p is not None and contact.contact.max_step(forces.gap, p) == 1.0:
            there, felt = bulk.at(x + p), contact.evaluate(x + p)
            ahead = residual(there, felt)
            if np.linalg.norm(ahead) <= FULL_STEP * np.linalg.norm(g):
                full = there, felt, ahead
        fraction = 1.0
        if full is None:
            fraction, p = _downhill(bulk, here, contact, forces, x, g, p)
        if p is None:
            return ContactSolution(x, contact, forces, False, steps, True)
        before, x, length = x, x + fraction * p, float(np.abs(p).max())
        if np.abs(x - start).max() > radius:
            x = before + _to_radius(before - start, x - before, radius) * (x - before)
            return ContactSolution(x, contact, contact.evaluate(x), False, steps, True)
        if full is None:
            here, forces = bulk.at(x), contact.evaluate(x)
            full = here, forces, residual(here, forces)
        here, forces, g = full
        off = forces.mean_gap - contact.contact.offset if forces.N.any() else 0.0
        if fraction == 1.0 and length <= xtol and max(abs(drift), abs(off)) <= xtol:
            return ContactSolution(x, contact, forces, True, steps)
        if fraction * length < SHORTEST * xtol:
            return ContactSolution(x, contact, forces, length <= xtol, steps)


def _to_radius(gone: Array, step: Array, radius: float) -> float:
    """Fraction of a step at which the first entry reaches the radius."""
    away = np.where(step != 0, (radius - np.sign(step) * gone) / np.maximum(np.abs(step), 1e-300), np.inf)
    return float(max(away.min(), 0.0))


def _downhill(
    bulk: BulkModel[P], at: P, contact: CoupledContact, forces: ContactForces, x: Array, g: Array, coupled: Array | None
) -> tuple[float, Array | None]:
    """Fraction and step that lower the merit function: the coupled step or, if less than MIN_COUPLED of it does, the
    symmetric one; None if neither does."""
    here = at.energy + contact.merit(x, forces)

    def decreasing(p: Array, least: float) -> float:
        slope = float((g * p).sum())
        if slope > 0:
            return 0.0
        energy = bulk.along(at, x, p)

        def trial(fraction: float) -> tuple[bool, None]:
            merit = energy(fraction) + contact.merit(x + fraction * p, forces)
            return armijo(merit, here, fraction * slope, ROUNDING), None

        return backtrack(trial, least, contact.contact.max_step(forces.gap, p))[0]

    if coupled is not None and (fraction := decreasing(coupled, MIN_COUPLED)) > 0:
        return fraction, coupled
    p = bulk.solve(at, contact, forces.definite, g, True)
    if p is not None and (fraction := decreasing(p, SHORTEST)) > 0:
        return fraction, p
    return 0.0, None
