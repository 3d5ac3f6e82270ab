"""Contact and Coulomb friction of many scenes: forces, tangents and the merit function at the points of facets.

On a GPU by kernels, elsewhere by mechanics.coupled. Points are (s, f, q, 3), in the sensor's frame.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from torch import Tensor

from tacgen.geometry.pose import Pose
from tacgen.mechanics.barrier import PARABOLA_GAP_RATIO, Contact, Faces
from tacgen.mechanics.coupled import CoupledContact
from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine.records import ContactArrays, Forces

ABSENT_GAP_MM = 1e9  # gap of facets that do not exist [mm]
EMPTY_SLOTS = np.zeros((0, 0), np.int32)  # of a sparse matrix, which there is none


def barrier(d: Tensor, dhat: Tensor) -> Tensor:
    """Clamped log barrier [mm] at gaps d [mm]; see mechanics.barrier.barrier."""
    s = d / dhat
    t = s.clamp(PARABOLA_GAP_RATIO, 1.0)
    r, ln, below = 1 - t, torch.log(t), (s - PARABOLA_GAP_RATIO).clamp(max=0.0)
    first, second = 2 * r * ln - r**2 / t, -2 * ln + 4 * r / t + (r / t) ** 2
    return dhat * (first * below + second / 2 * below**2 - r**2 * ln)


def slip(x: Tensor, anchor: Tensor, normal: Tensor) -> Tensor:
    """Tangential displacement (..., 3) of points from their anchors [mm]."""
    u = x - anchor
    return u - (u * normal).sum(-1, keepdim=True) * normal


def smooth(u: Tensor, eps: Tensor) -> Tensor:
    """f0 at slip lengths u [mm]; see mechanics.coupled.smooth."""
    return torch.where(u < eps, u**2 * (eps - u / 3) / eps**2, u - eps / 3)


FORCE_FIELDS = [field.name for field in fields(Forces)]


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

    def gap(self, at: Tensor) -> Tensor:
        """Gap (s, ..., f, q) at points (s, ..., f, q, 3) of the facets."""
        d = self.shapes.values_at(self.local(at).flatten(1, -2)).view(at.shape[:-1])
        shape = (len(at), *(1,) * (at.dim() - 4), *self.areas.shape[1:])
        return torch.where(self.areas.view(shape) > 0, d + self.offset.view(-1, *(1,) * (d.dim() - 1)), ABSENT_GAP_MM)

    def gap_at_nodes(self, x: Tensor) -> Tensor:
        """Gap (s, f, q) at nodes x (s, n, 3)."""
        if devices.by_kernels(x):
            from tacgen.tensor_engine import gpu_contact

            return gpu_contact.gaps(self, x)
        return self.gap(self.points(x))

    def _numbers(self) -> tuple[Tensor, ...]:
        """Weights kappa A (s, f, q), and dhat, eps and friction (s, 1, 1)."""
        dhat, eps, friction = (part[:, None, None] for part in (self.dhat, self.eps, self.friction))
        return self.kappa[:, None, None] * self.areas, dhat, eps, friction

    def evaluate(self, x: Tensor) -> Forces:
        """Forces and tangents at nodes x (s, n, 3); where points overlap, without the rotation of the normal."""
        if devices.by_kernels(x):
            from tacgen.tensor_engine import gpu_contact

            return Forces(*gpu_contact.forces(self, x))
        found = [one.evaluate(at) for one, at in zip(self._alone(), x.double().numpy(), strict=True)]
        parts = {name: torch.from_numpy(np.stack([getattr(one, name) for one in found])) for name in FORCE_FIELDS}
        return Forces(**parts | {"gap": torch.where(self.areas > 0, parts["gap"], ABSENT_GAP_MM)})

    def _alone(self) -> Iterator[CoupledContact]:
        """The contact of each scene alone."""
        for k, shape in enumerate(self.shapes.each()):
            faces = Faces(self.conn[k].numpy(), self.N.numpy(), self.areas[k].numpy(), EMPTY_SLOTS)
            pose = Pose(self.rotation[k].numpy(), self.position[k].numpy())
            numbers = (self.dhat, self.kappa, self.offset, self.friction, self.eps)
            dhat, kappa, offset, friction, eps = (part[k].item() for part in numbers)
            contact = Contact(faces, shape, pose, dhat, kappa, offset)
            yield CoupledContact(contact, friction, self.anchor[k].numpy(), eps)

    def merits(self, x: Tensor, p: Tensor, fractions: Tensor, frozen: Forces) -> Tensor:
        """Energy (s, t) [N mm] of the barrier and of friction after fractions (s, t) of steps p (s, n, 3) from x, with
        the normal forces and normals of `frozen`."""
        if devices.by_kernels(x):
            from tacgen.tensor_engine import gpu_contact

            return gpu_contact.merits(self, x, p, fractions, frozen)
        at = self.points(x)[:, None] + fractions[:, :, None, None, None] * self.points(p)[:, None]
        normal, N, *numbers = (part[:, None] for part in (frozen.normal, frozen.N, *self._numbers()))
        weight, dhat, eps, friction = numbers
        t = slip(at, self.anchor[:, None], normal)
        rubbed = friction * N * smooth(torch.linalg.vector_norm(t, dim=-1), eps)
        return (weight * barrier(self.gap(at), dhat) + rubbed).sum((-2, -1))

    def max_step(self, gap: Tensor, p: Tensor, reach: Tensor) -> Tensor:
        """Largest parts (s,) of steps p (s, n, 3) without tunnelling; see mechanics.barrier.Contact.max_step."""
        way = torch.linalg.norm(self.points(p), dim=-1)
        allowed = gap.clamp(min=0.0) + reach[:, None, None] / 2
        return (allowed / way.clamp(min=1e-300)).flatten(1).amin(1).clamp(max=1.0)
