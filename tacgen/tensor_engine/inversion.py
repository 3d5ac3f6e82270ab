"""Inversion between integration points in many scenes: the barrier against it, and a certified bound of the Jacobian.

See fem.folding_barrier and fem.jacobian.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from tacgen.fem.elasticity import SMALLEST_J
from tacgen.fem.elements import grid_points
from tacgen.fem.folding_barrier import J0, STIFFNESS
from tacgen.fem.jacobian import DEPTH, TABLES
from tacgen.fem.potential import Projection
from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine.elements import Topology, clamped, cofactor, determinant, mapped, slopes, stiffness
from tacgen.tensor_engine.indices import constant, gathered
from tacgen.tensor_engine.laws import clamped_log
from tacgen.tensor_engine.replay import rare, recording, room

DENSE = grid_points(8)[1]  # dN (q, 8, 3) at the points where it is looked for
TABLE = TABLES[8]
ONE = np.eye(len(TABLE.share))[TABLE.monomial.ravel()] * TABLE.share  # coefficients (27,) of the triples (64, 27)
PARTS = TABLE.pieces.reshape(-1, len(TABLE.share))
ELSEWHERE = np.where(TABLE.share == 1, 0.0, np.inf)  # added to the coefficients, leaves those at corners
# cells of a scene on which a recorded barrier acts at most, first and where more do
FOLDED = 64, 1024
DIVIDED, RECORDED = 4096, (64, 1024)  # pieces of a scene that are divided at once at most, and in a recording


@dataclass(frozen=True)
class Folding:
    """Cells with a point below J0, as pairs of `scene` and `cell` (k,), and their state: B (k, q, 8, 3), weights and J
    (k, q), U' and U'' there; the energy of each scene (s,) [N mm], inf if a cell is inverted at a point."""

    topology: Topology
    scene: Tensor
    cell: Tensor
    B: Tensor
    weights: Tensor
    F: Tensor
    slope: Tensor
    bend: Tensor
    energy: Tensor

    def add_forces(self, out: Tensor) -> None:
        """Add dE/dx to out (s, n, 3) [N]."""
        if len(self.cell):
            P = (self.weights * self.slope)[..., None, None] * cofactor(self.F)
            at = self.scene[:, None] * out.shape[1] + self.topology.conn[self.cell]
            out.view(-1, 3).index_put_((at.flatten(),), (self.B @ P.mT).sum(1).view(-1, 3), accumulate=True)

    def add_tangents(self, out: Tensor, projection: Projection) -> None:
        """Add d2E/dx2 to the cells' tangents out (s, e, 24, 24)."""
        if not len(self.cell):
            return
        zero = torch.zeros_like(self.slope)
        first, second = [zero, zero, self.slope], [zero, zero, self.bend, zero, zero, zero]
        D = slopes(self.F, zero, first, second, False)
        if projection is not Projection.NONE:
            D = clamped(D, self.F, projection)
        out[self.scene, self.cell] += stiffness(self.B, self.weights, D).to(out.dtype)


