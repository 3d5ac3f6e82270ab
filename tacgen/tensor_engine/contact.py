"""Contact and Coulomb friction of many scenes: forces, tangents and the merit function at the points of facets.

Points are (s, f, q, 3), in the sensor's frame.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from tacgen.physics import assembly
from tacgen.physics import contact as kernels
from tacgen.physics.runtime import launch
from tacgen.tensor_engine.shapes import Shapes


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

    @property
    def total(self) -> Tensor:
        """Sum of the normal forces (s,) [N]."""
        return self.N.sum((1, 2))

    @property
    def mean_gap(self) -> Tensor:
        """Force-weighted mean gap (s,) [mm]; nan without contact."""
        return (self.N * self.gap).sum((1, 2)) / self.total


@dataclass(frozen=True)
class Contacts:
    """Barrier and friction between facets and the indenter of each scene.

    conn (s, f, 4) node numbers; N (q, 4); areas (s, f, q), 0 where a facet does not exist; rotation
    (s, 3, 3) and position (s, 3) of the indenter; (s,): dhat and offset [mm], kappa [MPa], friction, slip length eps
    [mm]; anchor (s, f, q, 3) in the sensor's frame; of each node `ends` (s, n, 4): the facet of which it is a certain
    corner, -1 if none, where forces are summed at nodes.
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
    ends: Tensor | None = None

    def shrunk(self, offset: Tensor) -> "Contacts":
        """With indenters shrunk by other offsets (s,) [mm]."""
        return replace(self, offset=offset)

    def points(self, x: Tensor) -> Tensor:
        """The points (s, f, q, 3) of nodes x (s, n, 3)."""
        at = x.new_empty(*self.conn.shape[:2], len(self.N), 3)
        launch(assembly.at_points, at.shape[:3], x.contiguous(), self.conn, self.N, at)
        return at

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
