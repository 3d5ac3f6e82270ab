"""Inversion between integration points in many scenes: the barrier against it, and a certified bound of the Jacobian.

See fem.folding_barrier and fem.jacobian.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from tacgen.fem.elements import grid_points
from tacgen.fem.folding_barrier import INVERSION_BARRIER_STIFFNESS
from tacgen.fem.jacobian import JACOBIAN_TABLES, MAX_SUBDIVISIONS
from tacgen.fem.potential import Projection
from tacgen.physics import elements
from tacgen.physics.laws import INVERSION_BARRIER_J0
from tacgen.physics.runtime import launch, room
from tacgen.tensor_engine.elements import Topology, kernels_of, slot_numbers
from tacgen.tensor_engine.indices import constant
from tacgen.tensor_engine.replay import rare, recording
from tacgen.tensor_engine.replay import room as recorded_room

INVERSION_POINT_GRADIENTS = grid_points(8)[1]  # dN (q, 8, 3) at the points where it is looked for
HEX_TABLE = JACOBIAN_TABLES[8]
# coefficients (27,) of the triples (64, 27)
TRIPLE_COEFFICIENTS = np.eye(len(HEX_TABLE.share))[HEX_TABLE.monomial.ravel()] * HEX_TABLE.share
PIECE_TRANSFORMS = HEX_TABLE.pieces.reshape(-1, len(HEX_TABLE.share))
AWAY_FROM_CORNERS = np.where(HEX_TABLE.share == 1, 0.0, np.inf)  # added to the coefficients, leaves those at corners
# cells of a scene on which a recorded barrier acts at most, first and where more do
RECORDED_BARRIER_CELLS = 64, 1024
# pieces of a scene that are divided at once at most, and in a recording
MAX_DIVIDED_PIECES, RECORDED_DIVIDED_PIECES = 4096, (64, 1024)


@dataclass(frozen=True)
class Folding:
    """The barrier at positions x (s, n, 3): the cells on which it may act, `items` (k, 2) of a row of x and a cell."""

    barriers: "FoldingBarriers"
    x: Tensor
    items: Tensor

    def add_tangents(self, out: Tensor, projection: Projection) -> None:
        """Add d2E/dx2 to the cells' tangents out (s, e, 24, 24)."""
        if not len(self.items):
            return
        kernels = kernels_of(out.dtype)
        k, q, b = len(self.items), len(INVERSION_POINT_GRADIENTS), self.barriers
        points = room(kernels.Point, (k, q), out)
        modes = None if projection is Projection.NONE else room(kernels.mat, (k, q, 9), out)
        launch(
            kernels.folding_points, (k,), self.x, b.topology.cells, b.dN, b.rest, b.stiffness, b.numbers, self.items,
            int(projection), points, modes,
        )  # fmt: skip
        slopes = b.dN.expand(len(b.rest), b.rest.shape[1], -1, -1, -1)
        launch(
            kernels.pair_blocks, (k, 64), slopes, b.numbers, self.items, points, modes, None, False, True, out.shape[1],
            out,
        )  # fmt: skip


