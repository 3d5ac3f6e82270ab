"""Everything that resists the press is a Potential; their sum is one too. Elasticity is the first."""

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from tacgen.fem import assembly
from tacgen.fem.assembly import Pattern
from tacgen.fem.elements import Elements
from tacgen.fem.last import Last
from tacgen.fem.materials import Law
from tacgen.fem.meant import Meant
from tacgen.fem.stiffness import LAZY, Kept

Array = np.ndarray
LEAST = 1e-9  # of its volume that an element can have: below, what is divided by it overflows
LAST = -1  # a way to take a stiffness: exact, but with the pressure of the last answer


@runtime_checkable
class Potential(Protocol):
    """An energy of the nodal positions x (n, 3) [mm]."""

    def value(self, x: Array) -> float:
        """Energy [N mm]; +inf where x is not admissible."""

    def gradient(self, x: Array) -> Array:
        """dE/dx (n, 3) [N]."""

    def add_hessian(self, x: Array, data: Array, project: int) -> None:
        """Add d2E/dx2 to `data`, the entries of the Pattern: exact (0, but for pressures LAST), mended where that pays
        (1) or made positive semi-definite (2)."""

    def max_step(self, x: Array, p: Array) -> float:
        """Largest a in (0, 1] such that x + a p is reached without passing through anything."""


@dataclass(frozen=True)
class Total:
    """The sum of some potentials."""

    parts: tuple[Potential, ...]

    def value(self, x: Array) -> float:
        return sum(part.value(x) for part in self.parts)

    def gradient(self, x: Array) -> Array:
        total = np.zeros_like(x)
        for part in self.parts:
            total += part.gradient(x)
        return total

    def add_hessian(self, x: Array, data: Array, project: int) -> None:
        for part in self.parts:
            part.add_hessian(x, data, project)

    def max_step(self, x: Array, p: Array) -> float:
        return min(part.max_step(x, p) for part in self.parts)


@dataclass(frozen=True)
class Point:
    """The law at the integration points: F (e, q, 3, 3), I1 and J (e, q), and its derivatives in the invariants."""

    F: Array
    I1: Array
    J: Array
    energy: float  # [N mm], +inf where an element is turned inside out
    first: Array  # (e, q, 3), U' included
    second: Array  # (e, q, 6), U'' included unless the dilatation is the element's mean
    dilatation: Array  # (e,) U''(theta)/volume, 0 without mean dilatation


@dataclass(frozen=True)
class Elastic:
    """Strain energy of elements of one law. Elements that turn inside out have infinite energy.

    Its stiffness is exact when it is first asked for; later that of a hardly changed element is the old one.
    """

    elements: Elements
    law: Law
    stiffness: Kept | None = None  # None where only energies and stresses are asked for
    _last: Last = field(default_factory=Last, init=False, compare=False, repr=False)
    _meant: Meant = field(default_factory=Meant, init=False, compare=False, repr=False)

    @classmethod
    def on(cls, pattern: Pattern, elements: Elements, law: Law, lazy: float = LAZY) -> "Elastic":
        slots = pattern.slots(elements.conn)
        return cls(elements, law, Kept(slots, len(pattern.indices), elements.weights.shape[1], lazy))

    @property
    def local(self) -> float:
        """The part of the volumetric energy that is taken at each point, not of the element's mean dilatation."""
        return min(1.0, self.elements.pointwise * self.law.mu / self.law.kappa)

    def at(self, x: Array) -> Point:
        """Invariants, energies and derivatives at x; +inf is the energy, and the rest nonsense, unless J > LEAST."""
        point: Point = self._last.of(x, self._evaluate)
        return point

    def _evaluate(self, x: Array) -> Point:
        F = assembly.deformation(x, self.elements.conn, self.elements.gradients)
        I1, I2, J = assembly.invariants(F)
        w = self.elements.weights
        bad = not (J > LEAST).all()
        if bad:
            J = np.where(J > LEAST, J, 1.0)
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
        return Point(F, I1, J, np.inf if bad else energy, first, second, dilatation)

    def hold(self, x: Array) -> None:
        """From the answer x on, take the stiffness with the pressure that steps are meant to give (see Meant)."""
        self._meant.hold(self.at(x).J)

    def value(self, x: Array) -> float:
        return self.at(x).energy

    def gradient(self, x: Array) -> Array:
        e, at = self.elements, self.at(x)
        if self.stiffness is not None:
            self._meant.step(at.F, at.J, self.stiffness.taken)
        out = np.zeros_like(x)
        assembly.add_forces(at.F, e.conn, e.gradients, e.weights, at.I1, at.first, out)
        return out

    def unbalanced(self, x: Array) -> Array:
        """What a step by the stiffness as it was last taken is to undo (n, 3) [N]; at an answer, the gradient.

        The gradient with the pressure meant (see Meant), and what is missing of that, acting as where the stiffness was
        taken: what is left of Newton's method for displacement and pressure when the pressure is eliminated.
        """
        e, at = self.elements, self.at(x)
        assert self.stiffness is not None
        self._meant.step(at.F, at.J, self.stiffness.taken)
        first = self._pressed(at, self._meant.at(at.F, at.J))
        out = np.zeros_like(x)
        assembly.add_forces(at.F, e.conn, e.gradients, e.weights, at.I1, first, out)
        missed = e.weights * (at.first - first)[..., 2]
        assembly.add_pressures(self.stiffness.taken, e.conn, e.gradients, missed, out)
        return out

    def add_hessian(self, x: Array, data: Array, project: int) -> None:
        e, at = self.elements, self.at(x)
        assert self.stiffness is not None
        last = self._meant.last if project == LAST else None
        first = self._pressed(at, self._meant.at(at.F, at.J) if last is None else last)
        data += self.stiffness.at(at.F, e.gradients, e.weights, first, at.second, at.dilatation, max(project, 0))

    def _pressed(self, at: Point, J: Array) -> Array:
        """Point.first (e, q, 3) with the pressure of another J (e, q)."""
        if J is at.J:
            return at.first
        first, w, local = at.first.copy(), self.elements.weights, self.local
        if local < 1:
            new, old = ((w * j).sum(1) / w.sum(1) for j in (J, at.J))
            first[..., 2] += (1 - local) * (self.law.vol(new)[1] - self.law.vol(old)[1])[:, None]
        if local > 0:
            first[..., 2] += local * (self.law.vol(J)[1] - self.law.vol(at.J)[1])
        return first

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

    def cauchy(self, x: Array) -> tuple[Array, Array]:
        """Cauchy stress (e, q, 3, 3) [MPa] from the law, sigma = P F^T / J, and current volumes (e, q) [mm^3]."""
        at = self.at(x)
        b = at.F @ at.F.swapaxes(-1, -2)
        f = at.first[..., None, None]
        PFt = 2 * (f[..., 0, :, :] + f[..., 1, :, :] * at.I1[..., None, None]) * b - 2 * f[..., 1, :, :] * (b @ b)
        J = at.J[..., None, None]
        return PFt / J + f[..., 2, :, :] * np.eye(3), self.elements.weights * at.J
