"""Trilinear hexes of many scenes that share their numbering: energy, forces, tangents and the mixed pressure.

As fem.elements.hexes, fem.elasticity and fem.kernels compute them one scene at a time. Arrays have the scene first:
positions x (s, n, 3), F (s, e, q, 3, 3). Sums over the cells of a node are in a fixed order, so that results repeat.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from tacgen.fem.elasticity import PREDICTED, SMALLEST_J
from tacgen.fem.elements import GAUSS2, trilinear
from tacgen.fem.kernels import MILD
from tacgen.fem.potential import Projection
from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine.indices import constant
from tacgen.tensor_engine.laws import Laws, isochoric, volumetric
from tacgen.tensor_engine.products import outer, product

Array = np.ndarray
MOST = 2**11  # matrices whose eigenvalues are found at once: cuSOLVER needs some 300 kB for each, and fails above 2^15
# N (q, 8) and dN (q, 8, 3) at the integration points
SHAPE, GAUSS = trilinear(np.array([[a, b, c] for c in GAUSS2 for b in GAUSS2 for a in GAUSS2]))


def cofactor(F: Tensor) -> Tensor:
    """J F^-T of F (..., 3, 3)."""
    return torch.linalg.cross(F.roll(-1, -2), F.roll(-2, -2))


def determinant(F: Tensor) -> Tensor:
    """J (...) of F (..., 3, 3)."""
    return (F[..., 0, :] * torch.linalg.cross(F[..., 1, :], F[..., 2, :])).sum(-1)


def _cofactor_slopes(F: Tensor) -> Tensor:
    """d cof(F)_iJ / d F_kL as (..., 9, 9), linear in F: blocks of the cross products with its rows."""
    zero = torch.zeros_like(F[..., 0, 0])
    x, y, z = (
        torch.stack([zero, c, -b, -c, zero, a, b, -a, zero], -1).unflatten(-1, (3, 3))
        for a, b, c in (row.unbind(-1) for row in F.unbind(-2))
    )
    none = torch.zeros_like(x)
    blocks = [[none, z, -y], [-z, none, x], [y, -x, none]]
    return torch.cat([torch.cat(row, -1) for row in blocks], -2)


@dataclass(frozen=True)
class Topology:
    """The numbering that the scenes of a batch share, n nodes: conn (e, 8); the cells of each node (n, 8) as numbers
    8 e + corner, padded with 8 times the number of cells; and facets (f, 4) of the face."""

    conn: Tensor
    around: Tensor
    facets: Tensor
    nodes: int

    @classmethod
    def of(cls, cells: Array, facets: Array, nodes: int, device: str = "cpu") -> "Topology":
        flat = cells.ravel()
        order = np.argsort(flat, kind="stable")
        place = np.arange(flat.size) - np.searchsorted(flat[order], flat[order])
        around = np.full((nodes, 8), flat.size)
        around[flat[order], place] = order
        numbers = (np.ascontiguousarray(part) for part in (cells, around, facets))
        conn, near, face = (torch.tensor(part, dtype=torch.long, device=device) for part in numbers)
        return cls(conn, near, face, nodes)

    def at_nodes(self, parts: Tensor) -> Tensor:
        """Sums (s, n, c) of what each cell's corners have, (s, e, 8, c)."""
        s, _, _, c = parts.shape
        if devices.by_kernels(parts) and c == 3:
            from tacgen.tensor_engine import gpu_elements

            return gpu_elements.at_nodes(self, parts)
        flat = torch.cat([parts.reshape(s, -1, c), parts.new_zeros((s, 1, c))], 1)
        return flat[:, self.around].sum(2)


@dataclass(frozen=True)
class HexPoints:
    """State at the integration points: F, I1 and J, the law's first derivatives in (I1, I2, J) with U' (3 of (s, e, q))
    and the second (6), U''/volume (s, e), and the energy (s,) [N mm], inf if an element is inverted."""

    F: Tensor
    I1: Tensor
    J: Tensor
    energy: Tensor
    first: list[Tensor]
    second: list[Tensor]
    dilatation: Tensor


