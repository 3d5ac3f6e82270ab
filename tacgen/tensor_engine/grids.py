"""Patterns that meshes share: a scene's tensor grid of hexes is embedded in one of a few larger grids.

A pattern is known by numbers of cells alone, so all scenes of a pattern have one sparsity, one order of elimination and
one tree of fronts. Cells and nodes that a scene does not have stay void: the mesh, and so its forces, are those of
`mechanics.mesh`. The cost is the void unknowns.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tacgen.fem.elements import boxes
from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene

Array = np.ndarray
SIDE_CELLS = 3  # cells of a pattern on each side of the patch; most graded meshes have 3 or 4
# Cells of the patch along x or y. More sizes waste fewer unknowns and divide the scenes into more patterns; nodes of
# nearly all (with those at the sides) divide into quarters of equal size, so that fronts need little padding
PATCH_SIZES = (8, 12, 16, 20, 24, 32)
# Cells of a pattern of which each further scene takes as long as a pool takes alone, with the square of the cells: as
# fitted to 42 pools of 1 to 272 scenes with 1620 to 7980 cells on an H100 with eight and with twelve processes
REFERENCE_CELLS = 10_000


@dataclass(frozen=True)
class GridPattern:
    """Numbers of cells (x, y, z) of a grid, of which `side` on each side in x and y can not be touched.

    The patch, nodes of the face on and within the other cells, holds all nodes on which contact can act. Nodes are
    numbered with z fastest and the bonded base at z = 0.
    """

    cells: tuple[int, int, int]
    side: int = SIDE_CELLS

    @property
    def nodes(self) -> tuple[int, int, int]:
        """Numbers of nodes along x, y and z."""
        x, y, z = self.cells
        return x + 1, y + 1, z + 1

    @property
    def size(self) -> int:
        """Number of nodes, the bonded base included."""
        return math.prod(self.nodes)

    @cached_property
    def number(self) -> Array:
        """Number of each node (x, y, z)."""
        return np.arange(self.size).reshape(self.nodes)

    @cached_property
    def hexes(self) -> Array:
        """Nodes (e, 8) of all cells, numbered as in VTK; z is fastest among cells."""
        return boxes(self.number).reshape(-1, 8)

    @cached_property
    def facets(self) -> Array:
        """Nodes (f, 4) of the upper sides of the columns, seen from outside; y is fastest among columns."""
        return self.hexes.reshape(-1, self.cells[2], 8)[:, -1, 4:]

    @cached_property
    def patch(self) -> Array:
        """Numbers (p,) of the nodes on which contact can act."""
        s = self.side
        return self.number[s : self.nodes[0] - s, s : self.nodes[1] - s, -1].ravel()

    @cached_property
    def free(self) -> Array:
        """Whether each node (n,) is above the bonded base."""
        return np.arange(self.size) % self.nodes[2] > 0


@dataclass(frozen=True)
class Place:
    """Where a scene's mesh is within a batch's numbering: numbers of its nodes (m,), cells and coated facets, in their
    order; points (n, 3) [mm] of all nodes at rest, void ones too."""

    nodes: Array
    cells: Array
    facets: Array
    points: Array


def axes_of(scene: Scene) -> mesh.Axes:
    """The grid of the scene's mesh."""
    return mesh.axes(scene.gel, mesh.footprint(scene), scene.edge)


def smallest(axes: mesh.Axes) -> GridPattern | None:
    """The smallest pattern that holds a grid; None: none does."""
    x, y = _size(len(axes.x) - 1, axes.fine_x), _size(len(axes.y) - 1, axes.fine_y)
    return None if x is None or y is None else GridPattern((x, y, len(axes.z) - 1))


def placed(axes: mesh.Axes, scene: Scene, pattern: GridPattern) -> Place:
    """The scene's mesh, on these axes, in a pattern. Raises ValueError: the pattern does not hold it."""
    ox = _first(len(axes.x) - 1, axes.fine_x, pattern.cells[0])
    oy = _first(len(axes.y) - 1, axes.fine_y, pattern.cells[1])
    if ox is None or oy is None or len(axes.z) != pattern.nodes[2]:
        raise ValueError(f"{pattern} is too small for the mesh")
    x, y = _longer(axes.x, pattern.nodes[0], ox), _longer(axes.y, pattern.nodes[1], oy)
    exists = np.zeros(pattern.cells, bool)
    exists[ox : ox + len(axes.x) - 1, oy : oy + len(axes.y) - 1] = axes.inside(scene.gel)[:, :, None]
    cells = np.flatnonzero(exists.ravel())
    nodes, facets = np.unique(pattern.hexes[cells]), np.flatnonzero(exists[:, :, -1])
    return Place(nodes, cells, facets, replace(axes, x=x, y=y).points(scene.gel))


def time_of(pattern: GridPattern, scenes: float) -> float:
    """Time for a pool of scenes of one pattern, relative to what a pool takes for any few small ones."""
    return 1.0 + scenes * (len(pattern.hexes) / REFERENCE_CELLS) ** 2


def merged(wanted: Mapping[GridPattern, int]) -> dict[GridPattern, GridPattern]:
    """For the smallest patterns of some numbers of scenes, patterns that they share: two pools become one of a pattern
    that holds both, the two that save most first, as long as that saves time."""
    groups = {pattern: (count, [pattern]) for pattern, count in wanted.items()}

    def saved(a: GridPattern, b: GridPattern) -> float:
        both = _both(a, b)
        parts = {a, b, *({both} & groups.keys())}
        apart = sum(time_of(part, groups[part][0]) for part in parts)
        return apart - time_of(both, sum(groups[part][0] for part in parts))

    while True:
        pairs = [(a, b) for a, b in itertools.combinations(groups, 2) if (a.cells[2], a.side) == (b.cells[2], b.side)]
        best = max(pairs, key=lambda pair: saved(*pair), default=None)
        if best is None or saved(*best) <= 0:
            return {part: pattern for pattern, (_, parts) in groups.items() for part in parts}
        both = _both(*best)
        found = [groups.pop(part) for part in {*best, both}.intersection(groups)]
        groups[both] = sum(count for count, _ in found), [part for _, parts in found for part in parts]


def _both(a: GridPattern, b: GridPattern) -> GridPattern:
    """The smallest pattern that holds two."""
    return GridPattern((max(a.cells[0], b.cells[0]), max(a.cells[1], b.cells[1]), a.cells[2]), a.side)


def _size(count: int, fine: tuple[int, int]) -> int | None:
    """Cells along one axis of the smallest pattern for a grid of `count` cells, fine between two of its nodes."""
    totals = (size + 2 * SIDE_CELLS for size in PATCH_SIZES)
    return next((total for total in totals if _first(count, fine, total) is not None), None)


def _first(count: int, fine: tuple[int, int], total: int) -> int | None:
    """Where in a pattern of `total` cells along one axis such a grid begins, in the middle of where it may."""
    low, high = max(0, SIDE_CELLS - fine[0]), min(total - count, total - SIDE_CELLS - fine[1])
    return (low + high) // 2 if low <= high else None


def _longer(at: Array, count: int, first: int) -> Array:
    """Coordinates (count,) with `at` from number `first` on, continued by equal intervals."""
    before = at[0] + (at[1] - at[0]) * np.arange(-first, 0)
    after = at[-1] + (at[-1] - at[-2]) * np.arange(1, count - len(at) - first + 1)
    return np.concatenate([before, at, after])
