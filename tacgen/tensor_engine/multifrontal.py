"""Cholesky factors of many matrices of one pattern at once: the multifrontal method, level by level of its tree.

A front is the dense matrix of the unknowns that it eliminates and of those on which they act (Duff & Reid 1983). Fronts
of a level are padded to one size, so that a level is a few batched products whatever the number of scenes. The factor's
diagonal blocks are kept as inverses: panels and solves are then products too, which a GPU does much faster than
substitutions. Their rounding errors are larger, by the condition of a diagonal block; a refinement removes them.
"""

import itertools
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from tacgen.physics.fronts import ASSEMBLED, ENTRIES, KEPT, LEFT
from tacgen.physics.runtime import launch
from tacgen.physics.substitution import GATHERED
from tacgen.tensor_engine import dense
from tacgen.tensor_engine.dissection import Dissection, Group, Level
from tacgen.tensor_engine.products import product

Array = np.ndarray


@dataclass(frozen=True)
class Fronts:
    """Where the numbers of fronts (t, w own nodes, m others) come from, of which the lower triangle is summed.

    places (b, t, arity, w + m): the row of nodes that each node is in each of the children's updates, -1 where it is in
    none; in the first, which is there without children too, -2 where the node is padding and gets the unit matrix; b is
    1 where all matrices have the same. first, length (t, arity): where a child's update begins in the updates of the
    level below, and how long its rows are [numbers].
    entries (t, w + m, w): the matrix's own blocks, numbers of (pairs + 1), the last of which is 0.
    """

    places: Tensor
    first: Tensor
    length: Tensor
    entries: Tensor | None
    w: int

    @property
    def sizes(self) -> tuple[int, int, int]:
        """t, and the rows 3w and 3m of unknowns."""
        _, t, _, rows = self.places.shape
        return t, 3 * self.w, 3 * (rows - self.w)


@dataclass(frozen=True)
class FrontGroup:
    """Fronts of a level that are one batch: nodes own (t, w) and bound (t, m), the number of all nodes where padded;
    rows (t, arity): where a child's vectors begin in those of the level below; at, row: where the fronts' own updates
    and vectors begin in those of their level."""

    fronts: Fronts
    own: Tensor
    bound: Tensor
    rows: Tensor
    at: int
    row: int


