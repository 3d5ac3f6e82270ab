"""A barrier against elements that fold at their corners while the integration points inside them are still sound.

The strain energy is infinite where J <= 0, but it is only taken at integration points: a hex squeezed before a rubbing
indenter may turn inside out at a corner (to -.46 of its volume in ordinary scenes). The barrier is 0 unless J at a
corner is below J0, so that nothing changes elsewhere, and infinite at J = 0; the clamped logarithm of IPC (Li et al.
2020) on J, as Schuller et al. (2013), "Locally injective mappings", and Smith & Schaefer (2015) have it on areas.
"""

from dataclasses import dataclass

import numpy as np

from tacgen.fem import assembly
from tacgen.fem.assembly import Pattern
from tacgen.fem.elasticity import Elastic, Point
from tacgen.fem.elements import Elements, at_nodes
from tacgen.fem.materials import Derivatives
from tacgen.fem.potential import Projection

Array = np.ndarray
J0 = 0.6  # of the rest volume, where the barrier begins: that of a gel that keeps its volume stays near 1


@dataclass(frozen=True)
class ClampedLog:
    """U(J) = -mu (1 - J/J0)^2 ln(J/J0) for J < J0, 0 above and C2 there; as a law of materials."""

    mu: float  # [MPa]

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
class CornerBarrier:
    """The barrier on elements of one law; fits elasticity.Elastic, of which it makes one for the elements below J0."""

    elements: Elements  # with the nodes for integration points
    slots: Array
    mu: float

    @classmethod
    def on(cls, pattern: Pattern, points: Array, elements: Elements, mu: float) -> "CornerBarrier":
        return cls(at_nodes(points, elements), pattern.slots(elements.conn), mu)

    def active(self, x: Array) -> tuple[Elastic, Point] | None:
        """The elements with a corner below J0 and what holds there; None where there is none."""
        e = self.elements
        J = assembly.determinants(x, e.conn, e.gradients)
        below = np.flatnonzero((J < J0).any(1))
        if not below.size:
            return None
        some = Elements(e.conn[below], e.gradients[below], e.weights[below], e.pointwise, e.shape)
        part = Elastic(some, ClampedLog(self.mu), self.slots[below])
        return part, part.evaluate(x)

    def value(self, x: Array) -> float:
        found = self.active(x)
        return 0.0 if found is None else found[1].energy

    def gradient(self, x: Array) -> Array:
        found = self.active(x)
        return np.zeros_like(x) if found is None else found[0].forces(found[1], len(x))

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        if (found := self.active(x)) is not None:
            found[0].add_tangent(found[1], data, projection)

    def max_step(self, x: Array, p: Array) -> float:
        return 1.0
