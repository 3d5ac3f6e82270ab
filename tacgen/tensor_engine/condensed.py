"""Tangents of many scenes condensed to each scene's own nodes in contact, and their factors kept in slots.

The fronts condense a batch to the patch, which is the same in all scenes. From there each scene's matrix is permuted so
that its own nodes come last, and the rest of the patch is eliminated in one padded batch of dense matrices.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from tacgen.tensor_engine.multifrontal import Multifrontal, invert_factor
from tacgen.tensor_engine.products import slot_times


class _Patch(NamedTuple):
    """The patch of each scene divided.

    order (s, k): its unknowns, of which the first `inner` (s, 1) are eliminated; outer (s, 3m): the condensed ones, k
    where padded; inverse (s, o, o) of the factor of the eliminated part, the unit matrix where padded; coupling
    (s, o, 3m): that times theirs to the condensed ones; S (s, 3m, 3m); definite (s,): whether there is that factor.
    """

    order: Tensor
    inner: Tensor
    outer: Tensor
    inverse: Tensor
    coupling: Tensor
    S: Tensor
    definite: Tensor


class Condensed:
    """Factors of `capacity` scenes of one pattern, each condensed to its own nodes on which contact acts.

    Slots (s,): the scenes' places. Nodes (s, m): numbers of the pattern's nodes, all in its patch, padded with -1.
    Condensed unknowns (s, 3m): theirs, in that order; 0 where padded. Element tangents (s, e, 24, 24) of the pattern's
    hexes, rows and columns in the order 3a + i, 0 for void cells. Results have the precision of the solver's factors.
    """

    def __init__(self, solver: Multifrontal, capacity: int) -> None:
        self.solver, self.dtype, self._panels = solver, solver.dtype, solver.empty(capacity)
        self._k = k = 3 * len(solver.patch)
        self._local = torch.full((solver.nodes + 1,), len(solver.patch), device=solver.device)
        self._local[solver.patch] = torch.arange(len(solver.patch), device=solver.device)
        self._order, self._outer = self._numbers(capacity, k), self._numbers(capacity, 0)
        self._inner = self._numbers(capacity, 1)
        self._inverse, self._coupling = self._zeros(capacity, k, k), self._zeros(capacity, k, 0)

    def reserve(self, nodes: int) -> bool:
        """Make room for couplings to so many nodes; whether tensors have moved for that."""
        more = 3 * nodes - int(self._outer.shape[1])
        if more > 0:
            self._outer = torch.nn.functional.pad(self._outer, (0, more), value=self._k)
            self._coupling = torch.nn.functional.pad(self._coupling, (0, more))
        return more > 0

    def factor(self, slots: Tensor, elements: Tensor, nodes: Tensor, fewest: int = 0) -> tuple[Tensor, Tensor]:
        """Factorise tangents, keep the factors in these slots, and return which are positive definite away from the
        condensed nodes (s,), and the Schur complements S (s, 3m, 3m), with the unit matrix where padded. fewest: nodes
        that each slot has at least."""
        found = self.solver.factor(self.solver.assembled(elements.to(self.solver.dtype)))
        patch = self._divided(found.S, nodes, fewest)
        for kept, new in zip(self._panels, found.panels, strict=True):
            kept.inverse[slots], kept.below[slots] = new.inverse, new.below
        o, width = patch.coupling.shape[1:]
        self._order[slots], self._inner[slots] = patch.order, patch.inner
        self._outer[slots] = torch.nn.functional.pad(patch.outer, (0, self._outer.shape[1] - width), value=self._k)
        self._inverse[slots] = torch.nn.functional.pad(patch.inverse, (0, self._k - o, 0, self._k - o))
        beyond = self._coupling.shape[2] - width
        self._coupling[slots] = torch.nn.functional.pad(patch.coupling, (0, beyond, 0, self._k - o))
        return patch.definite & ~found.indefinite, patch.S

    def schur(self, elements: Tensor, nodes: Tensor, fewest: int = 0) -> tuple[Tensor, Tensor]:
        """As `factor`, without keeping anything."""
        found = self.solver.factor(self.solver.assembled(elements.to(self.solver.dtype)))
        patch = self._divided(found.S, nodes, fewest)
        return patch.definite & ~found.indefinite, patch.S

    def forward(self, slots: Tensor, g: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
        """Forward substitution of vectors g (s, n, 3), for `expand`, and g condensed (s, 3 nodes), where no slot has
        more nodes: g_c - K_co K_oo^-1 g_o."""
        width = 3 * nodes
        y = self.solver.forward(self._panels, slots, g)
        b, outer = self._of_patch(y), self._outer[slots, :width]
        solved = slot_times(self._inverse, slots, b.gather(1, self._order[slots]) * self._first(slots))
        load = torch.nn.functional.pad(b, (0, 1)).gather(1, outer)
        load = load - slot_times(self._coupling[:, :, :width], slots, solved, True)
        load = torch.where(outer < self._k, load, 0.0)
        y[:, self.solver.patch] = solved.view(len(y), -1, 3)
        return y, load

    def expand(self, slots: Tensor, u: Tensor, y: Tensor) -> Tensor:
        """The step p (s, n, 3) of all nodes for u (s, 3m) of the condensed unknowns and the gradient g whose forward
        substitution is y: p_c = u, p_o = -K_oo^-1 (g_o + K_oc u); 0 at bonded and void nodes without a gradient."""
        solved, u = self._of_patch(y.to(self.solver.dtype)), u.to(self.solver.dtype)
        q = solved + slot_times(self._coupling[:, :, : u.shape[1]], slots, u)
        inner = -slot_times(self._inverse, slots, q, True)
        order = torch.where(self._first(slots) > 0, self._order[slots], self._k)
        x = self._zeros(len(u), self._k + 1)
        x.scatter_(1, order, inner).scatter_(1, self._outer[slots, : u.shape[1]], u)
        return self.solver.backward(self._panels, slots, -y, x[:, :-1])

    def _of_patch(self, y: Tensor) -> Tensor:
        return y[:, self.solver.patch].flatten(1)

    def _first(self, slots: Tensor) -> Tensor:
        """1 at the places (s, k) in the order of unknowns that are eliminated, else 0."""
        return (torch.arange(self._k, device=self.solver.device) < self._inner[slots]).to(self.solver.dtype)

    def _divided(self, S: Tensor, nodes: Tensor, fewest: int) -> _Patch:
        """The patch's stiffness S (s, k, k) condensed to nodes (s, m), at least `fewest` of each."""
        k, local = self._k, self._local[nodes]
        outer = torch.clamp(3 * local[:, :, None] + torch.arange(3, device=S.device), max=k).flatten(1)
        apart = torch.zeros((len(S), k + 1), dtype=torch.int8, device=S.device).scatter_(1, outer, 1)[:, :k]
        order, inner = torch.argsort(apart, dim=1, stable=True), k - apart.sum(1, dtype=torch.int64)
        o = k - 3 * fewest
        rows = torch.where(torch.arange(o, device=S.device) < inner[:, None], order[:, :o], k)
        inverse = _part(S, rows, rows, 1.0)
        info = invert_factor(inverse)
        coupling = inverse @ _part(S, rows, outer, 0.0)
        left = _part(S, outer, outer, 1.0) - coupling.mT @ coupling
        return _Patch(order, inner[:, None], outer, inverse, coupling, left, info == 0)

    def _numbers(self, *shape: int) -> Tensor:
        return torch.zeros(shape, dtype=torch.int64, device=self.solver.device)

    def _zeros(self, *shape: int) -> Tensor:
        return torch.zeros(shape, dtype=self.solver.dtype, device=self.solver.device)


def _part(S: Tensor, rows: Tensor, columns: Tensor, padding: float) -> Tensor:
    """S[b, rows[b]][:, columns[b]] of each scene b; where a number is that of no unknown, 0, and `padding` on the
    diagonal."""
    k = S.shape[-1]
    some = S.gather(1, rows.clamp(max=k - 1)[:, :, None].expand(-1, -1, k))
    some = some.gather(2, columns.clamp(max=k - 1)[:, None, :].expand(-1, rows.shape[1], -1))
    true = (rows < k)[:, :, None] & (columns < k)[:, None, :]
    pad = padding * torch.eye(*some.shape[1:], dtype=S.dtype, device=S.device)
    return torch.where(true, some, pad)
