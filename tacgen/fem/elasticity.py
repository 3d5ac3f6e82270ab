"""Strain energy of elements of one law, with forces and tangent; the pressure may be an independent unknown.

In a nearly incompressible gel the pressure is a large modulus times J - 1. After a Newton step, which is exact to first
order, J has an error of second order, and the pressure an error of several shear moduli: a tangent with that pressure
is often indefinite. The solver therefore uses J as predicted by the linearised step, as Newton's method for
displacement and pressure does after elimination of the pressure (Q1P0 as a mixed method, Simo, Taylor & Pister 1985;
mixed integration points, Magisano, Leonetti & Garcea 2017). At equilibrium both values of J agree.
"""

from dataclasses import dataclass

import numpy as np

from tacgen.fem import assembly, kernels
from tacgen.fem.assembly import Pattern
from tacgen.fem.elements import Elements
from tacgen.fem.materials import Law
from tacgen.fem.potential import Projection

Array = np.ndarray
SMALLEST_J = 1e-9  # J below which the energy is infinite, so that divisions by J do not overflow [-]
PREDICTED = 2.0  # largest ratio of the predicted J to the true one, and of the true one to the predicted [-]


@dataclass(frozen=True)
class Point:
    """State at the integration points: F (e, q, 3, 3), I1, J (e, q), and the law's derivatives in the invariants."""

    F: Array
    I1: Array
    J: Array
    energy: float  # [N mm], +inf if an element is inverted
    first: Array  # (e, q, 3), U' included
    second: Array  # (e, q, 6), U'' included except the part that acts on the mean dilatation
    dilatation: Array  # (e,) U''(mean J)/volume, 0 without mean dilatation
    memory: Array | None  # (e, q, 3, 3) J^-2/3 M; None: elastic


@dataclass(frozen=True)
class Elastic:
    """Strain energy of elements of one law; infinite if an element is inverted at an integration point.

    slots (e, 3a*3a): index of each entry of an element's tangent in the Pattern; None if only energies and stresses
    are needed. memory (e, q, 3, 3): M [MPa] of the additional energy J^-2/3 (M : F^T F)/2 of a viscoelastic gel.
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
        """Share of the volumetric energy that is a function of J at each point, not of the element's mean J [-]."""
        return min(1.0, self.elements.pointwise * self.law.mu / self.law.kappa)

    def evaluate(self, x: Array) -> Point:
        """Invariants, energy and derivatives at x; if J <= 0 anywhere the energy is +inf and the rest is undefined."""
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
        memory = None
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
        """J (e, q) at `there`, predicted by a step from `at` whose tangent was computed at F = `taken` (e, q, 3, 3)."""
        return np.asarray(assembly.predicted(taken, at.F, at.J, there.F))

    def mixed_forces(self, at: Point, J: Array, taken: Array, nodes: int) -> Array:
        """Right-hand side (nodes, 3) [N] of a step whose tangent was computed at F = `taken`; J (e, q) is predicted.

        The forces with the predicted pressure, plus the difference to the true pressure acting at `taken`: the
        right-hand side of Newton's method for displacement and pressure after elimination of the pressure. With a
        tangent computed at x itself it equals `forces`.
        """
        e, first = self.elements, self._with_pressure(at, J)
        out = np.zeros((nodes, 3))
        assembly.add_forces(at.F, e.conn, e.gradients, e.weights, at.I1, first, at.memory, out)
        assembly.add_pressures(taken, e.conn, e.gradients, e.weights * (at.first - first)[..., 2], out)
        return out

    def add_tangent(self, at: Point, data: Array, projection: Projection, J: Array | None = None) -> None:
        """Add d2E/dx2 to the entries of the Pattern; if J (e, q) is given, with the pressure at that J."""
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
