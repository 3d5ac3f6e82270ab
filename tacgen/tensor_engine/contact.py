"""Contact and Coulomb friction of many scenes: forces, tangents and the merit function at the points of facets.

Formulas as in mechanics.barrier and mechanics.coupled. Points are (s, f, q, 3), in the sensor's frame.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from tacgen.mechanics.barrier import SOFT
from tacgen.tensor_engine.shapes import Shapes

NOWHERE = 1e9  # gap of facets that do not exist [mm]


def barrier(d: Tensor, dhat: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Clamped log barrier b [mm] with db/dd and d2b/dd2 [1/mm] at gaps d [mm]; see mechanics.barrier.barrier."""
    s = d / dhat
    t = s.clamp(SOFT, 1.0)
    ln, r = torch.log(t), 1 - t
    b, db, ddb = -(r**2) * ln, 2 * r * ln - r**2 / t, -2 * ln + 4 * r / t + (r / t) ** 2
    below = (s - SOFT).clamp(max=0.0)
    return dhat * (b + db * below + ddb / 2 * below**2), db + ddb * below, ddb / dhat


def slip(x: Tensor, anchor: Tensor, normal: Tensor) -> Tensor:
    """Tangential displacement (..., 3) of points from their anchors [mm]."""
    u = x - anchor
    return u - (u * normal).sum(-1, keepdim=True) * normal


