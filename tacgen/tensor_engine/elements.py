"""Trilinear hexes of many scenes that share their numbering: energy, forces, tangents and the mixed pressure."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from tacgen.fem.elements import integration
from tacgen.fem.projection import Projection
from tacgen.physics import tangents
from tacgen.physics.cells import Cells, Numbering, Points, around
from tacgen.physics.laws import two_invariants
from tacgen.physics.runtime import launch
from tacgen.tensor_engine.indices import constant

Array = np.ndarray
# N (q, 8) and dN (q, 8, 3) at the integration points
HEX_SHAPE_VALUES, HEX_SHAPE_GRADIENTS, _ = integration(8)


def cofactor(F: Tensor) -> Tensor:
    """J F^-T of F (..., 3, 3)."""
    return torch.linalg.cross(F.roll(-1, -2), F.roll(-2, -2))


def determinant(F: Tensor) -> Tensor:
    """J (...) of F (..., 3, 3)."""
    return (F[..., 0, :] * torch.linalg.cross(F[..., 1, :], F[..., 2, :])).sum(-1)


def ends_of(conn: Tensor, nodes: int) -> Tensor:
    """For each node (..., n, 4) the facet in conn (..., f, 4) of which it is a certain corner, -1 if none."""
    out = conn.new_full((*conn.shape[:-2], nodes, 4), -1, dtype=torch.int32)
    number = torch.arange(conn.shape[-2], dtype=torch.int32, device=conn.device)
    return out.scatter_(-2, conn.long(), number[:, None].expand(conn.shape))


@dataclass(frozen=True)
class Topology(Numbering):
    """The numbering that the scenes of a batch share: conn (e, 8), as `cells` but int64; and facets (f, 4) of the face,
    also as int32 `faces`, with `ends` (n, 4): the facet of which a node is a certain corner, -1 if none."""

    conn: Tensor
    facets: Tensor
    faces: Tensor
    ends: Tensor

    @classmethod
    def shared(cls, cells: Array, facets: Array, nodes: int, device: str = "cpu") -> "Topology":
        first, pairs = (torch.tensor(part, device=device) for part in around(cells, nodes))
        conn, face = (torch.tensor(part, dtype=torch.long, device=device) for part in (cells, facets))
        return cls(conn.int(), first, pairs, nodes, conn, face, face.int(), ends_of(face, nodes))


@dataclass(frozen=True)
class Hexes(Cells):
    """Trilinear cells of each scene."""

    @classmethod
    def on(cls, topology: Topology, X: Tensor, exists: Tensor, laws: Tensor) -> "Hexes":
        """With nodes X (s, n, 3) at rest; exists (s, e) bool."""
        dX = jacobians(X[:, topology.conn], HEX_SHAPE_GRADIENTS)
        volume, local = determinant(dX), constant(HEX_SHAPE_GRADIENTS, X)
        B = torch.einsum("qaj,...qIj->...qaI", local, cofactor(dX) / volume[..., None, None])
        weights, every = volume * exists[..., None], torch.arange(len(X), dtype=torch.int32, device=X.device)
        return cls(topology, B.contiguous(), weights, laws.contiguous(), two_invariants(laws), every)

    def energy(self, x: Tensor) -> Tensor:
        """The energy (s,) [N mm] at positions x (s, n, 3), inf if a cell is inverted at a point."""
        energies: Tensor = self.states(self.deformation(x), False)[0]
        return energies.sum(1)

    def gradient(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """J (s, e, q), 1 where a cell is inverted, and dE/dx (s, n, 3) [N] at positions x (s, n, 3)."""
        _, J, stress = self.states(self.deformation(x), True)
        return J, self.forces(stress)

    def mixed_forces(self, x: Tensor, J: Tensor, taken: Tensor) -> Tensor:
        """Right-hand side (s, n, 3) at x of a step whose tangent was computed at F = `taken` (capacity, e, q, 3, 3),
        with the predicted J (capacity, e, q); see fem.elasticity.Elastic.mixed_forces."""
        out: Tensor = self.forces(self.states(self.deformation(x), True, J, taken)[2])
        return out

    def predicted(self, x: Tensor, to: Tensor, taken: Tensor) -> Tensor:
        """J (s, e, q) at positions `to`, to first order from J at x (s, n, 3), linearised at F = `taken`
        (capacity, e, q, 3, 3)."""
        out: Tensor = self.linearised(self.deformation(x), self.deformation(to), taken)
        return out

    def tangents(
        self,
        x: Tensor,
        J: Tensor | None = None,
        projection: Projection = Projection.NONE,
        dtype: torch.dtype = torch.float64,
    ) -> tuple[Tensor, Tensor]:
        """F (s, e, q, 3, 3) at x (s, n, 3) and d2E/dx2 of each cell (s, e, 24, 24), rows and columns 3 corner +
        direction; with the pressure at the predicted J (capacity, e, q) if given. dtype: in which they are summed."""
        F: Tensor = self.deformation(x)
        s, e = F.shape[:2]
        K, dilatation = F.new_empty(s, e, 24, 24, dtype=dtype), F.new_empty(s * e, dtype=dtype)
        points = self.points(F, kernels_of(dtype), dilatation, J, int(projection))
        add_pairs(points, (s * e, 64), self.B, self.slots, None, self.two_invariants, False, K)
        return F, K


def add_pairs(
    at: Points, dim: tuple[int, int], B: Tensor, slots: Tensor, items: Tensor | None, two: bool, add: bool, K: Tensor
) -> None:
    """Write, or add, d2E/dx2 of cells to K (s, e, 24, 24), see tangents.pair_blocks."""
    kernel = kernels_of(K.dtype).pair_blocks[at.memory is not None]
    launch(kernel, dim, B, slots, items, at.points, at.memory, at.modes, at.dilatation, two, add, K.shape[1], K)


def kernels_of(dtype: torch.dtype) -> tangents.Tangents:
    """The kernels of tangents with sums in this precision."""
    return tangents.double() if dtype is torch.float64 else tangents.single()


def jacobians(corners: Tensor, dN: Array) -> Tensor:
    """dX/dxi (..., q, 3, 3) of hexes with corners (..., 8, 3), where they have the derivatives dN (q, 8, 3)."""
    return torch.einsum("qaj,...ai->...qij", constant(dN, corners), corners)