@dataclass(frozen=True)
class FoldingBarriers:
    """The barrier on all cells: det(dX/dxi) at rest (capacity, e, q), the largest of a cell, and the stiffness times a
    point's volume (capacity, e) [N mm], 0 for void cells; slots (s,): the scenes of a call, all if None."""

    topology: Topology
    rest: Tensor
    most: Tensor
    stiffness: Tensor
    slots: Tensor | None = None

    @classmethod
    def on(cls, topology: Topology, X: Tensor, volume: Tensor, mu: Tensor) -> "FoldingBarriers":
        """With nodes X (s, n, 3) at rest, volumes (s, e) [mm^3] and shear moduli [MPa] of cells."""
        rest = _determinants(X[:, topology.conn]).contiguous()
        return cls(
            topology, rest, rest.amax(-1), INVERSION_BARRIER_STIFFNESS * mu * volume / len(INVERSION_POINT_GRADIENTS)
        )

    def rows(self, slots: Tensor) -> "FoldingBarriers":
        """Only some scenes (r,)."""
        return replace(self, slots=slots)

    def stiffened(self, times: Tensor) -> "FoldingBarriers":
        """With stiffnesses multiplied by `times` (capacity,)."""
        return replace(self, stiffness=self.stiffness * times[:, None])

    @property
    def dN(self) -> Tensor:
        return constant(INVERSION_POINT_GRADIENTS, self.rest)

    @cached_property
    def numbers(self) -> Tensor:
        """The slots of the scenes of a call."""
        return slot_numbers(self.slots, self.rest)

    def _folds(self, x: Tensor, want: bool) -> tuple[Tensor, Tensor]:
        """Energies (s, e) of cells at x (s, n, 3) and, if wanted, forces (s, e, 8, 3) on their corners."""
        s, e = len(x), self.rest.shape[1]
        energy, forces = x.new_empty(s * e), x.new_empty((s * e, 8, 3) if want else (0, 0, 3))
        launch(
            elements.folds, (s * e,), x.contiguous(), self.topology.cells, self.dN, self.rest, self.most,
            self.stiffness, self.numbers, None, energy, forces,
        )  # fmt: skip
        return energy.view(s, e), forces.view(s, e, 8, 3) if want else forces

    def energy(self, x: Tensor) -> Tensor:
        """The energy (s,) [N mm] at positions x (s, n, 3), inf if a cell is inverted."""
        return self._folds(x, False)[0].sum(1)

    def gradient(self, x: Tensor) -> Tensor:
        """dE/dx (s, n, 3) [N] at positions x (s, n, 3)."""
        return self.topology.at_nodes(self._folds(x, True)[1])

    def evaluate(self, x: Tensor) -> Folding:
        """At positions x (s, n, 3)."""
        low = self._lowest(x)
        if recording():  # the lowest; it is 0 where they are above J0
            most = min(recorded_room(*RECORDED_BARRIER_CELLS), low.shape[1])
            rare((low < INVERSION_BARRIER_J0).sum(1) > most)
            cell = low.topk(most, largest=False).indices.flatten()
            scene = torch.arange(len(x), device=x.device).repeat_interleave(most)
            return Folding(self, x.contiguous(), torch.stack([scene, cell], -1).int())
        folded = low < INVERSION_BARRIER_J0
        items = torch.nonzero(folded) if rare(folded) else self.topology.conn.new_zeros(0, 2)
        return Folding(self, x.contiguous(), items.int())

    def _lowest(self, x: Tensor) -> Tensor:
        """The lowest J of each cell (s, e) at the dense points, or a bound of at least J0; inf in void cells."""
        low = x.new_empty(len(x), self.rest.shape[1])
        launch(
            elements.lowest, low.shape, x.contiguous(), self.topology.cells, self.dN, self.rest, self.most,
            self.numbers, low,
        )  # fmt: skip
        stiffness = self.stiffness if self.slots is None else self.stiffness[self.slots]
        return torch.where(stiffness > 0, low, torch.inf)


def _determinants(corners: Tensor) -> Tensor:
    """det(dx/dxi) (s, e, q) at the dense points of hexes with corners (s, e, 8, 3)."""
    a, b, c = torch.einsum("qaj,seai->jseqi", constant(INVERSION_POINT_GRADIENTS, corners), corners).unbind(0)
    return (a * torch.linalg.cross(b, c)).sum(-1)


def coefficients(corners: Tensor) -> Tensor:
    """Bernstein coefficients (..., 27) of the determinant of hexes with corners (..., 8, 3) [mm^3]."""
    g = torch.einsum("kpa,...aj->...kpj", constant(HEX_TABLE.columns, corners), corners)
    crossed = torch.linalg.cross(g[..., 0, :, None, :], g[..., 1, None, :, :])
    triples = (crossed.flatten(-3, -2) @ g[..., 2, :, :].mT).flatten(-2)
    return triples @ constant(TRIPLE_COEFFICIENTS, corners)


def least_jacobian(X: Tensor, x: Tensor, topology: Topology, exists: Tensor, tol: float = 0.01) -> Tensor:
    """Lower bounds (s,) of J at all points of all cells that exist (s, e); see fem.jacobian.least_jacobian."""
    corners, parts, there = constant(AWAY_FROM_CORNERS, x), constant(PIECE_TRANSFORMS, x).T, exists
    volume = torch.where(exists, coefficients(X[:, topology.conn]).mean(-1), 1.0)
    pieces = coefficients(x[:, topology.conn]) / volume[..., None]
    bound = attained = torch.full_like(x[:, 0, 0], torch.inf)
    for depth in range(MAX_SUBDIVISIONS + 1):
        at_corners = (pieces + corners).amin(-1)
        attained = torch.minimum(attained, torch.where(there, at_corners, torch.inf).amin(1))
        low = torch.where(there, pieces.amin(-1), torch.inf)
        open_ = low < attained[:, None] - tol
        if depth == MAX_SUBDIVISIONS or not (recording() or bool(open_.any())):
            bound = torch.minimum(bound, low.amin(1))
            break
        count = min(recorded_room(*RECORDED_DIVIDED_PIECES) if recording() else MAX_DIVIDED_PIECES, low.shape[1])
        if recording():
            rare(open_.sum(1) > count)
        which = low.topk(count, largest=False).indices
        there = open_.gather(1, which)
        left = low.scatter(1, which, torch.where(there, torch.inf, low.gather(1, which)))
        bound = torch.minimum(bound, left.amin(1))
        pieces = pieces.gather(1, which[..., None].expand(-1, -1, pieces.shape[2]))
        pieces = (pieces @ parts).view(len(x), -1, pieces.shape[2])
        there = there.repeat_interleave(len(HEX_TABLE.pieces), 1)
    return torch.where(torch.isfinite(x).all(-1).all(-1), bound, -torch.inf)
