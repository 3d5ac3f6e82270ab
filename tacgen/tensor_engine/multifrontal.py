"""Cholesky factors of many matrices of one pattern at once: the multifrontal method, level by level of its tree.

A front is the dense matrix of the unknowns that it eliminates and of those on which they act (Duff & Reid 1983). Fronts
of a level are padded to one size, so that a level is a few batched products whatever the number of scenes. The factor's
diagonal blocks are kept as inverses: panels and solves are then products too, which a GPU does much faster than
substitutions. Their rounding errors are larger, by the condition of a diagonal block; `refined` removes them.

Indices count nodes: a 3 x 3 block has one index, which keeps index traffic a ninth of the data's.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from tacgen.tensor_engine.dissection import Dissection, Level

Array = np.ndarray
BASE = 72  # rows up to which a diagonal block is factorised by LAPACK or its like; larger ones by halves
STRIP = 192  # columns of an update that are computed at once, from the diagonal down: a multiple of 3


@dataclass(frozen=True)
class _Fronts:
    """Where a level's fronts (t, w own nodes, m others) take their blocks from: numbers of entries (t, w + m, w) of the
    matrix; first numbers of blocks (t, w + m + 1, w + m) in the update of each child, the last row of them zeros; rows
    (t, w + m) of a vector's update from each child, -1 for none; nodes own (t, w) and bound (t, m), the number of all
    nodes where padded."""

    entry: Tensor
    children: tuple[Tensor, ...]
    rows: tuple[Tensor, ...]
    own: Tensor
    bound: Tensor


@dataclass(frozen=True)
class Panel:
    """The factors of a level: inverses of the diagonal blocks (B, t, 3w, 3w), and the blocks below (B, t, 3m, 3w)."""

    inverse: Tensor
    below: Tensor

    def at(self, slots: Tensor | None) -> tuple[Tensor, Tensor]:
        """Both, of some of the batch."""
        return (self.inverse, self.below) if slots is None else (self.inverse[slots], self.below[slots])


class Multifrontal:
    """What all factors of one tree share: index tensors on a device.

    dtype: of the factors; matrices and vectors are converted. compiled: whether fronts are gathered by a compiled
    kernel on a GPU, which reads and writes every number once.
    """

    def __init__(
        self, tree: Dissection, device: str = "cpu", dtype: torch.dtype = torch.float32, compiled: bool = True
    ) -> None:
        self.tree, self.device, self.dtype = tree, torch.device(device), dtype
        self.nodes, self.patch = tree.pattern.size, self._index(tree.patch)
        entries = _Entries(tree)
        self.pairs = len(entries.row)
        self._rounds = [self._index(slots) for slots in entries.rounds]
        self._diagonal = self._index(entries.diagonal)
        self._neighbours = [tuple(self._index(a) for a in each) for each in entries.neighbours]
        root = Level(tree.patch[None], np.zeros((1, 0), int), 1)
        each = zip((*tree.levels, root), (None, *tree.levels), strict=True)
        *self.levels, self.root = (self._fronts(level, below, entries) for level, below in each)
        kernel = torch.compile(_gathered, dynamic=True) if compiled and self.device.type == "cuda" else _gathered
        self._gather: Callable[..., Tensor] = kernel

    def _index(self, numbers: Array) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(numbers), device=self.device)

    def _fronts(self, level: Level, below: Level | None, entries: "_Entries") -> _Fronts:
        rows = np.concatenate([level.own, level.bound], 1)
        entry = entries.numbers(rows[:, :, None], level.own[:, None, :])
        w = level.own.shape[1]
        pad, eye = level.own < 0, np.eye(w, dtype=bool)
        entry[:, :w][pad[:, :, None] & eye] = entries.unit
        places = [] if below is None else [_places(rows, below.bound[c :: level.arity]) for c in range(level.arity)]
        own, bound = (self._index(np.where(nodes < 0, self.nodes, nodes)) for nodes in (level.own, level.bound))
        first, at = [], []
        for c, place in enumerate(places):
            m = below.bound.shape[1] if below else 0
            child = level.arity * np.arange(len(place)) + c
            first.append(self._index(_first(place, child, m).astype(np.int32)))
            at.append(self._index(np.where(place < 0, -1, child[:, None] * m + place)))
        return _Fronts(self._index(entry.astype(np.int32)), tuple(first), tuple(at), own, bound)

    def assembled(self, elements: Tensor) -> Tensor:
        """The entries (B, pairs + 2, 9) of the matrices that are sums of the element tangents (B, e, 24, 24) of the
        pattern's hexes, rows and columns in the order 3a + i. Nodes without any stiffness get the unit matrix."""
        batch = len(elements)
        rows = elements.reshape(batch, -1, 3)
        data = elements.new_zeros((batch, self.pairs + 2, 9))
        for some in self._rounds:  # sums of up to 8 elements, in an order that never changes
            data[:, : len(some)] += rows[:, some].flatten(2)
        unit = torch.eye(3, dtype=data.dtype, device=self.device).reshape(9)
        own = data[:, self._diagonal]
        data[:, self._diagonal] = torch.where((own == 0).all(-1, keepdim=True), unit, own)
        data[:, -1] = unit
        return data

    def product(self, data: Tensor, x: Tensor) -> Tensor:
        """The matrices times x (B, n, 3), in the precision of both; 0 at bonded nodes."""
        blocks, out = data.reshape(len(data), -1, 3, 3), torch.zeros_like(x)
        for at, near, entry, turned in self._neighbours:
            block = blocks[:, entry]
            block = torch.where(turned[:, None, None], block.mT, block)
            out[:, at] += (block @ x[:, near, :, None]).squeeze(-1)
        return out

    def factor(self, data: Tensor) -> "Factor":
        """The factors of the matrices whose entries `assembled` gives."""
        batch = len(data)
        data = data.to(self.dtype).reshape(batch, -1)
        panels, update, bad = [], data[:, :0], torch.zeros(batch, dtype=torch.int32, device=self.device)
        for fronts in self.levels:
            (t, w), m = fronts.own.shape, fronts.bound.shape[1]
            stride = _stride(update, fronts)
            entry, children = fronts.entry, fronts.children
            A = self._gather(data, entry[:, :w], update, [c[:, :w, :w] for c in children], stride)
            below = self._gather(data, entry[:, w:], update, [c[:, w:-1, :w] for c in children], stride)
            A, below = A.reshape(batch * t, 3 * w, 3 * w), below.reshape(batch * t, 3 * m, 3 * w)
            failed = invert_factor(A)
            bad = torch.maximum(bad, failed.reshape(batch, t).amax(1))
            below = below @ A.mT
            if children:
                U = self._gather(None, None, update, [c[:, w:, w:] for c in children], stride)
            else:
                U = below.new_zeros((batch, t, 3 * m + 3, 3 * m))
            _subtract_square(U.view(batch * t, 3 * m + 3, 3 * m), below)
            update = U
            panels.append(Panel(A.view(batch, t, 3 * w, 3 * w), below.view(batch, t, 3 * m, 3 * w)))
        root = self.root
        k = root.own.shape[1]
        S = self._gather(data, root.entry, update, [c[:, :k, :k] for c in root.children], _stride(update, root))[:, 0]
        return Factor(self, panels, torch.tril(S) + torch.tril(S, -1).mT, bad > 0)

    def empty(self, batch: int) -> list[Panel]:
        """Room for the panels of so many factors."""
        out = []
        for fronts in self.levels:
            (t, w), m = fronts.own.shape, fronts.bound.shape[1]
            shapes = (batch, t, 3 * w, 3 * w), (batch, t, 3 * m, 3 * w)
            out.append(Panel(*(torch.zeros(shape, dtype=self.dtype, device=self.device) for shape in shapes)))
        return out

    def forward(self, panels: list[Panel], g: Tensor, slots: Tensor | None = None) -> Tensor:
        """L^-1 g of vectors (B, n, 3), and on the patch g condensed to it; 0 at bonded nodes. Their factors are the
        batch of the panels or those at `slots` (B,) of it."""
        b, batch = self._padded(g), len(g)
        y, update = torch.zeros_like(b), b[:, :0]
        for fronts, panel in zip(self.levels, panels, strict=True):
            (t, w), m = fronts.own.shape, fronts.bound.shape[1]
            inverse, below = panel.at(slots)
            carried = _carried(update, fronts)
            solved = inverse @ (b[:, fronts.own] + carried[:, :, :w]).view(batch, t, 3 * w, 1)
            y[:, fronts.own.view(-1)] = solved.view(batch, t * w, 3)
            update = carried[:, :, w:] - (below @ solved).view(batch, t, m, 3)
        y[:, self.patch] = b[:, self.patch] + _carried(update, self.root)[:, 0]
        return y[:, :-1]

    def backward(self, panels: list[Panel], y: Tensor, u: Tensor, slots: Tensor | None = None) -> Tensor:
        """x (B, n, 3) with L^T x = y away from the patch and x = u (B, k) on it; 0 at bonded nodes."""
        y, batch = self._padded(y), len(y)
        x = torch.zeros_like(y)
        x[:, self.patch] = u.to(self.dtype).view(batch, -1, 3)
        for fronts, panel in zip(self.levels[::-1], panels[::-1], strict=True):
            t, w = fronts.own.shape
            inverse, below = panel.at(slots)
            bound = x[:, fronts.bound].view(batch, t, -1, 1)
            q = y[:, fronts.own].view(batch, t, 3 * w, 1) - below.mT @ bound
            x[:, fronts.own.view(-1)] = (inverse.mT @ q).view(batch, t * w, 3)
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
        y = self.of.forward(self.panels, b)
        return self.of.backward(self.panels, y, patch(y[:, self.of.patch].flatten(1)))


