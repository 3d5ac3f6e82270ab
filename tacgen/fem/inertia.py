"""Mass and Rayleigh damping: one step of implicit Euler as an incremental potential.

    E(x) = |x - a - h v|^2_M / (2 h^2) + |x - a|^2_C / (2 h),    C = alpha M + beta K

with positions a and velocities v at the start of the step h [s]. The minimum of E plus an elastic energy W has
M (w - v)/h + C w + W'(x) = 0 at the velocity w = (x - a)/h. Units are mm, N, s, so that masses are in tonnes.

M is lumped in proportion to the diagonal of the consistent mass matrix (Hinton, Rock & Zienkiewicz 1976, "A note on
mass lumping and related processes"): positive at all nodes, also of quadratic tets, where row sums are not. K is the
stiffness at the start of the step, projected to be positive semi-definite (lagged as in Li et al. 2020, "Incremental
Potential Contact"): unlike the stiffness at rest it follows large rotations and strains, and E stays convex.
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import scipy.sparse as sp

from tacgen.fem.assembly import Pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.projection import Projection

Array = np.ndarray


def lumped(weights: Any, shape: Any) -> Any:
    """Volumes (..., e, a) of the corners of elements with weights (..., e, q) and shape functions (q, a)."""
    shares = weights @ shape**2
    return shares * (weights.sum(-1) / shares.sum(-1))[..., None]


@dataclass(frozen=True)
class Inertia:
    """E of a step, see the module; arrays of NumPy, or of PyTorch for many scenes.

    start (..., n, 3); coasting (..., n, 3): a + h v, positions without forces [mm]; inertial, drag (..., n, 1): M/h^2
    and alpha M/h [N/mm].
    """

    start: Any
    coasting: Any
    inertial: Any
    drag: Any

    @classmethod
    def of(cls, start: Any, velocity: Any, mass: Any, alpha: Any, h: Any, *viscous: Any) -> Self:
        """From velocities [mm/s] and masses (..., n, 1) [t]; viscous: what gives the forces of beta K."""
        inertial = mass / h**2
        return cls(start, start + h * velocity, inertial, alpha * h * inertial, *viscous)

    def viscous_force(self, moved: Any) -> Any:
        """beta K/h times a motion, at free nodes [N]."""
        raise NotImplementedError

    def value(self, x: Any) -> Any:
        late, moved = x - self.coasting, x - self.start
        energies = self.inertial * late**2 + self.drag * moved**2 + self.viscous_force(moved) * moved
        return energies.sum((-2, -1)) / 2

    def gradient(self, x: Any) -> Any:
        moved = x - self.start
        return self.inertial * (x - self.coasting) + self.drag * moved + self.viscous_force(moved)


@dataclass(frozen=True)
class BodyStep(Inertia):
    """A step of a Body. viscous: beta K/h as entries of the pattern; None: there is none.

    Fixed nodes do not move; the damping forces that they bear are left out of the gradient.
    """

    pattern: Pattern
    viscous: Array | None

    def viscous_force(self, moved: Array) -> Array:
        force = np.zeros_like(moved)
        if self.viscous is not None:
            p, u = self.pattern, moved.ravel()[self.pattern.free]
            upper = sp.csr_matrix((self.viscous, p.indices, p.indptr), shape=(p.size, p.size))
            force.ravel()[p.free] = upper @ u + upper.T @ u - self.viscous[p.indptr[:-1]] * u
        return force

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        p = self.pattern
        data[p.indptr[:-1]] += (self.inertial + self.drag)[p.free // 3, 0]  # the diagonal leads each row
        if self.viscous is not None:
            data += self.viscous


@dataclass(frozen=True)
class Body:
    """Mass (n,) [t] of the nodes, and the damping's alpha [1/s] and beta [s]."""

    pattern: Pattern
    elastic: tuple[Elastic, ...]
    mass: Array
    alpha: float
    beta: float

    @classmethod
    def of(cls, pattern: Pattern, elastic: tuple[Elastic, ...], density: float, alpha: float, beta: float) -> "Body":
        """The body of a mesh with one density [t/mm^3]."""
        mass = np.zeros(pattern.nodes)
        for part in elastic:
            np.add.at(mass, part.elements.conn, density * lumped(part.elements.weights, part.elements.shape))
        return cls(pattern, elastic, mass, alpha, beta)

    def step(self, start: Array, velocity: Array, h: float) -> BodyStep:
        """The potential of a step of h [s] from positions and velocities (n, 3) [mm], [mm/s]."""
        viscous = None
        if self.beta > 0:
            data = np.zeros(len(self.pattern.indices))
            for part in self.elastic:
                part.add_hessian(start, data, Projection.FULL)
            viscous = self.beta / h * data
        return BodyStep.of(start, velocity, self.mass[:, None], self.alpha, h, self.pattern, viscous)
