"""A barrier that keeps elements from inverting at corners and edges, outside the integration points.

The strain energy is infinite at J <= 0, but it is evaluated at integration points only: a hex that is compressed in
front of a sliding indenter may invert at a corner (to J = -.46 in ordinary scenes). The barrier is 0 for J >= J0 and
infinite at J = 0. In a nearly incompressible gel the exact J is near 1 everywhere, so that J < J0 is a discretisation
error, and the barrier vanishes with refinement.

It is the clamped logarithm of IPC (Li et al. 2020) as a function of J; Schuller et al. (2013), "Locally injective
mappings", and Smith & Schaefer (2015), "Bijective parameterization with free boundaries", use it for areas.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tacgen.fem.assembly import Pattern
from tacgen.fem.elements import Elements, grid_points, jacobians
from tacgen.fem.potential import Projection

if TYPE_CHECKING:
    from tacgen.physics.cells import Folds

Array = np.ndarray
# over the shear modulus [-]: at 1 hexes still invert between points, at 10 Newton steps are short
INVERSION_BARRIER_STIFFNESS = 4.0


@dataclass(frozen=True)
class FoldingPoint:
    """The barrier at positions x (n, 3): the cells (k,) that have a point with J < J0, and their energy [N mm]."""

    barrier: "FoldingBarrier"
    x: Array
    cells: Array
    energy: float

    def add_forces(self, out: Array) -> None:
        """Add dE/dx to out (n, 3) [N]."""
        if self.cells.size:
            np.add.at(out, self.barrier.conn[self.cells], self.barrier.folds.forces(self.x, self.cells))

    def add_tangent(self, data: Array, projection: Projection) -> None:
        """Add d2E/dx2 to the entries of the Pattern."""
        if self.cells.size:
            self.barrier.folds.add_tangent(self.x, self.cells, int(projection), self.barrier.slots, data)


@dataclass(frozen=True)
class FoldingBarrier:
    """The barrier on elements of one law; fits potential.Potential.

    conn (e, a); slots as in elasticity.Elastic; rest (e, q): det(dX/dxi) at `grid_points`; volume (e,) [mm^3].
    """

    conn: Array
    slots: Array
    stiffness: float  # INVERSION_BARRIER_STIFFNESS times the shear modulus [MPa]
    rest: Array
    volume: Array

    @classmethod
    def on(cls, pattern: Pattern, points: Array, elements: Elements, mu: float) -> "FoldingBarrier":
        conn, stiffness = elements.conn, INVERSION_BARRIER_STIFFNESS * mu
        rest = np.linalg.det(jacobians(points, conn, grid_points(conn.shape[1])[1]))
        return cls(conn, pattern.slots(conn), stiffness, rest, elements.weights.sum(1))

    def stiffened(self, times: float) -> "FoldingBarrier":
        """This barrier with `times` its stiffness."""
        return replace(self, stiffness=times * self.stiffness)

    @cached_property
    def folds(self) -> "Folds":
        from tacgen.physics.cells import Folds

        dN = grid_points(self.conn.shape[1])[1]
        return Folds(self.conn, dN, self.rest, self.stiffness * self.volume / len(dN))

    def evaluate(self, x: Array) -> FoldingPoint:
        below = self.folds.below(x)
        return FoldingPoint(self, x, below, self.folds.energy(x, below) if below.size else 0.0)

    def value(self, x: Array) -> float:
        return self.evaluate(x).energy

    def gradient(self, x: Array) -> Array:
        out = np.zeros_like(x)
        self.evaluate(x).add_forces(out)
        return out

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        self.evaluate(x).add_tangent(data, projection)