def refined(solve: Callable[[Tensor], Tensor], product: Callable[[Tensor], Tensor], b: Tensor, rounds: int) -> Tensor:
    """x with K x = b by iterative refinement (Wilkinson 1963): `solve` is approximate, `product` gives K x in the
    precision of b (B, n, 3), in which x is returned."""
    x = solve(b).to(b.dtype)
    for _ in range(rounds):
        x = x + solve(b - product(x)).to(b.dtype)
    return x


def invert_factor(A: Tensor) -> Tensor:
    """Overwrite symmetric matrices A (b, n, n), of which the lower triangle is read, by L^-1, where A = L L^T.

    Returns the leading minor (b,) that is not positive, 0 where the matrix is positive definite; where it is not,
    numbers mean nothing.
    """
    n = A.shape[-1]
    if n <= BASE:
        L, info = torch.linalg.cholesky_ex(A)
        A.copy_(torch.linalg.solve_triangular(L, torch.eye(n, dtype=A.dtype, device=A.device), upper=False))
        return info
    k = n // 2
    first, corner, low, last = A[:, :k, :k], A[:, :k, k:], A[:, k:, :k], A[:, k:, k:]
    info = invert_factor(first)
    L = low @ first.mT
    last.baddbmm_(L, L.mT, alpha=-1)
    info = torch.maximum(info, invert_factor(last))
    low.copy_((last @ L) @ first).neg_()
    corner.zero_()
    return info


