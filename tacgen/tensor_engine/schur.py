"""Schur complements of many scenes, reduced to each scene's own unknowns in contact.

All have the same patch of the face. Contact acts on few of its unknowns, and on others in each scene. Each scene's
matrix is permuted so that its own come last, and the first ones, as many in every scene, are eliminated: a batch of
dense matrices of one size, whatever touches where. A scene with fewer unknowns in contact keeps some more.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from tacgen.mechanics.condensation import DAMPING_FACTOR, LEAST_DAMPING
from tacgen.tensor_engine.multifrontal import invert_factor

MULTIPLE = 16  # sizes of reduced matrices are multiples: fewer shapes for the allocator and the kernels


@dataclass(frozen=True)
class Reduced:
    """Schur complements S (B, k, k), damping included, from which all but `kept` (B, a) unknowns are eliminated.

    damping (B,) over the stiffness at rest [-]; dropped (B, o): the others; inverse (B, o, o) of the Cholesky factor of
    their stiffness; coupling (B, o, a): that inverse times their coupling to the kept ones; K (B, a, a): the stiffness
    that remains; place (B, k): each unknown's number among the kept ones, a if dropped; indefinite (B,) bool: scenes
    for which no damping up to the largest served.
    """

    S: Tensor
    damping: Tensor
    kept: Tensor
    dropped: Tensor
    inverse: Tensor
    coupling: Tensor
    K: Tensor
    place: Tensor
    indefinite: Tensor

    def times(self, u: Tensor) -> Tensor:
        """S u (B, k)."""
        return (self.S @ u[:, :, None].to(self.S.dtype)).squeeze(-1)

    def stiffness(self, blocks: Tensor, dofs: Tensor, apart: Sequence[Tensor]) -> Tensor:
        """K with blocks (B, f, d, d) of facets added (B, a, a), in the precision of the blocks.

        dofs (f, d): numbers of their unknowns, the same in all scenes; what a block has at a dropped unknown is left
        out. apart: the numbers of all facets in sets (see `colours`) within which no two share an unknown.
        """
        a = self.K.shape[-1]
        K = torch.nn.functional.pad(self.K, (0, 1, 0, 1)).to(blocks.dtype).reshape(len(blocks), -1)
        at = self.place[:, dofs]
        number = (at[:, :, :, None] * (a + 1) + at[:, :, None, :]).flatten(2)
        for which in apart:  # no two of them share an unknown: sums in an order that never changes
            some = number[:, which].flatten(1)
            K.scatter_(1, some, K.gather(1, some) + blocks[:, which].flatten(1))
        return K.view(-1, a + 1, a + 1)[:, :a, :a]

    def solve(self, K: Tensor, b: Tensor, symmetric: bool = False, rounds: int = 1) -> tuple[Tensor, Tensor]:
        """x (B, k) of (S + contact) x = b (B, k), where K (B, a, a) is the stiffness of both on the kept unknowns; and
        which scenes (B,) have no answer: K is singular or, if symmetric, not positive definite.

        K is factorised in the precision of S and the solution on the kept unknowns refined in that of K, `rounds`
        times.
        """
        low, high = self.S.dtype, K.dtype
        y = self.inverse @ _taken(b, self.dropped).to(low)
        right = _taken(b, self.kept).to(high) - (self.coupling.mT @ y).to(high)
        if symmetric:
            L, info = torch.linalg.cholesky_ex(K.to(low))
        else:
            L, pivots, info = torch.linalg.lu_factor_ex(K.to(low))

        def rough(r: Tensor) -> Tensor:
            r = r.to(low)
            return (torch.cholesky_solve(r, L) if symmetric else torch.linalg.lu_solve(L, pivots, r)).to(high)

        x = rough(right)
        for _ in range(rounds):
            x = x + rough(right - K @ x)
        rest = self.inverse.mT @ (y - self.coupling @ x.to(low))
        out = torch.empty_like(b, dtype=high)
        out.scatter_(1, self.kept, x.squeeze(-1))
        out.scatter_(1, self.dropped, rest.squeeze(-1).to(high))
        return out, (info > 0) | ~torch.isfinite(out).all(1)


def reduced(S: Tensor, rest: Tensor, damping: Tensor, active: Tensor, most: float = 1e4) -> Reduced:
    """Schur complements S + damping rest (B, k, k), reduced to unknowns that include the `active` (B, k) bool.

    Where the eliminated part is not positive definite, a scene's damping is increased until it is, as
    `condensation.Schur` does, or until it is larger than `most`.
    """
    k = S.shape[-1]
    a = min(k, -(-int(active.sum(1).max()) // MULTIPLE) * MULTIPLE)
    order = torch.argsort(active.to(torch.int8), dim=1, stable=True)
    dropped, kept = order[:, : k - a], order[:, k - a :]
    place = torch.full_like(order, a).scatter_(1, kept, torch.arange(a, device=S.device).expand(len(S), -1))
    damping = damping.clone()
    whole = S + damping[:, None, None].to(S.dtype) * rest
    parts = list(_eliminated(whole, dropped, kept))
    failed = parts.pop() > 0
    while (again := torch.nonzero(failed & (damping <= most)).ravel()).numel():
        damping[again] = torch.clamp(DAMPING_FACTOR * damping[again], min=LEAST_DAMPING)
        whole[again] = S[again] + damping[again, None, None].to(S.dtype) * rest[again]
        *some, info = _eliminated(whole[again], dropped[again], kept[again])
        for part, new in zip(parts, some, strict=True):
            part[again] = new
        failed[again] = info > 0
    inverse, coupling, K = parts
    return Reduced(whole, damping, kept, dropped, inverse, coupling, K, place, failed)


def colours(dofs: Tensor) -> list[Tensor]:
    """The numbers of facets with unknowns (f, d), in sets within which no two share one: greedy colouring."""
    taken: list[set[int]] = []
    sets: list[list[int]] = []
    for f, own in enumerate(dofs.tolist()):
        colour = next((c for c, used in enumerate(taken) if used.isdisjoint(own)), len(taken))
        if colour == len(taken):
            taken.append(set())
            sets.append([])
        taken[colour].update(own)
        sets[colour].append(f)
    return [torch.tensor(each, device=dofs.device) for each in sets]


def _eliminated(S: Tensor, dropped: Tensor, kept: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Inverse of the factor of the dropped part, its product with their coupling, what is left of the kept part, and
    the leading minor (B,) that is not positive."""
    inverse = _part(S, dropped, dropped)
    info = invert_factor(inverse) if dropped.shape[1] else torch.zeros(len(S), dtype=torch.int32, device=S.device)
    coupling = inverse @ _part(S, dropped, kept)
    return inverse, coupling, _part(S, kept, kept) - coupling.mT @ coupling, info


def _part(S: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """S[b, rows[b]][:, columns[b]] of each scene b."""
    some = S.gather(1, rows[:, :, None].expand(-1, -1, S.shape[2]))
    return some.gather(2, columns[:, None, :].expand(-1, rows.shape[1], -1))


def _taken(b: Tensor, which: Tensor) -> Tensor:
    """Columns (B, m, 1) of vectors b (B, k)."""
    return b.gather(1, which)[:, :, None]
