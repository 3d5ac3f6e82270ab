"""Trilinear hexes of many scenes that share their numbering: energy, forces, tangents and the mixed pressure.

The kernels are those of one scene (physics.elements, physics.tangents). Arrays have the scene first: positions
x (s, n, 3), F (s, e, q, 3, 3).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from tacgen.fem.elements import integration
from tacgen.fem.potential import Projection
from tacgen.physics import elements, tangents
from tacgen.physics.cells import around
from tacgen.physics.laws import two_invariants
from tacgen.physics.runtime import launch, room
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
class Topology:
    """The numbering that the scenes of a batch share, n nodes: conn (e, 8), also as int32 `cells`; the cells of each
    node, `first` (n + 1,) and `around` (k, 2) as in physics.cells.around; and facets (f, 4) of the face, also as int32
    `faces`, with `ends` (n, 4): the facet of which a node is a certain corner, -1 if none."""

    conn: Tensor
    cells: Tensor
    first: Tensor
    around: Tensor
    facets: Tensor
    faces: Tensor
    ends: Tensor
    nodes: int

    @classmethod
    def of(cls, cells: Array, facets: Array, nodes: int, device: str = "cpu") -> "Topology":
        first, pairs = (torch.tensor(part, device=device) for part in around(cells, nodes))
        conn, face = (torch.tensor(part, dtype=torch.long, device=device) for part in (cells, facets))
        return cls(conn, conn.int(), first, pairs, face, face.int(), ends_of(face, nodes), nodes)

    def at_nodes(self, parts: Tensor) -> Tensor:
        """Sums (s, n, 3) of what each cell's corners have, (s, e, 8, 3), in a fixed order, so that results repeat."""
        out = parts.new_empty(len(parts), self.nodes, 3)
        launch(elements.at_nodes, out.shape[:2], parts, self.first, self.around, out)
        return out


