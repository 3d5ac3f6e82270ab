"""Strain energy of elements of one law, its forces and its tangent; the pressure may be an unknown of its own.

A gel that hardly changes its volume has a pressure of a large modulus times J - 1. A Newton step that is right to first
order leaves a J that is wrong to second order, and with it a pressure wrong by several shear moduli: a tangent taken
with that pressure is indefinite or leads astray. So the solver carries J as predicted by the linearised step, as
Newton's method for displacement and pressure would, the pressure eliminated (Q1P0 as a mixed method, Simo, Taylor &
Pister 1985; mixed integration points, Magisano, Leonetti & Garcea 2017). At an equilibrium both are the same.
"""

from dataclasses import dataclass

import numpy as np

from tacgen.fem import assembly, kernels
from tacgen.fem.assembly import Pattern
from tacgen.fem.elements import Elements
from tacgen.fem.materials import Law
from tacgen.fem.potential import Projection

Array = np.ndarray
SMALLEST_J = 1e-9  # below it the energy is infinite: what is divided by J would overflow
NOTHING = np.zeros((0, 0, 3, 3))
PREDICTED = 2.0  # the predicted J is kept within this factor of the true one


@dataclass(frozen=True)
class Point:
    """The law at the integration points: F (e, q, 3, 3), I1 and J (e, q), and its derivatives in the invariants."""

    F: Array
    I1: Array
    J: Array
    energy: float  # [N mm], +inf where an element is turned inside out
    first: Array  # (e, q, 3), U' included
    second: Array  # (e, q, 6), U'' included unless the dilatation is the element's mean
    dilatation: Array  # (e,) U''(mean J)/volume, 0 without mean dilatation
    memory: Array  # (e, q, 3, 3) J^-2/3 M, or (0, 0, 3, 3)


