"""Contact and Coulomb friction of many scenes: forces, tangents and the merit function at the points of facets.

Points are (s, f, q, 3), in the sensor's frame.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from tacgen.physics import contact as kernels
from tacgen.physics.runtime import launch
from tacgen.tensor_engine.records import ContactArrays, Forces


def slip(x: Tensor, anchor: Tensor, normal: Tensor) -> Tensor:
    """Tangential displacement (..., 3) of points from their anchors [mm]."""
    u = x - anchor
    return u - (u * normal).sum(-1, keepdim=True) * normal


@dataclass(frozen=True)
class Contacts(ContactArrays):
    """Barrier and friction between facets and the indenter of each scene."""

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

    def gap(self, x: Tensor) -> Tensor:
        """Gap (s, f, q) at nodes x (s, n, 3)."""
        d = torch.empty_like(self.areas)
        launch(kernels.gaps, d.shape, x.contiguous(), *self._arrays, None, d, None, None)
        return d + self.offset[:, None, None]

    @property
    def _arrays(self) -> tuple[Tensor, ...]:
        """Facets, their shape functions and areas, the poses and the indenters, as kernels take them."""
        parts = self.areas.contiguous(), self.rotation.contiguous(), self.position.contiguous()
        return self.conn, self.N, *parts, *self.shapes.record

    @property
    def _numbers(self) -> tuple[Tensor, ...]:
        """Numbers of the scenes and anchors, as kernels take them."""
        return self.kappa, self.dhat, self.offset, self.friction, self.eps, self.anchor.contiguous()

    def evaluate(self, x: Tensor) -> Forces:
        """Forces and tangents at nodes x (s, n, 3); where points overlap, without the rotation of the normal."""
        (s, f, q), arrays = self.areas.shape, self._arrays
        at, n, H, d = x.new_empty(s, f, q, 3), x.new_empty(s, f, q, 3), x.new_empty(s, f, q, 3, 3), x.new_empty(s, f, q)
        launch(kernels.gaps, d.shape, x.contiguous(), *arrays, at, d, n, H)
        gap, normal, N, force = torch.empty_like(d), torch.empty_like(n), torch.empty_like(d), torch.empty_like(n)
        tangent, definite = torch.empty_like(H), torch.empty_like(H)
        found = gap, normal, N, force, tangent, definite
        launch(kernels.forces, d.shape, at, d, n, H, arrays[2], *self._numbers, *found)
        return Forces(gap, at, normal, N, force, tangent, definite)

    def merits(self, x: Tensor, p: Tensor, fractions: Tensor, frozen: Forces) -> Tensor:
        """Energy (s, t) [N mm] of the barrier and of friction after fractions (s, t) of steps p (s, n, 3) from x, with
        the normal forces and normals of `frozen`."""
        energies = x.new_empty(*fractions.shape, self.areas[0].numel())
        steps = x.contiguous(), p.contiguous(), fractions.contiguous()
        kept = frozen.normal.contiguous(), frozen.N.contiguous()
        launch(kernels.merits, energies.shape, *steps, *self._arrays, *self._numbers, *kept, energies)
        return energies.sum(-1)

    def blocked(
        self, before: Tensor, x: Tensor, rotation: Tensor, position: Tensor, gap: Tensor, reach: Tensor
    ) -> Tensor:
        """Whether a point passes through the indenter (s,) on the way from nodes `before` (s, n, 3), when its pose was
        another and the gap (s, f, q), to x; see mechanics.tunnelling.blocked."""
        arrays, wide = self._arrays, (*self.areas.shape, 3)
        start, step, length = x.new_empty(wide), x.new_empty(wide), x.new_empty(wide[:-1])
        way = before.contiguous(), x.contiguous(), *arrays[:3]
        launch(kernels.ways, wide[:-1], *way, rotation, position, *arrays[3:5], gap.contiguous(), start, step, length)
        parts = torch.ceil(4 * length.flatten(1).amax(1) / reach).clamp(min=2.0)
        through = torch.empty(wide[:-1], dtype=torch.bool, device=x.device)
        launch(kernels.blocked, wide[:-1], start, step, length, parts, reach, self.offset, *self.shapes.record, through)
        return through.flatten(1).any(1)

    def max_step(self, gap: Tensor, p: Tensor, reach: Tensor) -> Tensor:
        """Largest parts (s,) of steps p (s, n, 3) without tunnelling; see mechanics.barrier.Contact.max_step."""
        way = torch.linalg.norm(self.points(p), dim=-1)
        allowed = gap.clamp(min=0.0) + reach[:, None, None] / 2
        return (allowed / way.clamp(min=1e-300)).flatten(1).amin(1).clamp(max=1.0)
