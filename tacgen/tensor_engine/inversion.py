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
from tacgen.fem.jacobian import JACOBIAN_TABLES, MAX_PIECES, MAX_SUBDIVISIONS
from tacgen.fem.potential import Projection
from tacgen.physics import elements, jacobian
from tacgen.physics.laws import INVERSION_BARRIER_J0
from tacgen.physics.runtime import launch, room
from tacgen.tensor_engine.elements import Topology, determinant, jacobians, kernels_of, slot_numbers
from tacgen.tensor_engine.indices import constant
from tacgen.tensor_engine.replay import rare, recording
from tacgen.tensor_engine.replay import room as recorded_room

INVERSION_POINT_GRADIENTS = grid_points(8)[1]  # dN (q, 8, 3) at the points where it is looked for
# cells of a scene on which a recorded barrier acts at most, first and where more do
RECORDED_BARRIER_CELLS = 64, 1024


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
            kernels.pair_blocks[False], (k, 64), slopes, b.numbers, self.items, points, None, modes, None, False, True,
            out.shape[1], out,
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
        rest = determinant(jacobians(X[:, topology.conn], INVERSION_POINT_GRADIENTS)).contiguous()
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


def least_jacobian(X: Tensor, x: Tensor, topology: Topology, exists: Tensor, tol: float = 0.01) -> Tensor:
    """Lower bounds (s,) of J at all points of all cells that exist (s, e); see fem.jacobian.least_jacobian."""
    table, shape, conn = JACOBIAN_TABLES[8], exists.shape, topology.cells
    whole = tuple(constant(part, conn if part.dtype == np.int32 else x) for part in table.whole)
    volume, low, attained = (x.new_empty(shape) for _ in range(3))
    X, x, pieces = X.contiguous(), x.contiguous(), constant(table.pieces, x)
    launch(jacobian.whole_bounds, shape, X, x, conn, exists, *whole, volume, low, attained)
    launch(
        jacobian.divided_bounds, shape, x, conn, *whole, pieces, volume, attained.amin(1), tol, MAX_SUBDIVISIONS,
        MAX_PIECES, low,
    )  # fmt: skip
    return low.amin(1)
