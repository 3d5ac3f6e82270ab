"""Inversion between integration points in many scenes: the barrier against it, and a certified bound of the Jacobian.

See fem.folding_barrier and fem.jacobian.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from tacgen.fem.elements import grid_points
from tacgen.fem.folding_barrier import INVERSION_BARRIER_STIFFNESS
from tacgen.fem.jacobian import JACOBIAN_TABLES, bounds
from tacgen.fem.projection import Projection
from tacgen.physics.cells import Folds
from tacgen.physics.laws import INVERSION_BARRIER_J0
from tacgen.tensor_engine.elements import Topology, add_pairs, determinant, jacobians, kernels_of
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
        b = self.barriers
        points = b.points(self.x, kernels_of(out.dtype), self.items, None, int(projection))
        slopes = b.dN.expand(len(b.rest), b.rest.shape[1], -1, -1, -1)
        add_pairs(points, (len(self.items), 64), slopes, b.slots, self.items, False, True, out)


@dataclass(frozen=True)
class FoldingBarriers(Folds):
    """The barrier on all cells of each scene."""

    @classmethod
    def on(cls, topology: Topology, X: Tensor, volume: Tensor, mu: Tensor) -> "FoldingBarriers":
        """With nodes X (s, n, 3) at rest, volumes (s, e) [mm^3] and shear moduli [MPa] of cells."""
        rest = determinant(jacobians(X[:, topology.conn], INVERSION_POINT_GRADIENTS)).contiguous()
        stiffness = INVERSION_BARRIER_STIFFNESS * mu * volume / len(INVERSION_POINT_GRADIENTS)
        every = torch.arange(len(X), dtype=torch.int32, device=X.device)
        return cls(topology, constant(INVERSION_POINT_GRADIENTS, X), rest, rest.amax(-1), stiffness, every)

    def stiffened(self, times: Tensor) -> "FoldingBarriers":
        """With stiffnesses multiplied by `times` (capacity,)."""
        return replace(self, stiffness=self.stiffness * times[:, None])

    def energy(self, x: Tensor) -> Tensor:
        """The energy (s,) [N mm] at positions x (s, n, 3), inf if a cell is inverted."""
        energies: Tensor = self.found(x, False)[0]
        return energies.view(len(x), -1).sum(1)

    def gradient(self, x: Tensor) -> Tensor:
        """dE/dx (s, n, 3) [N] at positions x (s, n, 3)."""
        forces: Tensor = self.found(x, True)[1]
        out: Tensor = self.numbering.at_nodes(forces.view(len(x), -1, 8, 3))
        return out

    def evaluate(self, x: Tensor) -> Folding:
        """At positions x (s, n, 3)."""
        low = torch.where(self.stiffness[self.slots] > 0, self.lowest(x), torch.inf)  # in void cells
        if recording():  # the lowest; it is 0 where they are above J0
            most = min(recorded_room(*RECORDED_BARRIER_CELLS), low.shape[1])
            rare((low < INVERSION_BARRIER_J0).sum(1) > most)
            cell = low.topk(most, largest=False).indices.flatten()
            scene = torch.arange(len(x), device=x.device).repeat_interleave(most)
            return Folding(self, x, torch.stack([scene, cell], -1).int())
        folded = low < INVERSION_BARRIER_J0
        items = torch.nonzero(folded) if rare(folded) else self.numbering.conn.new_zeros(0, 2)
        return Folding(self, x, items.int())


def least_jacobian(X: Tensor, x: Tensor, topology: Topology, exists: Tensor, tol: float = 0.01) -> Tensor:
    """Lower bounds (s,) of J at all points of all cells that exist (s, e); see fem.jacobian.least_jacobian."""
    table = JACOBIAN_TABLES[8]
    parts = (constant(part, topology.cells if part.dtype == np.int32 else x) for part in (*table.whole, table.pieces))
    return bounds(X, x, topology.cells, exists, tuple(parts), tol)[0].amin(1)
