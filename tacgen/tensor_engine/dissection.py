"""Nested dissection of a pattern: the tree of fronts in which its unknowns are eliminated.

All nodes but those of the patch are divided by vertical planes, again and again, and each region is eliminated after
the regions it was divided into. The patch is last: the Schur complement on its nodes is what the elimination leaves.
Regions of a level have similar sizes, so that their fronts fit into one or two batches with little padding.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from tacgen.tensor_engine.grids import GridPattern

Array = np.ndarray
Region = tuple[int, int, int, int]  # first and last but one column of nodes along x, then along y
MAX_LEAF_COLUMNS = 3  # columns of nodes across a region that is not divided
MIN_QUARTERED_COLUMNS = 12  # across a region that is divided in four at once: fewer updates to move, more arithmetic
# A GPU's time for a number that is written and read a few times, over that for a floating-point operation of a batched
# product, from usual bandwidths and rates [-]
FLOPS_PER_ENTRY = 150.0
MAX_LEVEL_BATCHES = 2  # batches of a level: each more saves padding, and gathers from one source more


@dataclass(frozen=True)
class Group:
    """Fronts of a level that are one batch.

    fronts (t,): their numbers on the level; own (t, w): nodes eliminated in each; bound (t, m): nodes that they then
    act on; both in the order of elimination and padded with -1.
    """

    fronts: Array
    own: Array
    bound: Array

    @property
    def entries(self) -> int:
        """Numbers of a matrix in the factor and the updates, padding included."""
        return len(self.fronts) * _entries(self.own.shape[1], self.bound.shape[1])


@dataclass(frozen=True)
class Level:
    """Fronts that can be eliminated at once; front i has the children arity i ... arity i + arity - 1 on the level
    before, or none if `arity` is 0."""

    groups: tuple[Group, ...]
    arity: int


@dataclass(frozen=True)
class Dissection:
    """The levels of a pattern's tree from the leaves up; the patch, which is not eliminated, is not among them.

    patch (p,): its nodes, in their order in the Schur complement; rank (n,): place of each node in the order of
    elimination, -1 for bonded ones.
    """

    pattern: GridPattern
    levels: tuple[Level, ...]
    patch: Array
    rank: Array

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """The batches of all levels, from the leaves up."""
        return tuple(group for level in self.levels for group in level.groups)

    @property
    def kept(self) -> int:
        """Numbers of a matrix's factor, without the patch."""
        sizes = ((len(g.fronts), g.own.shape[1], g.bound.shape[1]) for g in self.groups)
        return sum(9 * t * (w + m) * w for t, w, m in sizes)

    @property
    def work(self) -> int:
        """Most numbers of a matrix that a factorisation has at once: the updates of two levels, and the own columns of
        a batch of fronts, the factor's part of them and its square; of the patch, condensed as another front, all."""
        sizes = [[(len(g.fronts), g.own.shape[1], g.bound.shape[1]) for g in level.groups] for level in self.levels]
        updates = [sum(t * m**2 for t, _, m in level) for level in sizes]
        columns = [max(t * ((w + 2 * m) * w + m**2) for t, w, m in level) for level in sizes]
        p = len(self.patch) ** 2
        return int(9 * max(map(sum, zip([0, *updates], [*updates, p], [*columns, p], strict=True))))


def _flops(w: int, m: int) -> float:
    """Work of the inverse of the own factor, its product with the other rows, and the symmetric update; in nodes."""
    w, m = 3 * w, 3 * m
    return 2 * w**3 / 3 + w * w * m + w * m * m


def _entries(w: int, m: int) -> int:
    return 9 * ((w + m) * w + m * m)


def dissected(
    pattern: GridPattern,
    leaf: int = MAX_LEAF_COLUMNS,
    quartered: int = MIN_QUARTERED_COLUMNS,
    most_groups: int = MAX_LEVEL_BATCHES,
) -> Dissection:
    """The tree whose last regions are at most `leaf` columns of nodes wide. Regions of up to `quartered` columns are
    divided in four at once, wider ones in two along the longer side. most_groups: batches of a level."""
    levels = list(_regions(pattern, leaf, quartered))[::-1]  # leaves first
    owns = [[np.sort(_inner(pattern, own)) for own in level] for level, _ in levels]
    order = np.concatenate([nodes for level in owns for nodes in level] + [pattern.patch])
    rank = np.full(pattern.size, -1)
    rank[order] = np.arange(len(order))
    graph, done, below = _graph(pattern), list[Level](), list[Array]()
    for own, (_, arity) in zip(owns, levels, strict=True):
        reach = []
        for i, nodes in enumerate(own):
            near = np.concatenate([graph[nodes].indices, *below[arity * i : arity * (i + 1)]])
            later = np.unique(near[rank[near] > rank[nodes].max(initial=-1)])
            reach.append(later[np.argsort(rank[later])])
        done.append(Level(_grouped(own, reach, most_groups), arity))
        below = reach
    return Dissection(pattern, tuple(done), pattern.patch, rank)


