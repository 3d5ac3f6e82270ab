"""Cholesky factors of many matrices of one pattern at once: the multifrontal method, level by level of its tree.

A front is the dense matrix of the unknowns that it eliminates and of those on which they act (Duff & Reid 1983). Fronts
of a level are padded to one size, so that a level is a few batched products whatever the number of scenes. The factor's
diagonal blocks are kept as inverses: panels and solves are then products too, which a GPU does much faster than
substitutions. Their rounding errors are larger, by the condition of a diagonal block; a refinement removes them.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from tacgen.tensor_engine.dissection import Dissection, Group, Level
from tacgen.tensor_engine.products import slot_times

Array = np.ndarray
BASE = 64  # rows up to which a diagonal block is factorised by LAPACK or by one program; larger ones by halves
STRIP = 192  # columns of an update that are computed at once, from the diagonal down: a multiple of 3


@dataclass(frozen=True)
class _Numbers:
    """Numbers to be added to fronts: places (k,) `to` in the flat fronts, each once, and `at` in a flat source."""

    to: Tensor
    at: Tensor

    def add(self, front: Tensor, source: Tensor) -> None:
        """Add numbers of sources (B, size, ...) to fronts (B, size, ...)."""
        front[:, self.to] += source[:, self.at]


@dataclass(frozen=True)
class _Source:
    """One child of each of some fronts, those in one group of the level below: its number, the updates in the flat
    fronts, and those of vectors in the rows (t (w + m)) of fronts, from the group's rows (t m)."""

    group: int
    updates: _Numbers
    vectors: _Numbers


@dataclass(frozen=True)
class _Fronts:
    """Fronts (t, w own nodes, m others): the matrix's entries in them, and children; nodes own (t, w) and bound (t, m),
    the number of all nodes where padded."""

    entries: _Numbers
    sources: tuple[_Source, ...]
    own: Tensor
    bound: Tensor

    @property
    def sizes(self) -> tuple[int, int, int]:
        """t, and the rows 3w and 3m of unknowns."""
        (t, w), m = self.own.shape, self.bound.shape[1]
        return t, 3 * w, 3 * m


@dataclass(frozen=True)
class Panel:
    """The factors of a level: inverses of the diagonal blocks (B, t, 3w, 3w), and the blocks below (B, t, 3m, 3w)."""

    inverse: Tensor
    below: Tensor


