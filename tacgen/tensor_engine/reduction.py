"""Schur complements of many scenes, with the unknowns on which contact does not act eliminated once.

As mechanics.condensation.Schur: the eliminated part must be positive definite. Each scene has unknowns of its own in
contact; nothing is permuted, so that scenes with more and with fewer go together: what is eliminated keeps its place.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine.multifrontal import BASE, half, invert_factor
from tacgen.tensor_engine.products import slot_times
from tacgen.tensor_engine.replay import rare

EXACT = 1e-3  # largest residual of a solution without pivots, over the largest entry of the right-hand side [-]


@dataclass(frozen=True)
class Reduction:
    """For Schur complements (s, k, k): numbers (s, a) of the unknowns that are kept, -1 where padded, and `place`
    (s, k) of each among them, -1 if eliminated. At their slots (s,): the inverse G (capacity, k, k) of the eliminated
    part, 0 elsewhere, X = G S on the kept columns (capacity, k, a), and K (capacity, a, a), the stiffness on the kept
    unknowns, the unit matrix where padded."""

    kept: Tensor
    place: Tensor
    G: Tensor
    X: Tensor
    K: Tensor
    slots: Tensor

    def solve(self, K: Tensor, b: Tensor, symmetric: bool) -> tuple[Tensor, Tensor]:
        """x (s, k) of (S + contact) x = b (s, k), with K (s, a, a) of both on the kept unknowns, and which exist (s,):
        K is not singular or, if symmetric, is positive definite."""
        to, b, slots = b.dtype, b.to(K.dtype), self.slots
        x, good = (solved_by_root if symmetric else solved)(K, self._right(b)[..., None])
        x = x.squeeze(-1)
        G, X = slot_times(self.G, slots, b), slot_times(self.X, slots, x)
        if devices.by_kernels(b):
            from tacgen.tensor_engine import gpu_steps

            return gpu_steps.joined(G, X, x, self.place, good, to)
        out = torch.where(self.place < 0, G - X, _padded(x).gather(1, self.place % (x.shape[1] + 1)))
        good = good & torch.isfinite(out).all(1)
        return torch.where(good[:, None], out, 0.0).to(to), good

    def _right(self, b: Tensor) -> Tensor:
        """b (s, k) on the kept unknowns (s, a), with the eliminated ones' part."""
        beside = slot_times(self.X, self.slots, b, True)
        if devices.by_kernels(b):
            from tacgen.tensor_engine import gpu_steps

            return gpu_steps.right(b, self.kept, beside)
        return _padded(b).gather(1, self.kept % (b.shape[1] + 1)) - beside


