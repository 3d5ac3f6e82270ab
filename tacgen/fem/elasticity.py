"""Strain energy of elements of one law, with forces and tangent; the pressure may be an independent unknown.

In a nearly incompressible gel the pressure is a large modulus times J - 1. After a Newton step, which is exact to first
order, J has an error of second order, and the pressure an error of several shear moduli: a tangent with that pressure
is often indefinite. The solver therefore uses J as predicted by the linearised step, as Newton's method for
displacement and pressure does after elimination of the pressure (Q1P0 as a mixed method, Simo, Taylor & Pister 1985;
mixed integration points, Magisano, Leonetti & Garcea 2017). At equilibrium both values of J agree.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacgen.fem.assembly import Pattern
from tacgen.fem.elements import Elements
from tacgen.fem.materials import Law
from tacgen.fem.projection import Projection
from tacgen.physics.cells import ONLY_SCENE, Cells
from tacgen.physics.laws import two_invariants
from tacgen.physics.tangents import double

Array = np.ndarray


@dataclass(frozen=True)
class Point:
    """State at the integration points: F (e, q, 3, 3), J (e, q), and weights times P (e, q, 3, 3) [N mm]."""

    F: Array
    J: Array
    energies: Array  # (e,) [N mm], +inf where an element is inverted
    stress: Array

    @property
    def energy(self) -> float:
        """[N mm], +inf if an element is inverted."""
        return float(self.energies.sum())


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

    @cached_property
    def _cells(self) -> Cells:
        """The elements with their law, as the only scene of kernels."""
        elements, law = self.elements, self.law.coefficients
        laws, memory = np.tile(law, (1, len(elements.conn), 1)), None if self.memory is None else self.memory[None]
        parts = elements.numbering, elements.gradients[None], elements.weights[None], laws, two_invariants(law)
        return Cells(*parts, ONLY_SCENE, memory, self.local)

    def evaluate(self, x: Array) -> Point:
        """F, J, energies and stresses at x; where J <= 0 the energy is +inf, J is 1 and the stress undefined."""
        F = self._cells.deformation(x[None])
        energies, J, stress = self._cells.states(F, True)
        return Point(F[0], J[0], energies[0], stress[0])

    def isochoric_stress(self, x: Array) -> Array:
        """s = J^2/3 F^-1 P (e, q, 3, 3) [MPa] at x, where P is the stress without U and memory."""
        return np.asarray(self._cells.isochoric_stress(x[None])[0])

    def forces(self, at: Point, nodes: int) -> Array:
        """dE/dx (nodes, 3) [N]."""
        return self._forces(at.stress[None], nodes)

    def _forces(self, stress: Array, nodes: int) -> Array:
        out, found = np.zeros((nodes, 3)), self._cells.forces(stress)[0]
        out[: len(found)] = found
        return out

    def predicted(self, at: Point, there: Point, taken: Array) -> Array:
        """J (e, q) at `there`, predicted by a step from `at` whose tangent was computed at F = `taken` (e, q, 3, 3)."""
        return np.asarray(self._cells.linearised(at.F[None], there.F[None], taken[None])[0])

    def mixed_forces(self, at: Point, J: Array, taken: Array, nodes: int) -> Array:
        """Right-hand side (nodes, 3) [N] of a step whose tangent was computed at F = `taken`; J (e, q) is predicted.

        The forces with the predicted pressure, plus the difference to the true pressure acting at `taken`: the
        right-hand side of Newton's method for displacement and pressure after elimination of the pressure. With a
        tangent computed at x itself it equals `forces`.
        """
        return self._forces(self._cells.states(at.F[None], True, J[None], taken[None])[2], nodes)

    def add_tangent(self, at: Point, data: Array, projection: Projection, J: Array | None = None) -> None:
        """Add d2E/dx2 to the entries of the Pattern; if J (e, q) is given, with the pressure at that J."""
        assert self.slots is not None
        cells, dilatation = self._cells, np.empty(len(self.elements.conn))
        points = cells.points(at.F[None], double(), dilatation, None if J is None else J[None], int(projection))
        points.add(cells.B, ONLY_SCENE, None, cells.two_invariants, self.slots, data)

    def value(self, x: Array) -> float:
        return self.evaluate(x).energy

    def gradient(self, x: Array) -> Array:
        return self.forces(self.evaluate(x), len(x))

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        self.add_tangent(self.evaluate(x), data, projection)

    def energies(self, x: Array) -> Array:
        """Strain energy (e,) [N mm] of each element."""
        return self.evaluate(x).energies

    def cauchy(self, at: Point) -> tuple[Array, Array]:
        """Cauchy stress (e, q, 3, 3) [MPa] from the law, sigma = P F^T / J, and current volumes (e, q) [mm^3]."""
        volume = self.elements.weights * at.J
        return at.stress @ at.F.swapaxes(-1, -2) / volume[..., None, None], volume

    def mean_stress(self, at: Point) -> tuple[Array, Array]:
        """Element means (e, 3, 3) [MPa]: of the Cauchy stress over the current volume, of P over that at rest."""
        sigma, volume = self.cauchy(at)
        current = (volume[..., None, None] * sigma).sum(1) / volume.sum(1)[:, None, None]
        return current, at.stress.sum(1) / self.elements.weights.sum(1)[:, None, None]