def _grouped(own: list[Array], bound: list[Array], most: int) -> tuple[Group, ...]:
    """Fronts in up to `most` batches of like sizes, as cheap as possible by operations and numbers."""
    w, m = np.array([len(nodes) for nodes in own]), np.array([len(nodes) for nodes in bound])

    def cost(which: Array) -> float:
        a, b = int(w[which].max()), int(m[which].max())
        return len(which) * (_flops(a, b) + FLOPS_PER_ENTRY * _entries(a, b))

    groups = [np.lexsort((w, m))]
    while len(groups) < most:
        cuts = [(g, k) for g, each in enumerate(groups) for k in range(1, len(each))]
        if not cuts:
            break
        saved = [cost(groups[g]) - cost(groups[g][:k]) - cost(groups[g][k:]) for g, k in cuts]
        g, k = cuts[int(np.argmax(saved))]
        if max(saved) <= 0.05 * sum(map(cost, groups)):
            break
        groups[g : g + 1] = [groups[g][:k], groups[g][k:]]
    parts = [np.sort(group) for group in groups]
    return tuple(Group(f, _padded([own[i] for i in f]), _padded([bound[i] for i in f])) for f in parts)


def _regions(pattern: GridPattern, leaf: int, quartered: int) -> Iterator[tuple[list[list[Region]], int]]:
    """Level by level from the top: the columns that each front eliminates, as rectangles, and how many children each
    has."""
    regions: list[Region] = [(0, pattern.nodes[0], 0, pattern.nodes[1])]
    while True:
        wide, deep = max(b - a for a, b, _, _ in regions), max(d - c for _, _, c, d in regions)
        four = max(wide, deep) <= quartered
        along = wide > leaf and (four or wide >= deep), deep > leaf and (four or deep > wide)
        if not any(along):
            yield [[region] for region in regions], 0
            return
        cut = [_divided(region, *along) for region in regions]
        yield [own for own, _ in cut], len(cut[0][1])
        regions = [part for _, parts in cut for part in parts]


def _divided(region: Region, along_x: bool, along_y: bool) -> tuple[list[Region], list[Region]]:
    """The columns between the parts of a region, and the parts."""
    a, b, c, d = region
    x, y = (a + b) // 2, (c + d) // 2
    own: list[Region] = []
    rows, columns = [(a, b)], [(c, d)]
    if along_x:
        own.append((x, min(x + 1, b), c, d))
        rows = [(a, x), (min(x + 1, b), b)]
    if along_y:
        own += [(*row, y, min(y + 1, d)) for row in rows]
        columns = [(c, y), (min(y + 1, d), d)]
    return own, [(*row, *column) for row in rows for column in columns]


def _inner(pattern: GridPattern, own: list[Region]) -> Array:
    """The nodes of these columns that are eliminated: all above the base but those of the patch."""
    nodes = np.concatenate([pattern.number[a:b, c:d, 1:].ravel() for a, b, c, d in own])
    return np.setdiff1d(nodes, pattern.patch)


def _graph(pattern: GridPattern) -> sp.csr_matrix:
    """Which free nodes share a cell."""
    hexes = pattern.hexes
    i, j = np.repeat(hexes, 8, axis=1).ravel(), np.tile(hexes, 8).ravel()
    keep = pattern.free[i] & pattern.free[j]
    return sp.csr_matrix((np.ones(keep.sum(), np.int8), (i[keep], j[keep])), (pattern.size,) * 2)


def _padded(rows: list[Array]) -> Array:
    """Rows of unequal length as one array, filled up with -1."""
    out = np.full((len(rows), max(map(len, rows), default=0)), -1)
    for row, values in zip(out, rows, strict=True):
        row[: len(values)] = values
    return out
