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

import numpy as np

from tacgen.fem.assembly import Pattern
from tacgen.fem.elements import Elements, grid_points, jacobians
from tacgen.fem.projection import Projection
from tacgen.physics.cells import ONLY_SCENE, Folds
from tacgen.physics.tangents import double

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

    @property
    def _items(self) -> Array:
        """The cells as the kernels take them, of the only scene."""
        return np.stack([np.zeros_like(self.cells), self.cells], -1).astype(np.int32)

    def add_forces(self, out: Array) -> None:
        """Add dE/dx to out (n, 3) [N]."""
        if self.cells.size:
            forces = self.barrier.folds.found(self.x[None], True, self._items)[1]
            np.add.at(out, self.barrier.elements.conn[self.cells], forces)

    def add_tangent(self, data: Array, projection: Projection) -> None:
        """Add d2E/dx2 to the entries of the Pattern."""
        if not self.cells.size:
            return
        folds, items = self.barrier.folds, self._items
        points = folds.points(self.x[None], double(), items, np.zeros(len(items)), int(projection))
        slopes = np.broadcast_to(folds.dN, (1, *self.barrier.elements.conn.shape[:1], *folds.dN.shape))
        points.add(slopes, ONLY_SCENE, items, False, self.barrier.slots, data)


@dataclass(frozen=True)
class FoldingBarrier:
    """The barrier on elements of one law.

    slots as in elasticity.Elastic; rest (e, q): det(dX/dxi) at `grid_points`.
    """

    elements: Elements
    slots: Array
    stiffness: float  # INVERSION_BARRIER_STIFFNESS times the shear modulus [MPa]
    rest: Array

    @classmethod
    def on(cls, pattern: Pattern, points: Array, elements: Elements, mu: float) -> "FoldingBarrier":
        conn = elements.conn
        rest = np.linalg.det(jacobians(points, conn, grid_points(conn.shape[1])[1]))
        return cls(elements, pattern.slots(conn), INVERSION_BARRIER_STIFFNESS * mu, rest)

    def stiffened(self, times: float) -> "FoldingBarrier":
        """This barrier with `times` its stiffness."""
        return replace(self, stiffness=times * self.stiffness)

    @cached_property
    def folds(self) -> Folds:
        """The barrier as the kernels take it."""
        dN, volume = grid_points(self.elements.conn.shape[1])[1], self.elements.weights.sum(1)
        stiffness = self.stiffness * volume / len(dN)
        rest = self.rest[None]
        return Folds(self.elements.numbering, dN, rest, rest.max(-1), stiffness[None], ONLY_SCENE)

    def evaluate(self, x: Array) -> FoldingPoint:
        energies, _ = self.folds.found(x[None], False)
        below = np.flatnonzero(energies)
        return FoldingPoint(self, x, below, float(energies[below].sum()))

    def value(self, x: Array) -> float:
        return self.evaluate(x).energy

    def gradient(self, x: Array) -> Array:
        out = np.zeros_like(x)
        self.evaluate(x).add_forces(out)
        return out

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        self.evaluate(x).add_tangent(data, projection)
