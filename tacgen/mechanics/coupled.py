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

from tacgen.base.compiled import njit
from tacgen.geometry.pose import Pose
from tacgen.mechanics.barrier import Contact, barrier

Array = np.ndarray


def smooth(u: Array, eps: float) -> tuple[Array, Array, Array]:
    """f0 [mm], f0'/|u| [1/mm] and (f0'' - f0'/|u|)/|u|^2 [1/mm^3] at slip lengths u >= 0 [mm]."""
    stick = u < eps
    v = np.maximum(u, 1e-12 * eps)
    value = np.where(stick, u**2 / eps - u**3 / (3 * eps**2), u - eps / 3)
    slope = np.where(stick, 2 / eps - u / eps**2, 1 / v)
    return value, slope, np.where(stick, -1 / (eps**2 * v), -1 / v**3)


def slip(x: Array, anchor: Array, normal: Array) -> Array:
    """Tangential displacement of points x (f, q, 3) from their anchors [mm]."""
    u = x - anchor
    return np.asarray(u - (u * normal).sum(-1, keepdims=True) * normal)


def onset(before: Array, ahead: Array, gap_before: Array, gap_ahead: Array) -> Array:
    """Positions (f, q, 3), in the indenter's frame, where points that come into contact during a load step first touch.

    `before` and `ahead` are the positions at the start of the step and, predicted, at its end; the gaps there [mm] are
    to the surface of contact. A point touches where the straight line between them meets that surface.
    """
    closing = gap_before - gap_ahead
    part = np.where(gap_ahead < 0, np.clip(gap_before / np.maximum(closing, 1e-12), 0.0, 1.0), 1.0)
    return np.asarray(before + part[..., None] * (ahead - before))


def dragged(anchor: Array, x: Array, normal: Array, normal_force: Array, eps: float, pose: Pose) -> Array:
    """Anchors after a load step, in the indenter's frame: moved by the slip beyond eps; a free point is its own anchor.

    anchor and x (f, q, 3) are in the sensor frame.
    """
    u = slip(x, anchor, normal)
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    pulled = x - u * np.minimum(1.0, eps / np.maximum(length, 1e-300))
    return pose.local(np.where(normal_force[..., None] > 0, pulled, x))


@njit(cache=True)
def _point_forces(
    db: Array, ddb: Array, g: Array, H: Array, u: Array, weight: Array, mu: float, eps: float,
    N: Array, n: Array, f: Array, D: Array, S: Array,
) -> None:  # fmt: skip
    """N (p,), n (p, 3), force on the gel f (p, 3), -df/dx as D (p, 3, 3), and S (p, 3, 3), the merit function's Hessian
    without the indenter's curvature H.

    db, ddb (p,): the barrier's derivatives; g (p, 3), H (p, 3, 3): gradient and Hessian of the distance; u (p, 3): from
    the anchor; weight (p,): kappa times area.
    """
    P, t, Hn, Ht = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    for p in range(len(db)):
        size = max(np.sqrt(g[p, 0] ** 2 + g[p, 1] ** 2 + g[p, 2] ** 2), 1e-12)
        for i in range(3):
            n[p, i] = g[p, i] / size
            f[p, i] = 0.0
            for j in range(3):
                D[p, i, j] = S[p, i, j] = 0.0
        N[p] = -weight[p] * db[p] * size
        if db[p] == 0.0:
            continue
        for i in range(3):
            f[p, i] = N[p] * n[p, i]
            for j in range(3):
                S[p, i, j] = weight[p] * ddb[p] * g[p, i] * g[p, j]
                D[p, i, j] = S[p, i, j] + weight[p] * db[p] * H[p, i, j]
        if mu == 0.0:
            continue
        un = u[p, 0] * n[p, 0] + u[p, 1] * n[p, 1] + u[p, 2] * n[p, 2]
        length = 0.0
        for i in range(3):
            t[i] = u[p, i] - un * n[p, i]
            length += t[i] ** 2
        length = np.sqrt(length)
        if length < eps:
            slope, bend = 2 / eps - length / eps**2, -1 / (eps**2 * max(length, 1e-12 * eps))
        else:
            slope, bend = 1 / length, -1 / length**3
        for j in range(3):  # the normal depends on the position on the indenter: dn/dx = (1 - n n^T) H / |g|
            Hn[j] = n[p, 0] * H[p, 0, j] + n[p, 1] * H[p, 1, j] + n[p, 2] * H[p, 2, j]
            Ht[j] = (t[0] * H[p, 0, j] + t[1] * H[p, 1, j] + t[2] * H[p, 2, j]) / size
        for i in range(3):
            for j in range(3):
                P[i, j] = (1.0 if i == j else 0.0) - n[p, i] * n[p, j]
                S[p, i, j] += mu * N[p] * (slope * P[i, j] + bend * t[i] * t[j])
                P[i, j] -= un * (H[p, i, j] - n[p, i] * Hn[j]) / size + n[p, i] * Ht[j]  # d u_t/dx
        for i in range(3):
            f[p, i] -= mu * N[p] * slope * t[i]
            for j in range(3):
                v = slope * P[i, j]
                for k in range(3):
                    v += bend * t[i] * t[k] * P[k, j]
                dN = -weight[p] * (ddb[p] * size * g[p, j] + db[p] * Hn[j])
                D[p, i, j] += mu * (N[p] * v + slope * t[i] * dN)


@dataclass(frozen=True)
class ContactForces:
    """Contact at given positions: gap (f, q) [mm], at and normal (f, q, 3), normal force N (f, q) [N], force on the
    gel (f, q, 3) [N], its negative derivative `tangent` (f, q, 3, 3) [N/mm], and `definite`: the Hessian of the merit
    function without the indenter's curvature, symmetric and positive semidefinite."""

    gap: Array
    at: Array
    normal: Array
    N: Array
    force: Array
    tangent: Array
    definite: Array

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

    def evaluate(self, x: Array) -> ContactForces:
        """Forces and tangents at nodes x (n, 3).

        At points that overlap, which no solution has, the tangents omit the rotation of the normal.
        """
        c = self.contact
        at = c.faces.at(x)
        shape = at.shape[:2]
        d, g, H = c.gaps_at(at)
        _, db, ddb = barrier(d, c.dhat)
        H[d < 0] = 0.0  # in an overlap at the start of Newton, N is far too large
        m = d.size
        N, n, f, D, S = np.empty(m), np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3, 3)), np.empty((m, 3, 3))
        _point_forces(
            db.ravel(), ddb.ravel(), g.reshape(m, 3), H.reshape(m, 3, 3), (at - self.anchor).reshape(m, 3),
            (c.kappa * c.faces.areas).ravel(), self.friction, self.eps, N, n, f, D, S,
        )  # fmt: skip
        wide = (*shape, 3)
        return ContactForces(
            d, at, n.reshape(wide), N.reshape(shape), f.reshape(wide), D.reshape(*wide, 3), S.reshape(*wide, 3)
        )

    def merit(self, x: Array, frozen: ContactForces) -> float:
        """Energy [N mm] of the barrier and of friction with the normal forces and normals of `frozen`."""
        c, at = self.contact, self.contact.faces.at(x)
        energy = float((c.kappa * c.faces.areas * barrier(c.gap(at), c.dhat)[0]).sum())
        if self.friction == 0:
            return energy
        f0 = smooth(np.linalg.norm(slip(at, self.anchor, frozen.normal), axis=-1), self.eps)[0]
        return energy + self.friction * float((frozen.N * f0).sum())