@dataclass(frozen=True)
class Hexes:
    """Cells of each scene: B (capacity, e, q, 8, 3) dN/dX [1/mm], weights (capacity, e, q) [mm^3], 0 for void cells,
    and laws (capacity, e, 9), see physics.laws.Coefficients, of which one depends on `two_invariants`; slots (s,): the
    scenes of a call, all if None; memory (capacity, e, q, 3, 3): as in fem.elasticity.Elastic, None in elastic gels."""

    topology: Topology
    B: Tensor
    weights: Tensor
    laws: Tensor
    two_invariants: bool
    slots: Tensor | None = None
    memory: Tensor | None = None

    @classmethod
    def on(cls, topology: Topology, X: Tensor, exists: Tensor, laws: Tensor) -> "Hexes":
        """With nodes X (s, n, 3) at rest; exists (s, e) bool."""
        dX = jacobians(X[:, topology.conn], HEX_SHAPE_GRADIENTS)
        volume, local = determinant(dX), constant(HEX_SHAPE_GRADIENTS, X)
        B = torch.einsum("qaj,...qIj->...qaI", local, cofactor(dX) / volume[..., None, None])
        return cls(topology, B.contiguous(), volume * exists[..., None], laws.contiguous(), two_invariants(laws))

    def rows(self, slots: Tensor) -> "Hexes":
        """Only some scenes (r,)."""
        return replace(self, slots=slots)

    @cached_property
    def numbers(self) -> Tensor:
        """The slots (s,), of all scenes too."""
        return slot_numbers(self.slots, self.B)

    def deformation(self, x: Tensor) -> Tensor:
        """F (s, e, q, 3, 3) at positions x (s, n, 3)."""
        (s, _, _), (e, q) = x.shape, self.weights.shape[1:]
        F, threads = x.new_empty(s, e, q, 3, 3), q if x.is_cuda else 1
        launch(
            elements.deformation, (s, e, threads), x.contiguous(), self.topology.cells, self.B, self.numbers, threads, F
        )
        return F

    def _states(
        self, F: Tensor, want: bool, J: Tensor | None = None, taken: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Energies (s, e), and if wanted J (s, e, q) and weights times P, as elements.states has them."""
        shape, energy = F.shape[:3], F.new_empty(F.shape[:2])
        found, stress = F.new_empty(shape if want else (0, 0, 0)), torch.empty_like(F) if want else None
        launch(
            elements.states, shape[:2], F, self.weights, self.laws, self.numbers, 0.0, self.memory, J, taken, energy,
            found, stress,
        )  # fmt: skip
        return energy, found, F if stress is None else stress

    def isochoric_stress(self, x: Tensor) -> Tensor:
        """s (s, e, q, 3, 3) [MPa] at positions x (s, n, 3), see fem.viscoelasticity."""
        F = self.deformation(x)
        out = torch.empty_like(F)
        launch(elements.isochoric_stresses, F.shape[:3], F, self.laws, self.numbers, out)
        return out

    def _at_nodes(self, stress: Tensor) -> Tensor:
        """Nodal forces (s, n, 3) of weights times P (s, e, q, 3, 3)."""
        s, e = stress.shape[:2]
        forces, threads = stress.new_empty(s, e, 8, 3), 8 if stress.is_cuda else 1
        launch(elements.corner_forces, (s, e, threads), stress, self.B, self.numbers, threads, forces)
        return self.topology.at_nodes(forces)

    def energy(self, x: Tensor) -> Tensor:
        """The energy (s,) [N mm] at positions x (s, n, 3), inf if a cell is inverted at a point."""
        return self._states(self.deformation(x), False)[0].sum(1)

    def gradient(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """J (s, e, q), 1 where a cell is inverted, and dE/dx (s, n, 3) [N] at positions x (s, n, 3)."""
        _, J, stress = self._states(self.deformation(x), True)
        return J, self._at_nodes(stress)

    def mixed_forces(self, x: Tensor, J: Tensor, taken: Tensor) -> Tensor:
        """Right-hand side (s, n, 3) at x of a step whose tangent was computed at F = `taken` (capacity, e, q, 3, 3),
        with the predicted J (capacity, e, q); see fem.elasticity.Elastic.mixed_forces."""
        return self._at_nodes(self._states(self.deformation(x), True, J, taken)[2])

    def predicted(self, x: Tensor, to: Tensor, taken: Tensor) -> Tensor:
        """J (s, e, q) at positions `to`, to first order from J at x (s, n, 3), linearised at F = `taken`
        (capacity, e, q, 3, 3)."""
        F = self.deformation(x)
        J = F.new_empty(F.shape[:3])
        launch(elements.predictions, J.shape, F, self.deformation(to), taken, self.numbers, J)
        return J

    def tangents(
        self,
        x: Tensor,
        J: Tensor | None = None,
        projection: Projection = Projection.NONE,
        dtype: torch.dtype = torch.float64,
    ) -> tuple[Tensor, Tensor]:
        """F (s, e, q, 3, 3) at x (s, n, 3) and d2E/dx2 of each cell (s, e, 24, 24), rows and columns 3 corner +
        direction; with the pressure at the predicted J (capacity, e, q) if given. dtype: in which they are summed."""
        kernels, F = kernels_of(dtype), self.deformation(x)
        s, e, q = F.shape[:3]
        K, dilatation = F.new_empty(s, e, 24, 24, dtype=dtype), F.new_empty(s * e, dtype=dtype)
        points = room(kernels.Point, (s * e, q), F)
        modes = None if projection is Projection.NONE else room(kernels.mat, (s * e, q, 9), F)
        kept = None if self.memory is None else room(kernels.mat, (s * e, q), F)
        launch(
            kernels.points, (s * e,), F, self.weights, self.laws, self.numbers, None, 0.0, self.memory, J,
            int(projection), points, kept, modes, dilatation,
        )  # fmt: skip
        launch(
            kernels.pair_blocks[kept is not None], (s * e, 64), self.B, self.numbers, None, points, kept, modes,
            dilatation, self.two_invariants, False, e, K,
        )  # fmt: skip
        return F, K


def slot_numbers(slots: Tensor | None, rows: Tensor) -> Tensor:
    """Slots (s,) as kernels take them; None: those of all rows."""
    return (torch.arange(len(rows), device=rows.device) if slots is None else slots).int()


def kernels_of(dtype: torch.dtype) -> tangents.Tangents:
    """The kernels of tangents with sums in this precision."""
    return tangents.double() if dtype is torch.float64 else tangents.single()


def jacobians(corners: Tensor, dN: Array) -> Tensor:
    """dX/dxi (..., q, 3, 3) of hexes with corners (..., 8, 3), where they have the derivatives dN (q, 8, 3)."""
    return torch.einsum("qaj,...ai->...qij", constant(dN, corners), corners)
