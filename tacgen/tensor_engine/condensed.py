"""Tangents of many scenes condensed to each scene's own nodes in contact, and their factors kept in slots.

The fronts condense a batch to the patch, which is the same in all scenes. From there each scene's matrix is permuted so
that its own nodes come last, and the rest of the patch is eliminated in one padded batch of dense matrices.
"""

import torch
from torch import Tensor

from tacgen.tensor_engine.multifrontal import Fronts, Multifrontal, Panel, eliminate
from tacgen.tensor_engine.products import slot_times


class Condensed:
    """Factors of `capacity` scenes of one pattern, each condensed to its own nodes on which contact acts.

    Slots (s,): the scenes' places. Nodes (s, m): numbers of the pattern's nodes, all in its patch, padded with -1.
    Condensed unknowns (s, 3m): theirs, in that order; 0 where padded. Element tangents (s, e, 24, 24) of the pattern's
    hexes, rows and columns in the order 3a + i, 0 for void cells. Results have the precision of the solver's factors.
    """

    def __init__(self, solver: Multifrontal, capacity: int) -> None:
        self.solver, self.dtype, self._panels = solver, solver.dtype, solver.empty(capacity)
        self._k = k = 3 * len(solver.patch)
        self._three = torch.arange(3, device=solver.device)
        self._whole = self._numbers(1, 1).int(), self._numbers(1, 1).int() + k
        self._local = torch.full((solver.nodes + 1,), len(solver.patch), device=solver.device)
        self._local[solver.patch] = torch.arange(len(solver.patch), device=solver.device)
        self._order, self._outer = self._numbers(capacity, k), self._numbers(capacity, 0)
        self._inverse, self._coupling = self._zeros(capacity, k, k), self._zeros(capacity, 0, k)

    def reserve(self, nodes: int) -> bool:
        """Make room for couplings to so many nodes; whether tensors have moved for that."""
        more = 3 * nodes - int(self._outer.shape[1])
        if more > 0:
            self._outer = torch.nn.functional.pad(self._outer, (0, more), value=self._k)
            self._coupling = torch.nn.functional.pad(self._coupling, (0, 0, 0, more))
        return more > 0

    def factor(self, slots: Tensor, elements: Tensor, nodes: Tensor, fewest: int = 0) -> tuple[Tensor, Tensor]:
        """Factorise tangents, keep the factors in these slots, and return which are positive definite away from the
        condensed nodes (s,), and the Schur complements S (s, 3m, 3m), with the unit matrix where padded. fewest: nodes
        that each slot has at least."""
        whole, bad = self.solver.factor(self.solver.assembled(elements.to(self.dtype)), self._panels, slots)
        S, info = self._divided(slots, whole, nodes, fewest)
        return ~bad & (info == 0), S

    def schur(self, elements: Tensor, nodes: Tensor, fewest: int = 0) -> tuple[Tensor, Tensor]:
        """As `factor`, without keeping anything."""
        alone = Condensed(self.solver, len(elements))
        alone.reserve(nodes.shape[1])
        return alone.factor(torch.arange(len(elements), device=elements.device), elements, nodes, fewest)

    def forward(self, slots: Tensor, g: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
        """Forward substitution of vectors g (s, n, 3), for `expand`, and g condensed (s, 3 nodes), where no slot has
        more nodes: g_c - K_co K_oo^-1 g_o."""
        width = 3 * nodes
        y = self.solver.forward(self._panels, slots, g)
        b = torch.nn.functional.pad(self._of_patch(y), (0, 1))
        solved = slot_times(self._inverse, slots, b.gather(1, self._order[slots]))
        load = b.gather(1, self._outer[slots, :width]) - slot_times(self._coupling[:, :width], slots, solved)
        y[:, self.solver.patch] = solved.view(len(y), -1, 3)
        return y, load

    def expand(self, slots: Tensor, u: Tensor, y: Tensor) -> Tensor:
        """The step p (s, n, 3) of all nodes for u (s, 3m) of the condensed unknowns and the gradient g whose forward
        substitution is y: p_c = u, p_o = -K_oo^-1 (g_o + K_oc u); 0 at bonded and void nodes without a gradient."""
        solved, u = self._of_patch(y.to(self.solver.dtype)), u.to(self.solver.dtype)
        q = solved + slot_times(self._coupling[:, : u.shape[1]], slots, u, True)
        inner = -slot_times(self._inverse, slots, q, True)
        x = self._zeros(len(u), self._k + 1)
        x.scatter_(1, self._order[slots], inner).scatter_(1, self._outer[slots, : u.shape[1]], u)
        return self.solver.backward(self._panels, slots, -y, x[:, :-1])

    def _of_patch(self, y: Tensor) -> Tensor:
        return y[:, self.solver.patch].flatten(1)

    def _divided(self, slots: Tensor, whole: Tensor, nodes: Tensor, fewest: int) -> tuple[Tensor, Tensor]:
        """The patch's stiffness (s, k, k) condensed to nodes (s, m), at least `fewest` of each, and kept: S (s, 3m, 3m)
        and leading minors (s,) that are not positive, 0 if all are. The patch is a front, in each scene's order."""
        p, local = self._k // 3, self._local[nodes]
        apart = torch.zeros((len(nodes), p + 1), dtype=torch.int8, device=nodes.device).scatter_(1, local, 1)[:, :p]
        order, inner = torch.argsort(apart, dim=1, stable=True), p - apart.sum(1, keepdim=True, dtype=torch.int64)
        order = torch.where(torch.arange(p, device=nodes.device) < inner, order, p)
        rows = torch.cat([order[:, : p - fewest], local], 1)
        rows = torch.where(rows < p, rows, -2)
        fronts = Fronts(rows[:, None, None].int(), *self._whole, None, p - fewest)
        S = whole.new_empty(len(nodes), 1, 3 * nodes.shape[1], 3 * nodes.shape[1])
        panel = Panel(self._inverse[:, None], self._coupling[:, None])
        info = eliminate(fronts, whole.new_empty(len(nodes), 0), whole.flatten(1), panel, slots, S, True)
        order, outer = (
            torch.clamp(3 * each[:, :, None] + self._three, max=self._k).flatten(1) for each in (order, local)
        )
        self._outer[slots] = torch.nn.functional.pad(outer, (0, self._outer.shape[1] - outer.shape[1]), value=self._k)
        self._order[slots] = order
        return S[:, 0], info[:, 0]

    def _numbers(self, *shape: int) -> Tensor:
        return torch.zeros(shape, dtype=torch.int64, device=self.solver.device)

    def _zeros(self, *shape: int) -> Tensor:
        return torch.zeros(shape, dtype=self.solver.dtype, device=self.solver.device)