def smooth(u: Tensor, eps: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """f0, f0'/|u| and (f0'' - f0'/|u|)/|u|^2 at slip lengths u; see mechanics.coupled.smooth."""
    stick, v = u < eps, torch.maximum(u, 1e-12 * eps)
    value = torch.where(stick, u**2 / eps - u**3 / (3 * eps**2), u - eps / 3)
    slope = torch.where(stick, 2 / eps - u / eps**2, 1 / v)
    return value, slope, torch.where(stick, -1 / (eps**2 * v), -1 / v**3)


@dataclass(frozen=True)
class Forces:
    """Contact at given positions: gap (s, f, q) [mm], `at` and normal (s, f, q, 3), normal force N (s, f, q) [N], force
    on the gel (s, f, q, 3) [N], its negative derivative `tangent` (s, f, q, 3, 3), and `definite`; see
    mechanics.coupled.ContactForces."""

    gap: Tensor
    at: Tensor
    normal: Tensor
    N: Tensor
    force: Tensor
    tangent: Tensor
    definite: Tensor

    def rows(self, which: Tensor) -> "Forces":
        """Only some scenes."""
        return Forces(*(part[which] for part in vars(self).values()))

    @property
    def total(self) -> Tensor:
        """Sum of the normal forces (s,) [N]."""
        return self.N.sum((1, 2))

    @property
    def mean_gap(self) -> Tensor:
        """Force-weighted mean gap (s,) [mm]; 0 without contact."""
        return (self.N * self.gap).sum((1, 2)) / self.total.clamp(min=1e-300)


@dataclass(frozen=True)
class Contacts:
    """Barrier and friction between facets and the indenter of each scene.

    conn (s, f, 4) node numbers; N (q, 4); areas (s, f, q), 0 where a facet does not exist; rotation
    (s, 3, 3) and position (s, 3) of the indenter; (s,): dhat and offset [mm], kappa [MPa], friction, slip length eps
    [mm]; anchor (s, f, q, 3) in the sensor's frame.
    """

    shapes: Shapes
    conn: Tensor
    N: Tensor
    areas: Tensor
    rotation: Tensor
    position: Tensor
    dhat: Tensor
    kappa: Tensor
    offset: Tensor
    friction: Tensor
    eps: Tensor
    anchor: Tensor

    def rows(self, which: Tensor) -> "Contacts":
        """Only some scenes (r,)."""
        same = {"shapes": self.shapes.rows(which.tolist()), "N": self.N}
        parts = {k: v[which] for k, v in vars(self).items() if k not in same}
        return replace(self, **same, **parts)

    def shrunk(self, offset: Tensor) -> "Contacts":
        """With indenters shrunk by other offsets (s,) [mm]."""
        return replace(self, offset=offset)

    def only(self, conn: Tensor, areas: Tensor, anchor: Tensor) -> "Contacts":
        """With other facets."""
        return replace(self, conn=conn, areas=areas, anchor=anchor)

    def points(self, x: Tensor) -> Tensor:
        """The points (s, f, q, 3) of nodes x (s, n, 3)."""
        rows = torch.arange(len(x), device=x.device)[:, None, None]
        return self.N @ x[rows, self.conn]

    def local(self, at: Tensor) -> Tensor:
        """Points (s, ..., 3) in the indenters' frames."""
        flat = at.flatten(1, -2)
        return ((flat - self.position[:, None]) @ self.rotation).view(at.shape)

    def world(self, at: Tensor) -> Tensor:
        """Points (s, ..., 3) of the indenters' frames in the sensor's."""
        flat = at.flatten(1, -2)
        return (flat @ self.rotation.mT + self.position[:, None]).view(at.shape)

    def gaps(self, at: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Gap (s, f, q), gradient (s, f, q, 3) and Hessian (s, f, q, 3, 3) at points, in the sensor's frame."""
        shape, R = at.shape, self.rotation[:, None]
        d, n, H = self.shapes.distance(self.local(at).flatten(1, 2))
        d = d.view(shape[:3]) + self.offset[:, None, None]
        d = torch.where(self.areas > 0, d, NOWHERE)
        return d, (n @ self.rotation.mT).view(shape), (R @ H @ R.mT).view(*shape, 3)

    def evaluate(self, x: Tensor) -> Forces:
        """Forces and tangents at nodes x (s, n, 3); where points overlap, without the rotation of the normal."""
        at = self.points(x)
        d, g, H = self.gaps(at)
        _, db, ddb = barrier(d, self.dhat[:, None, None])
        H = torch.where((d < 0)[..., None, None], 0.0, H)
        weight = self.kappa[:, None, None] * self.areas
        size = torch.linalg.norm(g, dim=-1).clamp(min=1e-12)
        n, N = g / size[..., None], -weight * db * size
        touching = db != 0
        ddb = torch.where(touching, ddb, 0.0)
        S = (weight * ddb)[..., None, None] * _outer(g, g)
        D = S + (weight * db)[..., None, None] * H
        f = N[..., None] * n
        if bool((self.friction > 0).any()):
            mu = (self.friction[:, None, None] * torch.ones_like(N))[..., None, None]
            u = at - self.anchor
            un = (u * n).sum(-1, keepdim=True)
            t = u - un * n
            _, slope, bend = smooth(torch.linalg.norm(t, dim=-1), self.eps[:, None, None])
            slope, bend, force = slope[..., None, None], bend[..., None, None], N[..., None, None]
            across = torch.eye(3, dtype=x.dtype, device=x.device) - _outer(n, n)
            S = S + mu * force * (slope * across + bend * _outer(t, t))
            Hn, Ht = (n[..., None, :] @ H).squeeze(-2), (t[..., None, :] @ H).squeeze(-2) / size[..., None]
            turned = un[..., None] * (H - _outer(n, Hn)) / size[..., None, None] + _outer(n, Ht)
            P = across - turned
            v = slope * P + bend * _outer(t, (t[..., None, :] @ P).squeeze(-2))
            dN = -weight[..., None] * ((ddb * size)[..., None] * g + db[..., None] * Hn)
            D = D + mu * (force * v + slope * _outer(t, dN))
            f = f - mu[..., 0] * N[..., None] * slope[..., 0] * t
            S, D = (torch.where(touching[..., None, None], part, 0.0) for part in (S, D))
        return Forces(d, at, n, N, f, D, S)

    def merit(self, x: Tensor, frozen: Forces) -> Tensor:
        """Energy (s,) [N mm] of the barrier and of friction with the normal forces and normals of `frozen`."""
        at, dhat = self.points(x), self.dhat[:, None, None]
        energy = (self.kappa[:, None, None] * self.areas * barrier(self.gaps(at)[0], dhat)[0]).sum((1, 2))
        length = torch.linalg.norm(slip(at, self.anchor, frozen.normal), dim=-1)
        return energy + self.friction * (frozen.N * smooth(length, self.eps[:, None, None])[0]).sum((1, 2))

    def max_step(self, gap: Tensor, p: Tensor, reach: Tensor) -> Tensor:
        """Largest parts (s,) of steps p (s, n, 3) without tunnelling; see mechanics.barrier.Contact.max_step."""
        way = torch.linalg.norm(self.points(p), dim=-1)
        allowed = gap.clamp(min=0.0) + reach[:, None, None] / 2
        return (allowed / way.clamp(min=1e-300)).flatten(1).amin(1).clamp(max=1.0)


def _outer(a: Tensor, b: Tensor) -> Tensor:
    return a[..., :, None] * b[..., None, :]
