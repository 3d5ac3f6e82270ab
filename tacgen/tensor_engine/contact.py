"""Contact and Coulomb friction of many scenes: forces, tangents and the merit function at the points of facets.

Formulas as in mechanics.barrier and mechanics.coupled. Points are (s, f, q, 3), in the sensor's frame.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from tacgen.mechanics.barrier import SOFT
from tacgen.tensor_engine.fused import fused, outer, product, times
from tacgen.tensor_engine.indices import listed
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
        same = {"shapes": self.shapes.rows(listed(which)), "N": self.N}
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
        shape = at.shape
        d, n, H = self.shapes.distance(self.local(at).flatten(1, 2))
        d, n, H = d.view(shape[:3]), n.view(shape), H.view(*shape, 3)
        return _in_sensor(d, n, H, self.rotation[:, None, None], self.offset[:, None, None], self.areas)

    def _numbers(self) -> tuple[Tensor, ...]:
        """Weights kappa A (s, f, q), and dhat, eps and friction (s, 1, 1)."""
        dhat, eps, friction = (part[:, None, None] for part in (self.dhat, self.eps, self.friction))
        return self.kappa[:, None, None] * self.areas, dhat, eps, friction

    def evaluate(self, x: Tensor) -> Forces:
        """Forces and tangents at nodes x (s, n, 3); where points overlap, without the rotation of the normal."""
        at = self.points(x)
        gaps = self.gaps(at)
        return Forces(gaps[0], at, *_forces(*gaps, at - self.anchor, *self._numbers()))

    def merit(self, x: Tensor, frozen: Forces) -> Tensor:
        """Energy (s,) [N mm] of the barrier and of friction with the normal forces and normals of `frozen`."""
        at = self.points(x)
        return _merit(self.gaps(at)[0], at - self.anchor, frozen.normal, frozen.N, *self._numbers())

    def merit_at(self, here: Forces, frozen: Forces) -> Tensor:
        """`merit` (s,) [N mm] at positions whose forces are known."""
        return _merit(here.gap, here.at - self.anchor, frozen.normal, frozen.N, *self._numbers())

    def max_step(self, gap: Tensor, p: Tensor, reach: Tensor) -> Tensor:
        """Largest parts (s,) of steps p (s, n, 3) without tunnelling; see mechanics.barrier.Contact.max_step."""
        way = torch.linalg.norm(self.points(p), dim=-1)
        allowed = gap.clamp(min=0.0) + reach[:, None, None] / 2
        return (allowed / way.clamp(min=1e-300)).flatten(1).amin(1).clamp(max=1.0)


@fused
def _in_sensor(
    d: Tensor, n: Tensor, H: Tensor, R: Tensor, offset: Tensor, areas: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Gaps, gradients and Hessians in the sensor's frame, of distances in the indenter's."""
    d = torch.where(areas > 0, d + offset, NOWHERE)
    return d, times(R, n), product(product(R, H), R.mT)


@fused
def _forces(
    d: Tensor, g: Tensor, H: Tensor, u: Tensor, weight: Tensor, dhat: Tensor, eps: Tensor, mu: Tensor
) -> tuple[Tensor, ...]:
    """normal, N, force, tangent and definite of Forces, from gaps, their gradients and Hessians, the way u from the
    anchors, weights kappa A, and numbers of the contact; see mechanics.coupled."""
    _, db, ddb = barrier(d, dhat)
    touching = db != 0
    H = torch.where((d < 0)[..., None, None], 0.0, H)
    size = torch.linalg.vector_norm(g, dim=-1).clamp(min=1e-12)
    n, N = g / size[..., None], -weight * db * size
    normal = (weight * ddb)[..., None, None] * outer(g, g)
    un = (u * n).sum(-1)[..., None]
    t = u - un * n
    _, slope, bend = smooth(torch.linalg.vector_norm(t, dim=-1), eps)
    slope, bend, force = slope[..., None, None], bend[..., None, None], (mu * N)[..., None, None]
    across = torch.eye(3, dtype=g.dtype, device=g.device) - outer(n, n)
    definite = normal + force * (slope * across + bend * outer(t, t))
    Hn, Ht = times(H, n), times(H, t) / size[..., None]
    turned = un[..., None] * (H - outer(n, Hn)) / size[..., None, None] + outer(n, Ht)
    P = across - turned
    v = slope * P + bend * outer(t, times(P.mT, t))
    dN = -weight[..., None] * ((ddb * size)[..., None] * g + db[..., None] * Hn)
    tangent = normal + (weight * db)[..., None, None] * H + force * v + mu[..., None, None] * slope * outer(t, dN)
    f = N[..., None] * n - (force * slope)[..., 0] * t
    touched = touching[..., None, None]
    return n, N, f, torch.where(touched, tangent, 0.0), torch.where(touched, definite, 0.0)


@fused
def _merit(
    d: Tensor, u: Tensor, normal: Tensor, N: Tensor, weight: Tensor, dhat: Tensor, eps: Tensor, mu: Tensor
) -> Tensor:
    """Energy of the barrier and of friction with given normals and normal forces, summed over the points (s,)."""
    t = u - (u * normal).sum(-1, keepdim=True) * normal
    friction = mu * N * smooth(torch.linalg.vector_norm(t, dim=-1), eps)[0]
    return (weight * barrier(d, dhat)[0] + friction).sum((1, 2))
