"""Newton's method for contact with friction on a linearised bulk: the inner loop, one step at a time.

The step uses the consistent, non-symmetric tangent. It is taken in full if it halves the residual, as it does near the
solution, where convergence is quadratic. Otherwise Armijo's rule decreases the merit function: the energy of bulk and
barrier, and of friction with its normal forces frozen at the start of the step. If the coupled step is no descent
direction, Newton's step for the merit function is used. Where that function is not convex, the equilibrium is unstable:
the search ends, and the bulk needs damping.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from tacgen.mechanics.condensation import Schur
from tacgen.mechanics.coupled import ContactForces, CoupledContact
from tacgen.mechanics.line_search import backtrack
from tacgen.mechanics.measures import SMALLEST
from tacgen.physics.decisions import (
    ARMIJO_DECREASE,
    MAX_FULL_STEP_RESIDUAL_RATIO,
    MERIT_ROUNDING,
    MIN_COUPLED_FRACTION,
    MIN_LINE_SEARCH_FRACTION,
    ContactStatus,
    after_step,
    armijo,
    shrinks,
)

Array = np.ndarray
SAME_ITERATE_TOL = 0.1  # distance of two iterates, over the tolerance, up to which they are one place [-]


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
class ContactIterate(Generic[P]):
    """Positions x (n, 3), the contact with its offset there, its forces, the bulk there, and the residual g (n, 3) [N];
    how many steps led there from `start`, the longest motion of a node [mm] in the last one, and by how much the mean
    gap was off before it [mm]."""

    x: Array
    contact: CoupledContact
    forces: ContactForces
    here: P
    g: Array
    start: Array
    steps: int = 0
    length: float = np.inf
    drift: float = 0.0
    status: ContactStatus = ContactStatus.running
    before: "ContactIterate[P] | None" = None  # one step earlier

    @property
    def converged(self) -> bool:
        return self.status is ContactStatus.converged

    @property
    def off(self) -> float:
        """By how much [mm] the mean gap is not the one by which the indenter is shrunk; nan without contact."""
        return abs(self.forces.mean_gap - self.contact.contact.offset)


def contact_start(bulk: BulkModel[P], contact: CoupledContact, x: Array) -> ContactIterate[P]:
    """The iterate before the first step."""
    here, forces, g = _evaluated(bulk, contact, x)
    return ContactIterate(x, contact, forces, here, g, x)


def contact_step(
    bulk: BulkModel[P], now: ContactIterate[P], *, xtol: float, max_steps: int, radius: float = np.inf
) -> ContactIterate[P]:
    """One step towards the equilibrium of bulk, barrier and friction, with the indenter shrunk by the mean gap.

    It has converged when a full step moves no node by more than xtol [mm] and the mean gap agrees, and is unstable when
    a node has moved by `radius` [mm].
    """
    x, contact, forces, here, g, drift = now.x, now.contact, now.forces, now.here, now.g, now.drift
    earlier, start = now.before, replace(now, before=None)
    if shrinks(now.length, contact.contact.dhat, gap := forces.mean_gap):
        drift, contact = gap - contact.contact.offset, contact.shrunk(gap)
        forces = contact.evaluate(x, forces.seen)
        g = _residual(contact, here, forces)
    now = replace(now, contact=contact, forces=forces, g=g, drift=drift, status=ContactStatus.stopped)
    if now.steps == max_steps:
        return replace(now, status=ContactStatus.circling)
    now = replace(now, steps=now.steps + 1)
    p = bulk.solve(here, contact, forces.tangent, g, False)
    full, fraction = None if p is None else _full(bulk, contact, forces, x, g, p), 1.0
    if full is None:
        fraction, p = _downhill(bulk, here, contact, forces, x, g, p)
    if p is None:
        return replace(now, status=ContactStatus.unstable)
    there, length = x + fraction * p, float(np.abs(p).max())
    if np.abs(there - now.start).max() > radius:
        there = x + _to_radius(x - now.start, there - x, radius) * (there - x)
        return replace(now, x=there, forces=contact.evaluate(there), status=ContactStatus.unstable)
    here, forces, g = full or _evaluated(bulk, contact, there)
    now = replace(now, x=there, forces=forces, here=here, g=g, length=length)
    status = after_step(fraction == 1.0, fraction, length, drift, now.off, xtol, MIN_LINE_SEARCH_FRACTION)
    if status != ContactStatus.running:
        return replace(now, status=ContactStatus(status))
    if earlier is not None and _far(now, earlier) <= SAME_ITERATE_TOL * xtol < length:
        lower = min(now, start, key=lambda one: float(np.linalg.norm(one.g)))
        return replace(lower, steps=now.steps, length=length, status=ContactStatus.circling)
    return replace(now, before=start, status=ContactStatus.running)


def solve_contact(
    bulk: BulkModel[P], contact: CoupledContact, x: Array, *, xtol: float, max_steps: int, radius: float = np.inf
) -> ContactIterate[P]:
    """Steps from x (n, 3) until the iteration ends; see contact_step."""
    now = contact_start(bulk, contact, x)
    while now.status is ContactStatus.running:
        now = contact_step(bulk, now, xtol=xtol, max_steps=max_steps, radius=radius)
    return now


def _residual(contact: CoupledContact, at: EnergyPoint, forces: ContactForces) -> Array:
    return np.asarray(at.gradient - contact.contact.faces.scatter(forces.force, len(at.gradient)))


def _evaluated(bulk: BulkModel[P], contact: CoupledContact, x: Array) -> tuple[P, ContactForces, Array]:
    """The bulk, the contact's forces and the residual at x (n, 3)."""
    there, felt = bulk.at(x), contact.evaluate(x)
    return there, felt, _residual(contact, there, felt)


