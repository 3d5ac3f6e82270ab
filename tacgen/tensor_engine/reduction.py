"""Schur complements of many scenes, with the unknowns on which contact does not act eliminated once.

As mechanics.condensation.Schur: the eliminated part must be positive definite. Each scene has unknowns of its own in
contact, and as many of both kinds as the scene with most of them has, by padding.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from tacgen.physics import facets, steps
from tacgen.physics.runtime import lanes, launch
from tacgen.tensor_engine.dense import Own, eliminate, invert_factor
from tacgen.tensor_engine.products import Used, slot_times
from tacgen.tensor_engine.replay import rare

# Largest residual of a solution without pivots, over the largest entry of the right-hand side: a forcing term of an
# inexact Newton method (Dembo, Eisenstat & Steihaug 1982). Of ordinary scenes' systems half stay below 3e-6, 99.9 % are
# below 5e-3; beyond, pivots are chosen
MAX_UNPIVOTED_RESIDUAL = 1e-2
PADDING_PLACE = -(2**31)  # the place of padding
ROW_ALIGNMENT = 4  # numbers at whose multiples rows of a system start, for the library's products
THREADS_PER_ROW = 32  # of a matrix, on a GPU: those of a warp read what is next to each other


@dataclass(frozen=True)
class Reduction:
    """For Schur complements (s, k, k): numbers of the unknowns that are kept (s, a) and of those that are eliminated
    (s, e), -1 where padded, and `place` (s, k) of each: its row among the kept ones, or -1 - its row among the others.
    At their slots (s,): the inverse G (capacity, e, e) of the eliminated part, X = G S on the kept columns (capacity,
    e, a), and K (capacity, a, a), the stiffness on the kept unknowns, the unit matrix where padded; used: numbers of
    unknowns (capacity,) that are eliminated and that are kept."""

    kept: Tensor
    lost: Tensor
    place: Tensor
    G: Tensor
    X: Tensor
    K: Tensor
    slots: Tensor
    used: Used

    def solve(self, K: Tensor, b: Tensor, symmetric: bool) -> tuple[Tensor, Tensor]:
        """x (s, k) of (S + contact) x = b (s, k), with K (s, a, a) of both on the kept unknowns, and which exist (s,):
        K is not singular or, if symmetric, is positive definite."""
        small, slots = b.to(K.dtype), self.slots
        lost, used = _picked(small, self.lost), self.used
        rest = _picked(small, self.kept, slot_times(self.X, slots, lost, True, used))
        x, good = solved(K, rest[..., None], symmetric, (used[1], slots))
        x = x.squeeze(-1)
        G = slot_times(self.G, slots, lost, used=(used[0], used[0]))
        X = slot_times(self.X, slots, x, used=used)
        out, exists, step = b.new_empty(self.place.shape), torch.empty_like(good), lanes(b)
        launch(steps.JOINED[x.element_size()], (len(b), step), G, X, x, self.place, good, step, out, exists)
        return out, exists


def _picked(b: Tensor, at: Tensor, less: Tensor | None = None) -> Tensor:
    """b (s, k) at the unknowns (s, a), 0 where -1, less what is given (s, a)."""
    out = b.new_empty(at.shape)
    launch(steps.PICKED[b.element_size()], at.shape, b, at, less, out)
    return out


def solved(K: Tensor, b: Tensor, symmetric: bool = False, own: Own | None = None) -> tuple[Tensor, Tensor]:
    """x (s, a, 1) of K x = b, and which K (s, a, a) are regular or, if symmetric, positive definite. own: see
    dense.eliminate. Pivots are chosen only where a step of Newton's method needs them."""
    n = K.shape[1]
    if not n:  # nothing touches
        return b, torch.ones(len(K), dtype=torch.bool, device=K.device)
    W = K.new_empty(len(K), n, n // ROW_ALIGNMENT * ROW_ALIGNMENT + 2 * ROW_ALIGNMENT)[..., : n + 1]
    W[..., :n], W[..., n:] = K, b
    positive, x = eliminate(W, n, own), W[..., n:].contiguous()
    if symmetric:
        return x, positive
    good = _exact(b, K @ x)
    if rare(~good):  # not a number is not small
        bad = torch.nonzero(~good).squeeze(1)
        LU, pivots, info = torch.linalg.lu_factor_ex(K[bad].double())
        x[bad], good[bad] = torch.linalg.lu_solve(LU, pivots, b[bad].double()).to(x.dtype), info == 0
    return x, good


def _exact(b: Tensor, product: Tensor) -> Tensor:
    """Whether right-hand sides b (s, a, 1) and those of solutions are equal enough (s,)."""
    good, step = torch.empty(len(b), dtype=torch.bool, device=b.device), lanes(b)
    launch(
        steps.EXACT[b.element_size()], (len(b), step), b.squeeze(-1), product.squeeze(-1), MAX_UNPIVOTED_RESIDUAL, step,
        good,
    )  # fmt: skip
    return good


def reduced(S: Tensor, active: Tensor, exists: Tensor, a: int, e: int) -> tuple[Reduction, Tensor]:
    """S (s, k, k) reduced to the `active` unknowns (s, k) bool of those that exist (s, k), of which there are at most
    `a`, and at most `e` others; and where what is eliminated is positive definite."""
    others = exists & ~active
    kept, lost = numbered(active, a), numbered(others, e)
    place = torch.where(
        active, active.long().cumsum(1) - 1, torch.where(others, -others.long().cumsum(1), PADDING_PLACE)
    )
    order = torch.cat([lost, kept], 1)
    at, padded = order.clamp(min=0), order < 0
    M = S.gather(1, at[:, :, None].expand(-1, -1, S.shape[1])).gather(2, at[:, None, :].expand(-1, e + a, -1))
    M = torch.where(padded[:, :, None] | padded[:, None, :], torch.diag_embed(padded.to(S.dtype)), M)
    L, beside = M[:, :e, :e], M[:, :e, e:]
    info = invert_factor(L)
    G = L.mT @ L
    X = G @ beside
    K = torch.baddbmm(M[:, e:, e:], beside.mT, X, alpha=-1)
    slots, used = torch.arange(len(S), device=S.device), (others.sum(1), active.sum(1))
    return Reduction(kept, lost, place, G, X, K, slots, used), info == 0


def numbered(marked: Tensor, most: int) -> Tensor:
    """Numbers (s, most) of what is marked (s, k), in order, padded with -1."""
    order = torch.argsort((~marked).to(torch.int8), dim=1, stable=True)[:, :most]
    order = torch.nn.functional.pad(order, (0, most - order.shape[1]))
    return torch.where(torch.arange(most, device=marked.device) < marked.sum(1, keepdim=True), order, -1)


def with_points(
    K: Tensor, slots: Tensor, kept: Tensor, place: Tensor, conn: Tensor, ends: Tensor, N: Tensor, D: Tensor
) -> Tensor:
    """Rows at slots (s,) of K (capacity, a, a) plus stiffnesses D (s, f, q, 3, 3) at the points N (q, 4) of facets conn
    (s, f, 4); kept (s, a) and place (s, k): the unknown 3 node + direction of each row of K, -1 if none, and the row of
    each unknown, negative where D does not act; ends: see contact.Contacts."""
    out, step = K.new_empty(*kept.shape, kept.shape[1]), lanes(K, THREADS_PER_ROW)
    launch(
        facets.WITH_POINTS[K.element_size()], (*kept.shape, step), K, slots, kept, place, conn, ends, N, D.flatten(-2),
        step, out,
    )  # fmt: skip
    return out