class Multifrontal:
    """The solver of all matrices of one tree: index tensors on a device.

    dtype: of the factors; matrices and vectors are converted.
    """

    def __init__(self, tree: Dissection, device: str = "cpu", dtype: torch.dtype = torch.float32) -> None:
        self.tree, self.device, self.dtype = tree, torch.device(device), dtype
        self.nodes, self.patch = tree.pattern.size, self._index(tree.patch)
        entries = _Entries(tree)
        self.pairs = len(entries.row)
        self._rounds = [self._index(slots) for slots in entries.rounds]
        self._diagonal = self._index(entries.diagonal)
        patch = Group(np.zeros(1, int), tree.patch[None], np.zeros((1, 0), int))
        each = zip((*tree.levels, Level((patch,), 1)), (None, *tree.levels), strict=True)
        *self.levels, (self.root,) = (
            [self._fronts(group, level, below, entries) for group in level.groups] for level, below in each
        )

    def _index(self, numbers: Array) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(numbers), device=self.device)

    def _fronts(self, group: Group, level: Level, below: Level | None, entries: "_Entries") -> _Fronts:
        rows, w = np.concatenate([group.own, group.bound], 1), group.own.shape[1]
        number = entries.numbers(rows[:, :, None], group.own[:, None, :])
        number[:, :w][(group.own < 0)[:, :, None] & np.eye(w, dtype=bool)] = entries.unit
        front, row, column = np.nonzero(number >= 0)
        own, bound = (self._index(np.where(nodes < 0, self.nodes, nodes)) for nodes in (group.own, group.bound))
        sources = [
            self._source(rows, level.arity * group.fronts + c, k, each)
            for c in range(level.arity)
            for k, each in enumerate(below.groups if below else ())
            if np.isin(level.arity * group.fronts + c, each.fronts).any()
        ]
        to, at = _first(front, row, column, rows.shape[1]), 9 * number[front, row, column]
        return _Fronts(self._blocks(to, 3 * rows.shape[1], at, 3), tuple(sources), own, bound)

    def _source(self, rows: Array, child: Array, number: int, group: Group) -> _Source:
        """The children (t,) of fronts with rows of nodes (t, r) that are in a group of the level below."""
        at = np.searchsorted(group.fronts, child).clip(max=len(group.fronts) - 1)
        place = np.where((group.fronts[at] == child)[:, None], _places(rows, group.bound[at]), -1)
        w, m = group.own.shape[1], group.bound.shape[1]
        front, row = np.nonzero(place >= 0)
        vectors = front * rows.shape[1] + row, at[front] * m + place[front, row]
        inside = place >= 0
        front, row, column = np.nonzero(inside[:, :, None] & inside[:, None, :] & np.tri(rows.shape[1], dtype=bool))
        to = _first(front, row, column, rows.shape[1])
        source = _first(at[front], w + place[front, row], w + place[front, column], w + m)
        updates = self._blocks(to, 3 * rows.shape[1], source, 3 * (w + m))
        return _Source(number, updates, _Numbers(*map(self._index, vectors)))

    def _blocks(self, to: Array, rows: int, at: Array, source_rows: int) -> _Numbers:
        """The numbers of blocks that begin at `to` (k,) and `at`, where rows have so many numbers."""
        i, j = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
        each = (first[:, None] + length * i + j for first, length in ((to, rows), (at, source_rows)))
        return _Numbers(*(self._index(numbers.ravel()) for numbers in each))

    def assembled(self, elements: Tensor) -> Tensor:
        """The entries (B, pairs + 1, 9) of the matrices that are sums of the element tangents (B, e, 24, 24) of the
        pattern's hexes, rows and columns in the order 3a + i. Nodes without any stiffness get the unit matrix."""
        batch = len(elements)
        rows = elements.reshape(batch, -1, 3)
        data = elements.new_zeros((batch, self.pairs + 1, 9))
        for some in self._rounds:  # sums of up to 8 elements, in an order that never changes
            data[:, : len(some)] += rows[:, some].flatten(2)
        unit = torch.eye(3, dtype=data.dtype, device=self.device).reshape(9)
        own = data[:, self._diagonal]
        data[:, self._diagonal] = torch.where((own == 0).all(-1, keepdim=True), unit, own)
        data[:, -1] = unit
        return data

    def factor(self, data: Tensor) -> "Factor":
        """The factors of the matrices whose entries `assembled` gives."""
        data = data.to(self.dtype).reshape(len(data), -1)
        bad = torch.zeros(len(data), dtype=torch.int32, device=self.device)
        panels, below = list[Panel](), list[Tensor]()
        for level in self.levels:
            updates = []
            for fronts in level:
                panel, flat, info = self._eliminated(fronts, data, below)
                panels.append(panel)
                updates.append(flat)
                bad = torch.maximum(bad, info)
            below = updates
        S = self._assembled(self.root, data, below).view(len(data), 3 * len(self.patch), -1)
        return Factor(self, panels, torch.tril(S) + torch.tril(S, -1).mT, bad > 0)

    def _assembled(self, fronts: _Fronts, data: Tensor, below: list[Tensor]) -> Tensor:
        """The flat fronts before elimination, of the entries and the flat fronts of the level below; the lower triangle
        alone, but for the blocks on the diagonal."""
        t, w, m = fronts.sizes
        out = data.new_zeros((len(data), t * (w + m) ** 2))
        fronts.entries.add(out, data)
        for source in fronts.sources:
            source.updates.add(out, below[source.group])
        return out

    def _eliminated(self, fronts: _Fronts, data: Tensor, below: list[Tensor]) -> tuple[Panel, Tensor, Tensor]:
        """The factor of fronts, the flat fronts with updates, and the leading minors (B,) that are not positive."""
        batch, (t, w, m) = len(data), fronts.sizes
        flat = self._assembled(fronts, data, below)
        F = flat.view(batch * t, w + m, w + m)
        inverse = F[:, :w, :w].contiguous()
        info = invert_factor(inverse)
        L = _times_transposed(F[:, w:, :w], inverse)
        _subtract_square(F[:, w:, w:], L)
        return Panel(inverse.view(batch, t, w, w), L.view(batch, t, m, w)), flat, info.view(batch, t).amax(1)

    def empty(self, batch: int) -> list[Panel]:
        """Room for the panels of so many factors."""
        out = []
        for fronts in itertools.chain(*self.levels):
            t, w, m = fronts.sizes
            shapes = (batch, t, w, w), (batch, t, m, w)
            out.append(Panel(*(torch.zeros(shape, dtype=self.dtype, device=self.device) for shape in shapes)))
        return out

    def forward(self, panels: list[Panel], slots: Tensor, g: Tensor) -> Tensor:
        """L^-1 g of vectors (B, n, 3), and on the patch g condensed to it; 0 at bonded nodes. Their factors are those
        at `slots` (B,) of the panels."""
        b, each = self._padded(g), iter(panels)
        y, below = torch.zeros_like(b), list[Tensor]()
        for level in self.levels:
            updates = []
            for fronts in level:
                panel, (t, w, m) = next(each), fronts.sizes
                carried = _carried(fronts, below, b)
                own = (b[:, fronts.own] + carried[:, :, : w // 3]).view(-1, t, w)
                solved = slot_times(panel.inverse, slots, own)
                y[:, fronts.own.view(-1)] = solved.view(len(b), -1, 3)
                left = carried[:, :, w // 3 :] - slot_times(panel.below, slots, solved).view(-1, t, m // 3, 3)
                updates.append(left.flatten(1, 2))
            below = updates
        y[:, self.patch] = b[:, self.patch] + _carried(self.root, below, b)[:, 0]
        return y[:, :-1]

    def backward(self, panels: list[Panel], slots: Tensor, y: Tensor, u: Tensor) -> Tensor:
        """x (B, n, 3) with L^T x = y away from the patch and x = u (B, k) on it; 0 at bonded nodes."""
        y = self._padded(y)
        x = torch.zeros_like(y)
        x[:, self.patch] = u.to(self.dtype).view(len(y), -1, 3)
        for fronts, panel in zip([*itertools.chain(*self.levels)][::-1], panels[::-1], strict=True):
            t, w, m = fronts.sizes
            bound = x[:, fronts.bound].view(-1, t, m)
            q = y[:, fronts.own].view(-1, t, w) - slot_times(panel.below, slots, bound, True)
            x[:, fronts.own.view(-1)] = slot_times(panel.inverse, slots, q, True).view(len(y), -1, 3)
        return x[:, :-1]

    def _padded(self, x: Tensor) -> Tensor:
        """x (B, n, 3) with a 0 for padded nodes (B, n + 1, 3)."""
        return torch.nn.functional.pad(x.to(self.dtype), (0, 0, 0, 1))


@dataclass(frozen=True)
class Factor:
    """Matrices eliminated up to the patch: S (B, k, k) is their Schur complement on its nodes, k = 3 p, symmetric.

    indefinite (B,) bool: matrices that are not positive definite away from the patch; their numbers mean nothing.
    """

    of: Multifrontal
    panels: list[Panel]
    S: Tensor
    indefinite: Tensor

    def solve(self, b: Tensor, patch: Callable[[Tensor], Tensor]) -> Tensor:
        """x (B, n, 3) of K x = b, where `patch` solves S u = load for (B, k); 0 at bonded nodes."""
        slots = torch.arange(len(b), device=b.device)
        y = self.of.forward(self.panels, slots, b)
        return self.of.backward(self.panels, slots, y, patch(y[:, self.of.patch].flatten(1)))


def half(n: int) -> int:
    """Rows of the first of two parts of a matrix of n > BASE rows, of which all blocks but the last will have BASE."""
    return BASE * round(n / (2 * BASE) + 1e-9)


def invert_factor(A: Tensor) -> Tensor:
    """Overwrite symmetric matrices A (b, n, n), of which the lower triangle is read, by L^-1, where A = L L^T.

    Returns the leading minor (b,) that is not positive, 0 where the matrix is positive definite; where it is not,
    numbers mean nothing.
    """
    n = A.shape[-1]
    if n <= BASE and A.is_cuda and A.dtype == torch.float32:
        from tacgen.tensor_engine import gpu_blocks

        return gpu_blocks.lower_inverse(A)
    if n <= BASE:
        L, info = torch.linalg.cholesky_ex(A)
        A.copy_(torch.linalg.solve_triangular(L, torch.eye(n, dtype=A.dtype, device=A.device), upper=False))
        return info
    k = half(n)
    first, corner, low, last = A[:, :k, :k], A[:, :k, k:], A[:, k:, :k], A[:, k:, k:]
    info = invert_factor(first)
    L = low @ first.mT
    last.baddbmm_(L, L.mT, alpha=-1)
    info = torch.maximum(info, invert_factor(last))
    low.baddbmm_(last @ L, first, beta=0, alpha=-1)
    corner.zero_()
    return info


def _times_transposed(A: Tensor, L: Tensor) -> Tensor:
    """A L^T of A (b, m, w) and lower triangles L (b, w, w)."""
    w = L.shape[-1]
    if w <= STRIP:
        return A @ L.mT
    out = torch.empty_like(A)
    for at in range(0, w, STRIP):
        to = min(at + STRIP, w)
        out[:, :, at:to].baddbmm_(A[:, :, :to], L[:, at:to, :to].mT, beta=0)
    return out


def _subtract_square(U: Tensor, L: Tensor) -> None:
    """U[:, :m] -= L L^T from the diagonal down, of L (b, m, w)."""
    m = L.shape[1]
    for at in range(0, m, STRIP):
        to = min(at + STRIP, m)
        U[:, at:m, at:to].baddbmm_(L[:, at:], L[:, at:to].mT, alpha=-1)


def _carried(fronts: _Fronts, below: list[Tensor], b: Tensor) -> Tensor:
    """The sum (B, t, w + m, 3) that the children of fronts add to vectors like b, of the updates (B, rows, 3) of each
    group of the level below."""
    t, w, m = fronts.sizes
    out = b.new_zeros((len(b), t * (w + m) // 3, 3))
    for source in fronts.sources:
        source.vectors.add(out, below[source.group])
    return out.view(len(b), t, -1, 3)


def _places(rows: Array, bound: Array) -> Array:
    """Where each of the rows (t, r) of fronts stands among the nodes (t, m) that a child acts on; -1 if it does not."""
    place = np.full((len(rows), max(rows.max(initial=0), bound.max(initial=0)) + 2), -1)
    np.put_along_axis(place, bound, np.arange(bound.shape[1])[None], 1)
    place[:, -1] = -1  # padded nodes are number -1
    return np.take_along_axis(place, rows, 1)


def _first(front: Array, row: Array, column: Array, size: int) -> Array:
    """First numbers of blocks at rows and columns, in nodes, of flat fronts of `size` nodes."""
    return np.asarray((front * 3 * size + 3 * row) * 3 * size + 3 * column)


class _Entries:
    """The lower triangle of a matrix by pairs of nodes: its rows are eliminated no earlier than its columns.

    row, column (pairs,): nodes. unit: number of one more block. rounds: of the pairs that have one, the first,
    second... element that contributes, as numbers (pairs, 3) of its tangent's rows of three (e, 24, 8); pairs with most
    elements come first. diagonal: pairs of a node with itself.
    """

    def __init__(self, tree: Dissection) -> None:
        pattern, rank = tree.pattern, tree.rank
        hexes, n = pattern.hexes, pattern.size
        row, column = np.repeat(hexes, 8, axis=1).ravel(), np.tile(hexes, 8).ravel()
        slots = np.flatnonzero((rank[column] >= 0) & (rank[row] >= rank[column]))
        keys, which, count = np.unique(row[slots] * n + column[slots], return_inverse=True, return_counts=True)
        order = np.argsort(-count, kind="stable")
        self._n, self._rank, self._keys, self._number = n, rank, keys, np.argsort(order)
        self.row, self.column = keys[order] // n, keys[order] % n
        self.unit = len(keys)
        by_pair, most = slots[np.argsort(which, kind="stable")], count[order]
        starts = (np.cumsum(count) - count)[order]
        blocks = [by_pair[starts[most > k] + k] for k in range(most.max())]  # numbers of (e, 8, 8)
        self.rounds = [(at // 8 * 24 + at % 8)[:, None] + 8 * np.arange(3) for at in blocks]
        self.diagonal = np.flatnonzero(self.row == self.column)

    def numbers(self, row: Array, column: Array) -> Array:
        """Numbers of the pairs of these nodes, which broadcast; -1 where there is none, or a node is -1."""
        key = row * self._n + column
        at = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
        return np.where((self._keys[at] == key) & (row >= 0) & (column >= 0), self._number[at], -1)