@dataclass(frozen=True)
class Panel:
    """The factors of a group: inverses of the diagonal blocks (B, t, 3w, 3w), and the blocks below (B, t, 3m, 3w)."""

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
        self._parts, self._diagonal = self._small(entries.parts), self._index(entries.diagonal)
        patch = Group(np.zeros(1, int), tree.patch[None], np.zeros((1, 0), int))
        each = zip((*tree.levels, Level((patch,), 1)), (None, *tree.levels), strict=True)
        *self.levels, (self.root,) = (self._groups(level, below, entries) for level, below in each)

    def _index(self, numbers: Array) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(numbers), device=self.device)

    def _small(self, numbers: Array) -> Tensor:
        return self._index(numbers.astype(np.int32))

    def _groups(self, level: Level, below: Level | None, entries: "_Entries") -> list[FrontGroup]:
        out, at, row = list[FrontGroup](), 0, 0
        for group in level.groups:
            (t, m), nodes = group.bound.shape, np.concatenate([group.own, group.bound], 1)
            w, children = group.own.shape[1], level.arity * group.fronts[:, None] + np.arange(level.arity)
            places, first, length, rows = _children(nodes, children, below)
            places[:, 0][nodes < 0] = -2
            number = entries.numbers(nodes[:, :, None], group.own[:, None, :])
            where = [self._small(numbers) for numbers in (places[None], first, length, number)]
            fronts = Fronts(where[0], where[1], where[2], where[3], w)
            own, bound = (self._index(np.where(part < 0, self.nodes, part)) for part in (group.own, group.bound))
            out.append(FrontGroup(fronts, own, bound, self._small(rows), at, row))
            at, row = at + 9 * t * m**2, row + t * m
        return out

    def assembled(self, elements: Tensor) -> Tensor:
        """The entries (B, pairs + 1, 9) of the matrices that are sums of the element tangents (B, e, 24, 24) of the
        pattern's hexes, rows and columns in the order 3a + i. Nodes without any stiffness get the unit matrix."""
        out = elements.new_empty(len(elements), self.pairs + 1, 9)
        flat = elements.contiguous().flatten(1)
        launch(ENTRIES[out.element_size()], out.shape, flat, self._parts, self._diagonal, out)
        return out

    def factor(self, data: Tensor, panels: list[Panel], slots: Tensor) -> tuple[Tensor, Tensor]:
        """Factorise the matrices whose entries `assembled` gives, into these slots (B,) of the panels.

        Returns the Schur complements S (B, k, k) on the patch's nodes, k = 3 p, and which matrices (B,) are not
        positive definite away from it; the numbers of those mean nothing.
        """
        data, each = data.to(self.dtype).reshape(len(data), -1), iter(panels)
        bad, below = list[Tensor](), data.new_empty(len(data), 0)
        for level in self.levels:
            last = level[-1]
            t, _, m = last.fronts.sizes
            updates = data.new_empty(len(data), last.at + t * m**2)
            for group in level:
                t, _, m = group.fronts.sizes
                out = updates[:, group.at : group.at + t * m**2].view(-1, t, m, m)
                bad.append(eliminate(group.fronts, data, below, next(each), slots, out))
            below = updates
        return assembled(self.root.fronts, data, below)[:, 0], torch.cat(bad, 1).any(1)

    def empty(self, batch: int) -> list[Panel]:
        """Room for the panels of so many factors."""
        out = []
        for group in itertools.chain(*self.levels):
            t, w, m = group.fronts.sizes
            shapes = (batch, t, w, w), (batch, t, m, w)
            out.append(Panel(*(torch.zeros(shape, dtype=self.dtype, device=self.device) for shape in shapes)))
        return out

    def forward(self, panels: list[Panel], slots: Tensor, g: Tensor) -> Tensor:
        """L^-1 g of vectors (B, n, 3), and on the patch g condensed to it; 0 at bonded nodes. Their factors are those
        at `slots` (B,) of the panels."""
        b, each = g.to(self.dtype).contiguous(), iter(panels)
        y, below = torch.zeros_like(b), b.new_empty(len(b), 0, 3)
        for level in self.levels:
            updates = b.new_empty(len(b), level[-1].row + level[-1].bound.numel(), 3)
            for group in level:
                forward(group, next(each), slots, b, below, y, updates)
            below = updates
        forward(self.root, None, slots, b, below, y, below)
        return y

    def backward(self, panels: list[Panel], slots: Tensor, y: Tensor, u: Tensor) -> Tensor:
        """x (B, n, 3) with L^T x = y away from the patch and x = u (B, k) on it; 0 at bonded nodes."""
        y = y.to(self.dtype, copy=True)
        x = torch.zeros_like(y)
        x[:, self.patch] = u.to(self.dtype).view(len(y), -1, 3)
        for group, panel in zip([*itertools.chain(*self.levels)][::-1], panels[::-1], strict=True):
            backward(group, panel, slots, y, x)
        return x