@dataclass(frozen=True)
class Elastic:
    """Strain energy of elements of one law; infinite where an element turns inside out at an integration point.

    slots (e, 3a*3a): where each entry of an element's tangent stands in the Pattern; None where only energies and
    stresses are asked for. memory (e, q, 3, 3): M [MPa] of the energy J^-2/3 (M : F^T F)/2 that a viscoelastic gel has
    beside its law's.
    """

    elements: Elements
    law: Law
    slots: Array | None = None
    memory: Array | None = None

    @classmethod
    def on(cls, pattern: Pattern, elements: Elements, law: Law) -> "Elastic":
        return cls(elements, law, pattern.slots(elements.conn))

    @property
    def local(self) -> float:
        """The part of the volumetric energy that is taken at each point, not of the element's mean dilatation."""
        return min(1.0, self.elements.pointwise * self.law.mu / self.law.kappa)

    def evaluate(self, x: Array) -> Point:
        """Invariants, energies and derivatives at x; +inf is the energy, and the rest nonsense, unless J > 0."""
        F = assembly.deformation(x, self.elements.conn, self.elements.gradients)
        I1, I2, J = assembly.invariants(F)
        w = self.elements.weights
        bad = not (J > SMALLEST_J).all()
        if bad:
            J = np.where(J > SMALLEST_J, J, 1.0)
        iso = self.law.iso(I1, I2, J)
        volume = w.sum(1)
        first, second = iso.first.copy(), iso.second.copy()
        energy, dilatation = float((w * iso.value).sum()), np.zeros(len(w))
        local = self.local
        if local < 1:
            U, dU, ddU = self.law.vol((w * J).sum(1) / volume)
            energy += (1 - local) * float(volume @ U)
            first[..., 2] += (1 - local) * dU[:, None]
            dilatation = (1 - local) * ddU / volume
        if local > 0:
            U, dU, ddU = self.law.vol(J)
            energy += local * float((w * U).sum())
            first[..., 2] += local * dU
            second[..., 2] += local * ddU
        memory = NOTHING
        if self.memory is not None:
            memory = J[..., None, None] ** (-2 / 3) * self.memory
            stretch = np.einsum("eqik,eqkl,eqil->eq", F, memory, F)
            energy += float((w * (stretch - np.trace(self.memory, axis1=2, axis2=3))).sum()) / 2
            first[..., 2] -= stretch / (3 * J)
            second[..., 2] += 5 / 9 * stretch / J**2
        return Point(F, I1, J, np.inf if bad else energy, first, second, dilatation, memory)

    def forces(self, at: Point, nodes: int) -> Array:
        """dE/dx (nodes, 3) [N]."""
        out, e = np.zeros((nodes, 3)), self.elements
        assembly.add_forces(at.F, e.conn, e.gradients, e.weights, at.I1, at.first, at.memory, out)
        return out

    def predicted(self, at: Point, there: Point, taken: Array) -> Array:
        """J (e, q) at `there` as a step from `at` with the tangent taken at F `taken` (e, q, 3, 3) predicts it."""
        return np.asarray(assembly.predicted(taken, at.F, at.J, there.F))

    def mixed_forces(self, at: Point, J: Array, taken: Array, nodes: int) -> Array:
        """What a step with the tangent taken at F `taken` has to balance (nodes, 3) [N]; J (e, q) as predicted.

        The forces with the predicted pressure, and what is missing of the true one, acting as where the tangent was
        taken: the right-hand side of Newton's method for displacement and pressure after elimination of the pressure.
        With a tangent taken here it is `forces`.
        """
        e, first = self.elements, self._with_pressure(at, J)
        out = np.zeros((nodes, 3))
        assembly.add_forces(at.F, e.conn, e.gradients, e.weights, at.I1, first, at.memory, out)
        assembly.add_pressures(taken, e.conn, e.gradients, e.weights * (at.first - first)[..., 2], out)
        return out

    def add_tangent(self, at: Point, data: Array, projection: Projection, J: Array | None = None) -> None:
        """Add d2E/dx2 to the entries of the Pattern, with the pressure at a predicted J (e, q) if one is given."""
        assert self.slots is not None
        e, first = self.elements, at.first if J is None else self._with_pressure(at, J)
        kernels.add_tangent(
            at.F, e.gradients, e.weights, first, at.second, at.dilatation, at.memory, int(projection), self.slots, data
        )

    def _with_pressure(self, at: Point, J: Array) -> Array:
        """Point.first (e, q, 3) with the pressure of another J (e, q)."""
        J = np.clip(J, at.J / PREDICTED, PREDICTED * at.J)
        first, w, local = at.first.copy(), self.elements.weights, self.local
        if local < 1:
            new, old = ((w * j).sum(1) / w.sum(1) for j in (J, at.J))
            first[..., 2] += (1 - local) * (self.law.vol(new)[1] - self.law.vol(old)[1])[:, None]
        if local > 0:
            first[..., 2] += local * (self.law.vol(J)[1] - self.law.vol(at.J)[1])
        return first

    def value(self, x: Array) -> float:
        return self.evaluate(x).energy

    def gradient(self, x: Array) -> Array:
        return self.forces(self.evaluate(x), len(x))

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        self.add_tangent(self.evaluate(x), data, projection)

    def max_step(self, x: Array, p: Array) -> float:
        return 1.0

    def energies(self, x: Array) -> Array:
        """Strain energy (e,) [N mm] of each element."""
        F = assembly.deformation(x, self.elements.conn, self.elements.gradients)
        I1, I2, J = assembly.invariants(F)
        w, volume = self.elements.weights, self.elements.weights.sum(1)
        iso, local = (w * self.law.iso(I1, I2, J).value).sum(1), self.local
        mean, at_points = self.law.vol((w * J).sum(1) / volume)[0], self.law.vol(J)[0]
        return np.asarray(iso + (1 - local) * volume * mean + local * (w * at_points).sum(1))

    def cauchy(self, at: Point) -> tuple[Array, Array]:
        """Cauchy stress (e, q, 3, 3) [MPa] from the law, sigma = P F^T / J, and current volumes (e, q) [mm^3]."""
        return assembly.cauchy(at.F, at.I1, at.J, at.first, at.memory), self.elements.weights * at.J