def _subtract_square(U: Tensor, L: Tensor) -> None:
    """U[:, :m] -= L L^T from the diagonal down, of L (b, m, w)."""
    m = L.shape[1]
    for at in range(0, m, STRIP):
        to = min(at + STRIP, m)
        U[:, at:m, at:to].baddbmm_(L[:, at:], L[:, at:to].mT, alpha=-1)


def _gathered(data: Tensor | None, entry: Tensor | None, update: Tensor, children: list[Tensor], stride: int) -> Tensor:
    """Matrices (B, t, 3r, 3c) of 3 x 3 blocks: those at `entry` (t, r, c) in the entries, and of each child those that
    begin at (t, r, c) in its update, whose rows are `stride` numbers apart."""
    some = children[0] if entry is None else entry
    t, r, c = some.shape
    i = torch.arange(3, dtype=torch.int32, device=some.device)[:, None, None]
    j = torch.arange(3, dtype=torch.int32, device=some.device)
    flat = update.reshape(len(update), -1)
    parts = [flat[:, first[:, :, None, :, None] + (stride * i + j)] for first in children]
    if data is not None and entry is not None:
        parts.append(data[:, 9 * entry[:, :, None, :, None] + (3 * i + j)])
    out = parts[0]
    for part in parts[1:]:
        out = out + part
    return out.reshape(len(out), t, 3 * r, 3 * c)