def assembled(fronts: Fronts, data: Tensor, below: Tensor) -> Tensor:
    """The own columns (B, t, w + m, w) of fronts before elimination, of the matrix's entries (B, numbers) and the
    updates (B, numbers) of the level below; where there are no others, so m = 0, the whole symmetric matrices."""
    t, w, m = fronts.sizes
    out = data.new_empty(len(data), t, w + m, w)
    flat, sources = out.flatten(0, 1), (fronts.places, fronts.first, fronts.length, fronts.entries)
    launch(ASSEMBLED[out.element_size()], (len(flat), (w + m) // 3, w // 3), data, below, *sources, not m, flat)
    return out


def eliminate(
    fronts: Fronts, data: Tensor, below: Tensor, panel: Panel, slots: Tensor, updates: Tensor, whole: bool = False
) -> Tensor:
    """Eliminate the own unknowns of fronts: their factors into slots (B,) of a panel, which may be larger and is then 0
    beyond them, and what is left of the other rows into updates (B, t, m, m): the lower triangle, or if `whole` both.

    Returns the leading minor of each (B, t) that is not positive, 0 where it is positive definite.
    """
    t, w, m = fronts.sizes
    columns, size = assembled(fronts, data, below).flatten(0, 1), data.element_size()
    info = dense.invert_factor(columns[:, :w])
    low, (tall, long) = dense.times_transposed(columns[:, w:], columns[:, :w]), panel.inverse.shape[2:]
    grid = len(columns), tall + panel.below.shape[2], -(-long // 3)
    launch(KEPT[size], grid, columns, low, slots, panel.inverse, panel.below)
    if m:
        sources = below, fronts.places, fronts.first, fronts.length, dense.squared(low)
        launch(LEFT[size], (len(columns), m // 3, m // 3), *sources, whole, updates)
    return info.view(-1, t)


def forward(
    group: FrontGroup, panel: Panel | None, slots: Tensor, b: Tensor, below: Tensor, y: Tensor, updates: Tensor
) -> None:
    """Vectors b (B, n, 3) with what the children add, from those of the level below (B, rows, 3): L^-1 of them into y
    at the own nodes, and what is left of the others into updates. Without a panel, as for the patch, into y."""
    t, w, m = group.fronts.sizes
    size, flat = b.element_size(), y.flatten(1)[:, None]
    sources = b.flatten(1)[:, None], group.own, below.flatten(1)[:, None], group.fronts.places[0], group.rows
    if panel is None:
        launch(GATHERED[size], (len(b), t, w), *sources, flat, group.own)
        return
    felt = b.new_empty(len(b), t, w + m)
    launch(GATHERED[size], felt.shape, *sources, felt, None)
    product(panel.inverse, slots, felt, flat, lower=True, to=group.own)
    left = updates[:, group.row : group.row + group.bound.numel()].flatten(1).unflatten(1, (t, m))
    product(panel.below, slots, flat, left, at=group.own, start=felt[:, :, w:])


def backward(group: FrontGroup, panel: Panel, slots: Tensor, y: Tensor, x: Tensor) -> None:
    """x (B, n, 3) at the own nodes of fronts from y and x at the others; y may change."""
    b, solved = y.flatten(1)[:, None], x.flatten(1)[:, None]
    product(panel.below, slots, solved, b, transposed=True, start=b, at=group.bound, to=group.own)
    product(panel.inverse, slots, b, solved, transposed=True, lower=True, at=group.own, to=group.own)


def _children(nodes: Array, children: Array, below: Level | None) -> tuple[Array, Array, Array, Array]:
    """For fronts with rows of nodes (t, r) and the numbers (t, arity) of their children: the places (t, arity, r),
    first numbers, lengths of rows and first rows of vectors (t, arity)."""
    if below is None:
        none = np.zeros((len(nodes), 0), int)
        return np.full((len(nodes), 1, nodes.shape[1]), -1), none, none, none
    places = np.full((*children.shape, nodes.shape[1]), -1)
    first, length, rows = (np.zeros(children.shape, int) for _ in range(3))
    at = row = 0
    for group in below.groups:
        t, m = group.bound.shape
        front, c = np.nonzero(np.isin(children, group.fronts))
        which = np.searchsorted(group.fronts, children[front, c])
        places[front, c] = _places(nodes[front], group.bound[which])
        first[front, c], length[front, c], rows[front, c] = at + 9 * m**2 * which, 3 * m, row + m * which
        at, row = at + 9 * t * m**2, row + t * m
    return places, first, length, rows


def _places(rows: Array, bound: Array) -> Array:
    """Where each of the rows (t, r) of fronts stands among the nodes (t, m) that a child acts on; -1 if it does not."""
    place = np.full((len(rows), max(rows.max(initial=0), bound.max(initial=0)) + 2), -1)
    np.put_along_axis(place, bound, np.arange(bound.shape[1])[None], 1)
    place[:, -1] = -1  # padded nodes are number -1
    return np.take_along_axis(place, rows, 1)


class _Entries:
    """The lower triangle of a matrix by pairs of nodes: its rows are eliminated no earlier than its columns.

    row, column (pairs,): nodes. parts (pairs, 8): where the block begins in the tangents (e, 24, 24) of each element
    that has it, padded with -1. diagonal (pairs,): whether a node is paired with itself.
    """

    def __init__(self, tree: Dissection) -> None:
        pattern, rank = tree.pattern, tree.rank
        hexes, n = pattern.hexes, pattern.size
        row, column = np.repeat(hexes, 8, axis=1).ravel(), np.tile(hexes, 8).ravel()
        slots = np.flatnonzero((rank[column] >= 0) & (rank[row] >= rank[column]))
        self._n, self._keys = n, np.unique(row[slots] * n + column[slots])
        self.row, self.column = self._keys // n, self._keys % n
        which = np.searchsorted(self._keys, row[slots] * n + column[slots])
        order = np.argsort(which, kind="stable")
        slots, which = slots[order], which[order]
        self.parts = np.full((len(self._keys), 8), -1)
        self.parts[which, np.arange(len(which)) - np.searchsorted(which, which)] = 72 * (slots // 8) + 3 * (slots % 8)
        self.diagonal = self.row == self.column

    def numbers(self, row: Array, column: Array) -> Array:
        """Numbers of the pairs of these nodes, which broadcast; -1 where there is none, or a node is -1."""
        key = row * self._n + column
        at = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
        return np.where((self._keys[at] == key) & (row >= 0) & (column >= 0), at, -1)