def solved_by_root(K: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """x (s, a, 1) of K x = b, and which K (s, a, a) are positive definite."""
    inverse = K.clone()
    info = invert_factor(inverse)
    return inverse.mT @ (inverse @ b), info == 0


def solved(K: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """x (s, a, 1) of K x = b, and which K (s, a, a) are regular: by LU with pivots, or on a GPU as below."""
    if K.is_cuda and K.dtype == torch.float32:
        return solved_by_inverse(K, b)
    LU, pivots, info = torch.linalg.lu_factor_ex(K)
    return torch.linalg.lu_solve(LU, pivots, b), info == 0


def solved_by_inverse(K: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """As `solved`, by the inverse without pivots, refined once, where that is exact enough for a step of Newton's
    method: much faster on a GPU."""
    if not K.shape[1]:  # nothing touches
        return b, torch.ones(len(K), dtype=torch.bool, device=K.device)
    inverse = K.clone()
    invert(inverse)
    x = inverse @ b
    x = x + inverse @ (b - K @ x)
    good = _exact(b, K @ x)
    if rare(~good):  # not a number is not small
        bad = torch.nonzero(~good).squeeze(1)
        some, regular = solved(K[bad].double(), b[bad].double())
        x[bad], good[bad] = some.to(x.dtype), regular
    return x, good


def _exact(b: Tensor, product: Tensor) -> Tensor:
    """Whether right-hand sides b (s, a, 1) and those of solutions are equal enough (s,)."""
    if devices.by_kernels(b):
        from tacgen.tensor_engine import gpu_steps

        return gpu_steps.exact(b, product, EXACT)
    return (b - product).abs().amax((1, 2)) <= EXACT * b.abs().amax((1, 2))


def invert(A: Tensor) -> None:
    """Overwrite matrices A (s, n, n) by their inverses, in products of blocks without pivots, which a GPU does much
    faster than LU; numbers mean nothing where a block is singular."""
    n = A.shape[-1]
    if n <= BASE and A.is_cuda and A.dtype == torch.float32:
        from tacgen.tensor_engine import gpu_blocks

        return gpu_blocks.inverse(A)
    if n <= BASE:
        A.copy_(torch.linalg.inv_ex(A)[0])
        return None
    k = half(n)
    P, Q, R, T = A[:, :k, :k], A[:, :k, k:], A[:, k:, :k], A[:, k:, k:]
    invert(P)
    below, beside = R @ P, P @ Q
    T.baddbmm_(below, Q, alpha=-1)
    invert(T)
    R.baddbmm_(T, below, beta=0, alpha=-1)
    P.baddbmm_(beside, R, alpha=-1)
    Q.baddbmm_(beside, T, beta=0, alpha=-1)
    return None


def _padded(b: Tensor) -> Tensor:
    return torch.nn.functional.pad(b, (0, 1))


def reduced(S: Tensor, active: Tensor, a: int) -> tuple[Reduction, Tensor]:
    """S (s, k, k) reduced to the `active` unknowns (s, k) bool, of which there are at most `a`, and where what is
    eliminated is positive definite."""
    k = active.shape[1]
    count = active.sum(1)
    order = torch.argsort((~active).to(torch.int8), dim=1, stable=True)[:, :a]
    kept = torch.where(torch.arange(a, device=S.device) < count[:, None], order, -1)
    place = torch.where(active, active.long().cumsum(1) - 1, -1)
    both = active[:, :, None] | active[:, None, :]
    L = torch.where(both, torch.eye(k, dtype=S.dtype, device=S.device), S)
    info = invert_factor(L)
    G = torch.where(both, 0.0, L.mT @ L)
    known = kept % (k + 1)  # the padding is the last
    right = torch.nn.functional.pad(S, (0, 1)).gather(2, known[:, None, :].expand(-1, k, -1))
    X = G @ right
    rows = known[..., None].expand(-1, -1, a)
    K = torch.nn.functional.pad(right - S @ X, (0, 0, 0, 1)).gather(1, rows)
    pad = (kept < 0).to(S.dtype)
    slots = torch.arange(len(S), device=S.device)
    return Reduction(kept, place, G, X, K + torch.diag_embed(pad), slots), info == 0


def with_points(
    K: Tensor, slots: Tensor, kept: Tensor, place: Tensor, conn: Tensor, ends: Tensor | None, N: Tensor, D: Tensor
) -> Tensor:
    """Rows at slots (s,) of K (capacity, a, a) plus stiffnesses D (s, f, q, 3, 3) at the points N (q, 4) of facets conn
    (s, f, 4); kept (s, a) and place (s, k): the unknown 3 node + direction of each row of K, -1 if none, and the row of
    each unknown, -1 where D does not act; ends: see contact.Contacts.

    Corner by corner: on a grid a node is a certain corner of one facet only, so the order of summation never changes.
    """
    if ends is not None:
        from tacgen.tensor_engine import gpu_facets

        return gpu_facets.with_points(K, slots, kept, place, conn, ends, N, D)
    (s, a), N, D = kept.shape, N.to(K.dtype), D.to(K.dtype)
    pairs = (N[:, :, None] * N[:, None, :]).flatten(1).T
    blocks = (pairs @ D.flatten(-2)).view(s, -1, 4, 4, 3, 3)
    unknowns = (3 * conn[..., None] + torch.arange(3, device=K.device)).flatten(1)
    at = (place % (a + 1)).gather(1, unknowns).view(s, -1, 4, 3).transpose(1, 2)
    index = at[:, :, :, None, :, None] * (a + 1) + at.transpose(1, 2)[:, None, :, :, None, :]
    out = torch.nn.functional.pad(K[slots], (0, 1, 0, 1)).flatten(1)
    for corner in range(4):
        out.scatter_add_(1, index[:, corner].flatten(1), blocks[:, :, corner].flatten(1))
    return out.view(s, a + 1, a + 1)[:, :a, :a]