def _far(a: ContactIterate[P], b: ContactIterate[P]) -> float:
    """By how much two iterates differ [mm]: in a node's position or in the indenter's offset."""
    return max(float(np.abs(a.x - b.x).max()), abs(a.contact.contact.offset - b.contact.contact.offset))


def _full(
    bulk: BulkModel[P], contact: CoupledContact, forces: ContactForces, x: Array, g: Array, p: Array
) -> tuple[P, ContactForces, Array] | None:
    """The end of the coupled step p (n, 3), if it may be taken in full; else None."""
    if contact.contact.max_step(forces.gap, p) < 1.0:
        return None
    there = _evaluated(bulk, contact, x + p)
    return there if np.linalg.norm(there[2]) <= MAX_FULL_STEP_RESIDUAL_RATIO * np.linalg.norm(g) else None


def _to_radius(gone: Array, step: Array, radius: float) -> float:
    """Fraction of a step at which the first entry reaches the radius."""
    away = np.where(step != 0, (radius - np.sign(step) * gone) / np.maximum(np.abs(step), SMALLEST), np.inf)
    return float(max(away.min(), 0.0))


def _downhill(
    bulk: BulkModel[P], at: P, contact: CoupledContact, forces: ContactForces, x: Array, g: Array, coupled: Array | None
) -> tuple[float, Array | None]:
    """Fraction and step that lower the merit function: the coupled step or, if less than MIN_COUPLED_FRACTION of it
    does, the symmetric one; None if neither does."""
    here = at.energy + contact.merit(x, forces)

    def decreasing(p: Array, least: float) -> float:
        slope = float((g * p).sum())
        if slope > 0:
            return 0.0
        energy = bulk.along(at, x, p)

        def trial(fraction: float) -> tuple[bool, None]:
            merit = energy(fraction) + contact.merit(x + fraction * p, forces)
            return armijo(merit, here, fraction * slope, MERIT_ROUNDING, ARMIJO_DECREASE), None

        return backtrack(trial, least, contact.contact.max_step(forces.gap, p))[0]

    if coupled is not None and (fraction := decreasing(coupled, MIN_COUPLED_FRACTION)) > 0:
        return fraction, coupled
    p = bulk.solve(at, contact, forces.definite, g, True)
    if p is not None and (fraction := decreasing(p, MIN_LINE_SEARCH_FRACTION)) > 0:
        return fraction, p
    return 0.0, None