@dataclass(frozen=True)
class FoldingBarriers:
    """The barrier on all cells: nodes at rest X (capacity, n, 3), det(dX/dxi) at rest (capacity, e, q), volumes
    (capacity, e) [mm^3], 0 for void cells, and shear moduli mu (capacity, e) [MPa]; slots (s,): the scenes of a call,
    all if None. Stiffness is multiplied by `times` (capacity,)."""

    topology: Topology
    X: Tensor
    rest: Tensor
    volume: Tensor
    mu: Tensor
    slots: Tensor | None = None

    @classmethod
    def on(cls, topology: Topology, X: Tensor, volume: Tensor, mu: Tensor) -> "FoldingBarriers":
        return cls(topology, X, _determinants(X[:, topology.conn]).contiguous(), volume, mu)

    def rows(self, slots: Tensor) -> "FoldingBarriers":
        """Only some scenes (r,)."""
        return replace(self, slots=slots)

    @property
    def numbers(self) -> Tensor:
        """The slots of the scenes of a call."""
        return torch.arange(len(self.X), device=self.X.device) if self.slots is None else self.slots

    def energy(self, x: Tensor, times: Tensor) -> Tensor:
        """The energy (s,) [N mm] at positions x (s, n, 3), inf if a cell is inverted."""
        if devices.by_kernels(x):
            from tacgen.tensor_engine import gpu_elements

            return gpu_elements.folds(self, x, times, False)[0].sum(1)
        return self.evaluate(x, times).energy

    def gradient(self, x: Tensor, times: Tensor) -> Tensor:
        """dE/dx (s, n, 3) [N] at positions x (s, n, 3)."""
        if devices.by_kernels(x):
            from tacgen.tensor_engine import gpu_elements

            return self.topology.at_nodes(gpu_elements.folds(self, x, times, True)[1])
        out = torch.zeros_like(x)
        self.evaluate(x, times).add_forces(out)
        return out

    def evaluate(self, x: Tensor, times: Tensor) -> Folding:
        """At positions x (s, n, 3)."""
        parts = self.X, self.rest, self.volume, self.mu, times
        X, rest, volume, mu, times = parts if self.slots is None else gathered(self.slots, *parts)
        corners, low = x[:, self.topology.conn], self._lowest(x, rest)
        folded = (low < J0) & (volume > 0)
        if recording():  # the lowest; it is 0 where they are above J0
            most = min(room(*FOLDED), low.shape[1])
            rare(folded.sum(1) > most)
            cell = torch.where(volume > 0, low, torch.inf).topk(most, largest=False).indices.flatten()
            scene = torch.arange(len(x), device=x.device).repeat_interleave(most)
        elif rare(folded):
            scene, cell = torch.nonzero(folded, as_tuple=True)
        else:
            none, cell = x.new_zeros(0), self.topology.conn.new_zeros(0)
            return Folding(self.topology, cell, cell, none, none, none, none, none, x.new_zeros(len(x)))
        B, _ = mapped(X[scene[:, None], self.topology.conn[cell]], DENSE)
        q = len(DENSE)
        weights = (volume[scene, cell] / q)[:, None].expand(-1, q)
        F = torch.einsum("kai,kqaJ->kqiJ", corners[scene, cell], B)
        J = determinant(F)
        good = J > SMALLEST_J
        stiff = (STIFFNESS * times[scene] * mu[scene, cell])[:, None]
        U, slope, bend = clamped_log(stiff, torch.where(good, J, 1.0))
        energy = torch.where(good, weights * U, torch.inf).sum(1)
        total = x.new_zeros(len(x)).index_put_((scene,), energy, accumulate=True)
        return Folding(self.topology, scene, cell, B, weights, F, slope, bend, total)

    def _lowest(self, x: Tensor, rest: Tensor) -> Tensor:
        """The lowest J of each cell (s, e) at the dense points, where that at rest is (s, e, q)."""
        if devices.by_kernels(x):
            from tacgen.tensor_engine import gpu_elements

            return gpu_elements.lowest(self.topology, x, rest)
        return (_determinants(x[:, self.topology.conn]) / rest).amin(-1)


def _determinants(corners: Tensor) -> Tensor:
    """det(dx/dxi) (s, e, q) at the dense points of hexes with corners (s, e, 8, 3)."""
    a, b, c = torch.einsum("qaj,seai->jseqi", constant(DENSE, corners), corners).unbind(0)
    return (a * torch.linalg.cross(b, c)).sum(-1)


def coefficients(corners: Tensor) -> Tensor:
    """Bernstein coefficients (..., 27) of the determinant of hexes with corners (..., 8, 3) [mm^3]."""
    g = torch.einsum("kpa,...aj->...kpj", constant(TABLE.columns, corners), corners)
    crossed = torch.linalg.cross(g[..., 0, :, None, :], g[..., 1, None, :, :])
    triples = (crossed.flatten(-3, -2) @ g[..., 2, :, :].mT).flatten(-2)
    return triples @ constant(ONE, corners)


def least_jacobian(X: Tensor, x: Tensor, topology: Topology, exists: Tensor, tol: float = 0.01) -> Tensor:
    """Lower bounds (s,) of J at all points of all cells that exist (s, e); see fem.jacobian.least_jacobian."""
    corners, parts, there = constant(ELSEWHERE, x), constant(PARTS, x).T, exists
    volume = torch.where(exists, coefficients(X[:, topology.conn]).mean(-1), 1.0)
    pieces = coefficients(x[:, topology.conn]) / volume[..., None]
    bound = attained = torch.full_like(x[:, 0, 0], torch.inf)
    for depth in range(DEPTH + 1):
        at_corners = (pieces + corners).amin(-1)
        attained = torch.minimum(attained, torch.where(there, at_corners, torch.inf).amin(1))
        low = torch.where(there, pieces.amin(-1), torch.inf)
        open_ = low < attained[:, None] - tol
        if depth == DEPTH or not (recording() or bool(open_.any())):
            bound = torch.minimum(bound, low.amin(1))
            break
        count = min(room(*RECORDED) if recording() else DIVIDED, low.shape[1])
        if recording():
            rare(open_.sum(1) > count)
        which = low.topk(count, largest=False).indices
        there = open_.gather(1, which)
        left = low.scatter(1, which, torch.where(there, torch.inf, low.gather(1, which)))
        bound = torch.minimum(bound, left.amin(1))
        pieces = pieces.gather(1, which[..., None].expand(-1, -1, pieces.shape[2]))
        pieces = (pieces @ parts).view(len(x), -1, pieces.shape[2])
        there = there.repeat_interleave(len(TABLE.pieces), 1)
    return torch.where(torch.isfinite(x).all(-1).all(-1), bound, -torch.inf)
