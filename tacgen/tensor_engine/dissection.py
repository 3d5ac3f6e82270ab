"""Nested dissection of a pattern: the tree of fronts in which its unknowns are eliminated.

All nodes but those of the patch are divided by vertical planes, again and again, along x and y at once, and each region
is eliminated after the regions it was divided into. The patch is last: the Schur complement on its nodes is what the
elimination leaves. Regions of a level have nearly equal sizes, so that their fronts fit into one batch with little
padding.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from tacgen.tensor_engine.grids import GridPattern

Array = np.ndarray
Region = tuple[int, int, int, int]  # first and last but one column of nodes along x, then along y


@dataclass(frozen=True)
class Level:
    """Fronts that can be eliminated at once.

    own (t, w): nodes eliminated in each; bound (t, m): nodes that they then act on; both in the order of elimination
    and padded with -1. Front i has the children arity i ... arity i + arity - 1 on the level before.
    """

    own: Array
    bound: Array
    arity: int

    @property
    def flops(self) -> float:
        """Of one matrix, padding included: the inverse of the own factor, its product with the other rows, and the
        symmetric update."""
        (t, w), m = self.own.shape, self.bound.shape[1]
        w, m = 3 * w, 3 * m
        return float(t * (2 * w**3 / 3 + w * w * m + w * m * m))

    @property
    def entries(self) -> int:
        """Numbers of a matrix that the level writes: the factor's and the update's."""
        (t, w), m = self.own.shape, self.bound.shape[1]
        return int(9 * t * ((w + m) * w + m * m))

    @property
    def filled(self) -> int:
        """As `entries`, without padding."""
        w, m = (self.own >= 0).sum(1), (self.bound >= 0).sum(1)
        return int(9 * ((w + m) * w + m * m).sum())


@dataclass(frozen=True)
class Dissection:
    """The levels of a pattern's tree from the leaves up; the patch, which is not eliminated, is not among them.

    patch (p,): its nodes, in their order in the Schur complement.
    """

    pattern: GridPattern
    levels: tuple[Level, ...]
    patch: Array

    @cached_property
    def rank(self) -> Array:
        """Place of each node (n,) in the order of elimination; -1 for the bonded ones."""
        order = np.concatenate([*(own[own >= 0] for own in (level.own for level in self.levels)), self.patch])
        rank = np.full(self.pattern.size, -1)
        rank[order] = np.arange(len(order))
        return rank


def dissected(pattern: GridPattern, leaf: int = 3, quarters: bool = True) -> Dissection:
    """The tree whose last regions are at most `leaf` columns of nodes wide; divided in four each time, or in two along
    the longer side."""
    levels = list(_regions(pattern, leaf, quarters))[::-1]  # leaves first
    owns = [[np.sort(_inner(pattern, own)) for own in level] for level, _ in levels]
    dissection = Dissection(pattern, tuple(Level(_padded(own), _padded([]), 0) for own in owns), pattern.patch)
    rank, graph = dissection.rank, _graph(pattern)
    done: list[Level] = []
    below: list[Array] = []
    for own, (_, arity) in zip(owns, levels, strict=True):
        reach = []
        for i, nodes in enumerate(own):
            near = np.concatenate([graph[nodes].indices, *below[arity * i : arity * (i + 1)]])
            last = rank[nodes].max(initial=-1)
            later = np.unique(near[rank[near] > last])
            reach.append(later[np.argsort(rank[later])])
        done.append(Level(_padded(own), _padded(reach), arity))
        below = reach
    return Dissection(pattern, tuple(done), pattern.patch)


def _regions(pattern: GridPattern, leaf: int, quarters: bool) -> Iterator[tuple[list[list[Region]], int]]:
    """Level by level from the top: the columns that each front eliminates, as rectangles, and how many children each
    has."""
    regions: list[Region] = [(0, pattern.nodes[0], 0, pattern.nodes[1])]
    while True:
        wide, deep = max(b - a for a, b, _, _ in regions), max(d - c for _, _, c, d in regions)
        along = wide > leaf and (quarters or wide >= deep), deep > leaf and (quarters or deep > wide)
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