@dataclass(frozen=True)
class Hexes:
    """Cells of each scene: B (capacity, e, 8, q, 3) dN/dX [1/mm], weights (capacity, e, q) [mm^3], 0 for void cells,
    and laws; slots (s,): the scenes of a call, all if None."""

    topology: Topology
    B: Tensor
    weights: Tensor
    laws: Laws
    slots: Tensor | None = None

    @classmethod
    def on(cls, topology: Topology, X: Tensor, exists: Tensor, laws: Laws) -> "Hexes":
        """With nodes X (s, n, 3) at rest; exists (s, e) bool."""
        B, volume = mapped(X[:, topology.conn], GAUSS)
        return cls(topology, B.movedim(-3, -2).contiguous(), volume * exists[..., None], laws)

    def rows(self, slots: Tensor) -> "Hexes":
        """Only some scenes (r,)."""
        return replace(self, slots=slots)

    @cached_property
    def numbers(self) -> Tensor:
        """The slots (s,), of all scenes too."""
        return torch.arange(len(self.B), device=self.B.device) if self.slots is None else self.slots

    @cached_property
    def own(self) -> tuple[Tensor, Tensor, Tensor]:
        """B, weights and numbers of the laws of the scenes of a call."""
        values = self.laws.values if self.slots is None else self.laws.values[:, self.slots]
        return self._read(self.B), self._read(self.weights), values

    def _read(self, part: Tensor) -> Tensor:
        """Rows of the scenes of a call."""
        return part if self.slots is None else part[self.slots]

    def deformation(self, x: Tensor) -> Tensor:
        """F (s, e, q, 3, 3) at positions x (s, n, 3)."""
        B, (s, e, q) = self.own[0], self.own[1].shape
        F = x[:, self.topology.conn].mT @ B.flatten(-2)
        return F.reshape(s, e, 3, q, 3).movedim(3, 2)

    def evaluate(self, x: Tensor) -> HexPoints:
        """Invariants, energy and derivatives; if J <= 0 anywhere the energy is inf and the rest is undefined."""
        F = self.deformation(x)
        I1, J, energy, dilatation, *both = _state(F, *self.own[1:])
        return HexPoints(F, I1, J, energy, both[:3], both[3:], dilatation)

    def energy(self, x: Tensor) -> Tensor:
        """The energy (s,) [N mm] at positions x (s, n, 3), inf if a cell is inverted at a point."""
        if devices.by_kernels(x):
            from tacgen.tensor_engine import gpu_elements

            return gpu_elements.states(self, x, False)[0].sum(1)
        return self.evaluate(x).energy

    def gradient(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """J (s, e, q), 1 where a cell is inverted, and dE/dx (s, n, 3) [N] at positions x (s, n, 3)."""
        if devices.by_kernels(x):
            from tacgen.tensor_engine import gpu_elements

            _, J, forces = gpu_elements.states(self, x, True)
            return J, self.topology.at_nodes(forces)
        at = self.evaluate(x)
        return at.J, self._spread(_piola(at.F, at.I1, at.first, self.laws.two_invariants))

    def mixed_forces(self, x: Tensor, J: Tensor, taken: Tensor) -> Tensor:
        """Right-hand side (s, n, 3) at x of a step whose tangent was computed at F = `taken` (capacity, e, q, 3, 3),
        with the predicted J (capacity, e, q); see fem.elasticity.Elastic.mixed_forces."""
        if devices.by_kernels(x):
            from tacgen.tensor_engine import gpu_elements

            return self.topology.at_nodes(gpu_elements.states(self, x, True, J, taken)[2])
        at, taken = self.evaluate(x), self._read(taken)
        first = self._with_pressure(at, self._read(J))
        P = _piola(at.F, at.I1, first, self.laws.two_invariants)
        return self._spread(P + (at.first[2] - first[2])[..., None, None] * cofactor(taken))

    def predicted(self, x: Tensor, to: Tensor, taken: Tensor) -> Tensor:
        """J (s, e, q) at positions `to`, to first order from J at x (s, n, 3), linearised at F = `taken`
        (capacity, e, q, 3, 3)."""
        if devices.by_kernels(x):
            from tacgen.tensor_engine import gpu_elements

            return gpu_elements.predictions(self, x, to, taken)
        F = self.deformation(x)
        return determinant(F) + (cofactor(self._read(taken)) * (self.deformation(to) - F)).sum((-2, -1))

    def _spread(self, P: Tensor) -> Tensor:
        """Nodal forces (s, n, 3) of stresses P (s, e, q, 3, 3)."""
        B, weights, _ = self.own
        return self.topology.at_nodes(B.flatten(-2) @ (weights[..., None, None] * P).mT.flatten(2, 3))

    def _with_pressure(self, at: HexPoints, J: Tensor) -> list[Tensor]:
        """HexPoints.first with the pressure of another J (s, e, q)."""
        J = torch.minimum(torch.maximum(J, at.J / PREDICTED), PREDICTED * at.J)
        _, weights, values = self.own
        change = volumetric(values, mean(J, weights))[1] - volumetric(values, mean(at.J, weights))[1]
        return [*at.first[:2], at.first[2] + change[..., None]]

    def tangents(
        self,
        x: Tensor,
        J: Tensor | None = None,
        projection: Projection = Projection.NONE,
        dtype: torch.dtype = torch.float64,
    ) -> tuple[Tensor, Tensor]:
        """F (s, e, q, 3, 3) at x (s, n, 3) and d2E/dx2 of each cell (s, e, 24, 24), rows and columns 3 corner +
        direction; with the pressure at the predicted J if given. dtype: in which they are computed."""
        if devices.by_kernels(x) and projection is Projection.NONE and dtype is torch.float32:
            from tacgen.tensor_engine import gpu_tangents

            return gpu_tangents.tangents(self, x, J)
        at = self.evaluate(x)
        first = at.first if J is None else self._with_pressure(at, J)
        B, weights, _ = self.own
        F, I1, weights, B, dilatation = (p.to(dtype) for p in (at.F, at.I1, weights, B, at.dilatation))
        first, second = ([p.to(dtype) for p in each] for each in (first, at.second))
        D = slopes(F, I1, first, second, self.laws.two_invariants)
        if projection is not Projection.NONE:
            D = clamped(D, F, projection)
        K = stiffness(B.movedim(-3, -2), weights, D)
        g = (B.flatten(-2) @ (weights[..., None, None] * cofactor(F)).mT.flatten(2, 3)).flatten(-2)
        return at.F, K.addcmul_(dilatation[..., None, None] * g[..., :, None], g[..., None, :])


def mapped(corners: Tensor, dN: Array) -> tuple[Tensor, Tensor]:
    """dN/dX (..., q, 8, 3) and det(dX/dxi) (..., q) of hexes with corners (..., 8, 3); dN (q, 8, 3), a constant."""
    local = constant(dN, corners)
    jacobian = torch.einsum("qaj,...ai->...qij", local, corners)
    volume = determinant(jacobian)
    return torch.einsum("qaj,...qIj->...qaI", local, cofactor(jacobian) / volume[..., None, None]), volume


def stiffness(B: Tensor, weights: Tensor, D: Tensor) -> Tensor:
    """Sums over points of B^T D B (..., 24, 24): B (..., q, 8, 3), weights (..., q), D = dP/dF (..., q, 9, 9)."""
    q, shape = weights.shape[-1], weights.shape[:-1]
    wide = D.unflatten(-1, (3, 3)).unflatten(-3, (3, 3)).movedim(-3, -4).flatten(-3)  # J, then i k L
    left = ((weights[..., None, None] * B) @ wide).reshape(*shape, q, 72, 3).movedim(-3, -2).reshape(*shape, 72, 3 * q)
    right = B.movedim(-3, -2).reshape(*shape, 8, 3 * q)
    return (left @ right.mT).reshape(*shape, 8, 3, 3, 8).mT.reshape(*shape, 24, 24)


def mean(J: Tensor, weights: Tensor) -> Tensor:
    """The mean J (s, e) of each cell; 1 in void ones."""
    volume = weights.sum(-1)
    return torch.where(volume > 0, (weights * J).sum(-1) / volume.clamp(min=1e-300), 1.0)


def _state(F: Tensor, w: Tensor, values: Tensor) -> tuple[Tensor, ...]:
    """I1, J, energy, dilatation, first and second of HexPoints; w: weights, values: of the laws."""
    C = cofactor(F)
    I1, I2, J = (F * F).sum((-2, -1)), (C * C).sum((-2, -1)), (F[..., 0, :] * C[..., 0, :]).sum(-1)
    good = J > SMALLEST_J
    J = torch.where(good, J, 1.0)
    value, first, second = isochoric(values, I1, I2, J)
    volume = w.sum(-1)
    U, dU, ddU = volumetric(values, mean(J, w))
    energy = (w * value).sum((1, 2)) + (volume * U).sum(1)
    energy = torch.where((good | (w == 0)).all(-1).all(-1), energy, torch.inf)
    dilatation = torch.where(volume > 0, ddU / volume.clamp(min=1e-300), 0.0)
    return I1, J, energy, dilatation, first[0], first[1], first[2] + dU[..., None], *second


def _piola(F: Tensor, I1: Tensor, first: list[Tensor], two: bool) -> Tensor:
    """P (..., 3, 3) = 2 w1 F + 2 w2 (I1 F - F F^T F) + w3 cof F; two: whether there is a w2."""
    w1, w2, w3 = first
    P = 2 * (w1 + w2 * I1)[..., None, None] * F + w3[..., None, None] * cofactor(F)
    return P - 2 * w2[..., None, None] * product(F, product(F.mT, F)) if two else P


def slopes(F: Tensor, I1: Tensor, first: list[Tensor], second: list[Tensor], two: bool) -> Tensor:
    """dP/dF (..., 9, 9), index 3 i + J, of F (..., 3, 3); `two`: whether the law depends on I2."""
    (w1, w2, w3), (s11, s22, s33, s12, s13, s23) = ([part[..., None] for part in each] for each in (first, second))
    flat, C, eye = F.flatten(-2), cofactor(F).flatten(-2), torch.eye(9, dtype=F.dtype, device=F.device)
    G = 2 * flat
    D = outer(G, s11 * G + s13 * C) + outer(C, s13 * G + s33 * C) + w3[..., None] * _cofactor_slopes(F)
    D = D + 2 * (w1 + w2 * I1[..., None])[..., None] * eye
    if two:
        T = 2 * (I1[..., None] * flat - product(F, product(F.mT, F)).flatten(-2))
        D = D + outer(G, s12 * T + w2 * G) + outer(T, s12 * G + s22 * T + s23 * C) + outer(C, s23 * T)
        right, left = product(F.mT, F), product(F, F.mT)
        one = torch.eye(3, dtype=F.dtype, device=F.device)
        minus = one[:, None, :, None] * right[..., None, :, None, :] + left[..., :, None, :, None] * one[:, None, :]
        minus = minus + F[..., :, None, None, :] * F.mT[..., None, :, :, None]
        D = D - 2 * w2[..., None] * minus.flatten(-4, -3).flatten(-2)
    return D


def clamped(D: Tensor, F: Tensor, projection: Projection) -> Tensor:
    """D (s, e, q, 9, 9) without negative eigenvalues: everywhere, or where strains are not small."""
    C = F.mT @ F - torch.eye(3, dtype=F.dtype, device=F.device)
    where = torch.ones_like(F[..., 0, 0], dtype=torch.bool)
    if projection is Projection.STRAINED:
        where = (C * C).sum((-2, -1)) > MILD**2
    out = D.clone()
    out[where] = torch.cat([_nearest(part) for part in D[where].nan_to_num().split(MOST)])
    return out


def _nearest(D: Tensor) -> Tensor:
    """Symmetric D (k, 9, 9) without negative eigenvalues."""
    size = D.abs().amax((1, 2), keepdim=True).clamp(min=1e-30)
    try:
        values, vectors = torch.linalg.eigh(D / size)
    except torch.linalg.LinAlgError:  # a GPU's iteration did not converge for one of them
        values, vectors = (part.to(D.device) for part in torch.linalg.eigh((D / size).cpu()))
    nearest: Tensor = size * ((vectors * values.clamp(min=0.0)[..., None, :]) @ vectors.mT)
    return nearest
