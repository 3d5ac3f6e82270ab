"""Fully coupled contact and Coulomb friction: the normal force in friction is the barrier force at the same positions.

At each quadrature point, with the gap d, the unit normal n and the slip u_t from an anchor on the indenter,

    N = -kappa A b'(d),    f = N n - mu N f0'(|u_t|) u_t/|u_t|,

so that |f_t| <= mu N holds at every point of an equilibrium. The tangent is consistent and not symmetric: N
depends on d, and u_t on the normal. Alart & Curnier (1991), "A mixed formulation for frictional contact problems prone
to Newton like solution methods"; Wriggers (2006), "Computational contact mechanics", ch. 5. Friction has no energy, so
line searches use `merit`, the energy with the normal forces frozen; where they were taken, its gradient is the true
force. f0' rises smoothly from 0 to 1 over the slip `eps` (Li et al. 2020, Eq. 15).

Each quadrature point keeps an anchor on the indenter that moves only when it slips (return mapping), so that a sticking
point does not creep from frame to frame.
"""

from dataclasses import dataclass, replace

import numpy as np

from tacgen.mechanics.barrier import Contact, Gaps
from tacgen.physics import contact as kernels
from tacgen.physics.runtime import call

Array = np.ndarray


def smooth(u: Array, eps: float) -> tuple[Array, Array, Array]:
    """f0 [mm], f0'/|u| [1/mm] and (f0'' - f0'/|u|)/|u|^2 [1/mm^3] at slip lengths u >= 0 [mm]."""
    out = np.empty((u.size, 3))
    call(kernels.slips, (u.size,), np.ascontiguousarray(u, float).ravel(), float(eps), out)
    value, slope, bend = out.T
    return value.reshape(u.shape), slope.reshape(u.shape), bend.reshape(u.shape)


@dataclass(frozen=True)
class ContactForces:
    """Contact at given positions: gap (f, q) [mm], at and normal (f, q, 3), normal force N (f, q) [N], force on the
    gel (f, q, 3) [N], its negative derivative `tangent` (f, q, 3, 3) [N/mm], and `definite`: the Hessian of the merit
    function without the indenter's curvature, symmetric and positive semidefinite; and the gaps that they are of."""

    gap: Array
    at: Array
    normal: Array
    N: Array
    force: Array
    tangent: Array
    definite: Array
    seen: Gaps

    @property
    def mean_gap(self) -> float:
        """Force-weighted mean gap [mm]; nan without contact."""
        total = float(self.N.sum())
        return float((self.N * self.gap).sum()) / total if total > 0 else float("nan")


@dataclass(frozen=True)
class CoupledContact:
    """Barrier and friction between facets and an indenter; `anchor` (f, q, 3) in the sensor frame [mm], `eps`: slip
    over which friction builds up [mm]."""

    contact: Contact
    friction: float
    anchor: Array
    eps: float

    def shrunk(self, offset: float) -> "CoupledContact":
        """With the indenter shrunk by another offset [mm]."""
        return replace(self, contact=replace(self.contact, offset=offset))

    def stiffened(self, times: float) -> "CoupledContact":
        """With the barrier stiffness multiplied by `times`."""
        return replace(self, contact=replace(self.contact, kappa=times * self.contact.kappa))

    def evaluate(self, x: Array, seen: Gaps | None = None) -> ContactForces:
        """Forces and tangents at nodes x (n, 3), where the gaps are `seen`, if they are known.

        At points that overlap, which no solution has, the tangents omit the rotation of the normal.
        """
        at, d, n, H = seen = self.contact.gaps(x) if seen is None else seen
        wide = (1, *at.shape)
        gap, normal, N, force = np.empty(wide[:-1]), np.empty(wide), np.empty(wide[:-1]), np.empty(wide)
        tangent, definite = np.empty((*wide, 3)), np.empty((*wide, 3))
        call(
            kernels.forces, gap.shape, at[None], d[None], n[None], H[None], self.contact.faces.areas[None],
            *self.contact.numbers, *self._numbers, self.anchor[None], gap, normal, N, force, tangent, definite,
        )  # fmt: skip
        return ContactForces(gap[0], at, normal[0], N[0], force[0], tangent[0], definite[0], seen)

    @property
    def _numbers(self) -> tuple[Array, Array]:
        """Friction and eps (1,), as kernels take them."""
        return np.array([self.friction], float), np.array([self.eps], float)

    def merit(self, x: Array, frozen: ContactForces) -> float:
        """Energy [N mm] of the barrier and of friction with the normal forces and normals of `frozen`."""
        energies = np.empty((1, 1, frozen.N.size))
        call(
            kernels.merits, energies.shape, x[None], None, None, *self.contact.arrays,
            *self.contact.numbers, *self._numbers, self.anchor[None], frozen.normal[None], frozen.N[None], energies,
        )  # fmt: skip
        return float(energies.sum())
