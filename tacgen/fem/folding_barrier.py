"""A barrier that keeps elements from inverting at corners and edges, outside the integration points.

The strain energy is infinite at J <= 0, but it is evaluated at integration points only: a hex that is compressed in
front of a sliding indenter may invert at a corner (to J = -.46 in ordinary scenes). The barrier is 0 for J >= J0 and
infinite at J = 0. In a nearly incompressible gel the exact J is near 1 everywhere, so that J < J0 is a discretisation
error, and the barrier vanishes with refinement.

It is the clamped logarithm of IPC (Li et al. 2020) as a function of J; Schuller et al. (2013), "Locally injective
mappings", and Smith & Schaefer (2015), "Bijective parameterization with free boundaries", use it for areas.
"""

from dataclasses import dataclass, replace

import numpy as np

from tacgen.fem import assembly
from tacgen.fem.assembly import Pattern
from tacgen.fem.elasticity import Elastic, Point
from tacgen.fem.elements import Elements, dense_points, grid_points
from tacgen.fem.materials import Derivatives
from tacgen.fem.potential import Projection

Array = np.ndarray
STIFFNESS = 4.0  # over the shear modulus [-]: at 1 hexes still invert between points, at 10 Newton steps are short
J0 = 0.6  # J below which the barrier acts; without inversion J stays near 1 in a nearly incompressible gel [-]


@dataclass(frozen=True)
class ClampedLog:
    """U(J) = -mu (1 - J/J0)^2 ln(J/J0) for J < J0, 0 above, C2 at J0; a materials.Law.

    mu: STIFFNESS times the shear modulus [MPa].
    """

    mu: float

    @property
    def kappa(self) -> float:
        return self.mu

    def iso(self, I1: Array, I2: Array, J: Array) -> Derivatives:
        zero = np.zeros_like(J)
        return Derivatives(zero, np.stack([zero] * 3, -1), np.stack([zero] * 6, -1))

    def vol(self, J: Array) -> tuple[Array, Array, Array]:
        s = np.minimum(J / J0, 1.0)
        ln, r = np.log(s), 1 - s
        first, second = 2 * r * ln - r**2 / s, -2 * ln + 4 * r / s + (r / s) ** 2
        return -self.mu * r**2 * ln, self.mu / J0 * first, self.mu / J0**2 * second


@dataclass(frozen=True)
class FoldingPoint:
    """The elements that have a point with J < J0, and their state; None if there are none."""

    elastic: Elastic | None
    point: Point | None

    @property
    def energy(self) -> float:
        """[N mm]"""
        return 0.0 if self.point is None else self.point.energy

    def add_forces(self, out: Array) -> None:
        """Add dE/dx to out (n, 3) [N]."""
        if self.elastic is not None and self.point is not None:
            out += self.elastic.forces(self.point, len(out))

    def add_tangent(self, data: Array, projection: Projection) -> None:
        """Add d2E/dx2 to the entries of the Pattern."""
        if self.elastic is not None and self.point is not None:
            self.elastic.add_tangent(self.point, data, projection)


@dataclass(frozen=True)
class FoldingBarrier:
    """The barrier on elements of one law; fits potential.Potential."""

    elements: Elements  # with dense_points as integration points
    slots: Array
    mu: float
    dN: Array  # (a, 3, q), in the element's own coordinates
    rest: Array  # (e, q) det(dX/dxi)

    @classmethod
    def on(cls, pattern: Pattern, points: Array, elements: Elements, mu: float) -> "FoldingBarrier":
        dN = grid_points(elements.conn.shape[1])[1]
        rest = np.linalg.det(np.einsum("qaj,eai->eqij", dN, points[elements.conn]))
        dense, slots = dense_points(points, elements), pattern.slots(elements.conn)
        return cls(dense, slots, STIFFNESS * mu, np.ascontiguousarray(dN.transpose(1, 2, 0)), rest)

    def stiffened(self, times: float) -> "FoldingBarrier":
        """This barrier with `times` its stiffness."""
        return replace(self, mu=times * self.mu)

    def evaluate(self, x: Array) -> FoldingPoint:
        e = self.elements
        below = np.flatnonzero(assembly.least_J(x, e.conn, self.dN, self.rest) < J0)
        if not below.size:
            return FoldingPoint(None, None)
        some = Elements(e.conn[below], e.gradients[below], e.weights[below], e.pointwise, e.shape)
        part = Elastic(some, ClampedLog(self.mu), self.slots[below])
        return FoldingPoint(part, part.evaluate(x))

    def value(self, x: Array) -> float:
        return self.evaluate(x).energy

    def gradient(self, x: Array) -> Array:
        out = np.zeros_like(x)
        self.evaluate(x).add_forces(out)
        return out

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        self.evaluate(x).add_tangent(data, projection)
