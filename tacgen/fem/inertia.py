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

import numpy as np
import scipy.sparse as sp

from tacgen.fem.assembly import Pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.potential import Projection, Total

Array = np.ndarray


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
            e = part.elements
            shares = np.einsum("eq,qa->ea", e.weights, e.shape**2)
            shares *= (e.weights.sum(1) / shares.sum(1))[:, None]
            np.add.at(mass, e.conn, density * shares)
        return cls(pattern, elastic, mass, alpha, beta)

    def step(self, start: Array, velocity: Array, h: float) -> "Inertia":
        """The potential of a step of h [s] from positions and velocities (n, 3) [mm], [mm/s]."""
        viscous = None
        if self.beta > 0:
            data = np.zeros(len(self.pattern.indices))
            Total(self.elastic).add_hessian(start, data, Projection.FULL)
            viscous = self.beta / h * data
        inertial = (self.mass / h**2)[:, None]
        return Inertia(self.pattern, start, start + h * velocity, inertial, self.alpha * h * inertial, viscous)


@dataclass(frozen=True)
class Inertia:
    """See the module. inertial, drag (n, 1): M/h^2 and alpha M/h [N/mm]; viscous: beta K/h as entries of the pattern.

    Fixed nodes do not move; the damping forces that they bear are left out of the gradient.
    """

    pattern: Pattern
    start: Array
    coasting: Array  # a + h v: positions without forces (n, 3) [mm]
    inertial: Array
    drag: Array
    viscous: Array | None

    def _parts(self, x: Array) -> tuple[Array, Array, Array]:
        """x - a - h v, x - a, and the viscous force, each (n, 3)."""
        moved, force = x - self.start, np.zeros_like(x)
        if self.viscous is not None:
            p, u = self.pattern, moved.ravel()[self.pattern.free]
            upper = sp.csr_matrix((self.viscous, p.indices, p.indptr), shape=(p.size, p.size))
            force.ravel()[p.free] = upper @ u + upper.T @ u - self.viscous[p.indptr[:-1]] * u
        return x - self.coasting, moved, force

    def value(self, x: Array) -> float:
        late, moved, force = self._parts(x)
        return float((self.inertial * late**2 + self.drag * moved**2 + force * moved).sum() / 2)

    def gradient(self, x: Array) -> Array:
        late, moved, force = self._parts(x)
        return np.asarray(self.inertial * late + self.drag * moved + force)

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        p = self.pattern
        data[p.indptr[:-1]] += (self.inertial + self.drag)[p.free // 3, 0]  # the diagonal leads each row
        if self.viscous is not None:
            data += self.viscous