def _stride(update: Tensor, fronts: _Fronts) -> int:
    return update.shape[-1] if fronts.children else 0


def _carried(update: Tensor, fronts: _Fronts) -> Tensor:
    """What the children of each front add to a vector (B, t, w + m, 3), of their updates (B, children, m, 3)."""
    batch, t, r = len(update), len(fronts.own), fronts.own.shape[1] + fronts.bound.shape[1]
    if not fronts.rows:
        return update.new_zeros((batch, t, r, 3))
    padded = torch.cat([update.reshape(batch, -1, 3), update.new_zeros((batch, 1, 3))], 1)
    return torch.stack([padded[:, rows] for rows in fronts.rows]).sum(0)


def _places(rows: Array, bound: Array) -> Array:
    """Where each of the rows (t, r) of fronts stands among the nodes (t, m) that a child acts on; -1 if it does not."""
    place = np.full((len(rows), max(rows.max(), bound.max(initial=0)) + 2), -1)
    np.put_along_axis(place, bound, np.arange(bound.shape[1])[None], 1)
    place[:, -1] = -1  # padded nodes are number -1
    return np.take_along_axis(place, rows, 1)


def _first(place: Array, child: Array, m: int) -> Array:
    """First number of each block (t, r + 1, r) in the flat updates (children, 3m + 3, 3m), for rows of fronts at these
    places of a child; a block of zeros, below the first update, above the diagonal and where the child has none."""
    t, r = place.shape
    i, j = place[:, :, None], place[:, None, :]
    out = np.full((t, r + 1, r), 9 * m * m)
    lower = np.tri(r, dtype=bool)
    out[:, :r] = np.where(
        (i >= 0) & (j >= 0) & lower, ((3 * m + 3) * child[:, None, None] + 3 * i) * 3 * m + 3 * j, 9 * m * m
    )
    return out


class _Entries:
    """The lower triangle of a matrix by pairs of nodes: its rows are eliminated no earlier than its columns.

    row, column (pairs,): nodes. zero, unit: numbers of two more blocks. rounds: of the pairs that have one, the first,
    second... element that contributes, as numbers (pairs, 3) of its tangent's rows of three (e, 24, 8); pairs with most
    elements come first. diagonal: pairs of a node with itself. neighbours: for each of the 27 directions nodes, their
    neighbours, the pair, and whether it is stored the other way.
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
        self.zero, self.unit = len(keys), len(keys) + 1
        by_pair, most = slots[np.argsort(which, kind="stable")], count[order]
        starts = (np.cumsum(count) - count)[order]
        blocks = [by_pair[starts[most > k] + k] for k in range(most.max())]  # numbers of (e, 8, 8)
        self.rounds = [(at // 8 * 24 + at % 8)[:, None] + 8 * np.arange(3) for at in blocks]
        self.diagonal = np.flatnonzero(self.row == self.column)
        self.neighbours = [self._towards(pattern.number, *step) for step in itertools.product((-1, 0, 1), repeat=3)]

    def numbers(self, row: Array, column: Array) -> Array:
        """Numbers of the pairs of these nodes, which broadcast; `zero` where there is none, or a node is -1."""
        key = row * self._n + column
        at = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
        return np.where((self._keys[at] == key) & (row >= 0) & (column >= 0), self._number[at], self.zero)

    def _towards(self, number: Array, *step: int) -> tuple[Array, Array, Array, Array]:
        """Nodes that have a neighbour in this direction."""
        own = tuple(slice(max(0, -s), size - max(0, s)) for s, size in zip(step, number.shape, strict=True))
        other = tuple(slice(max(0, s), size - max(0, -s)) for s, size in zip(step, number.shape, strict=True))
        at, near = number[own].ravel(), number[other].ravel()
        free = (self._rank[at] >= 0) & (self._rank[near] >= 0)
        at, near = at[free], near[free]
        turned = self._rank[at] < self._rank[near]
        return at, near, self.numbers(np.where(turned, near, at), np.where(turned, at, near)), turned
