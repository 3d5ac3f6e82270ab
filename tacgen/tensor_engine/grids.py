"""Patterns that meshes share: a scene's tensor grid of hexes is embedded in one of a few larger grids.

A pattern is known by numbers of cells alone, so all scenes of a pattern have one sparsity, one order of elimination and
one tree of fronts. Cells and nodes that a scene does not have stay void: the mesh, and so its forces, are those of
`mechanics.mesh`. The cost is the void unknowns.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tacgen.fem.elements import boxes
from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene

Array = np.ndarray
SIDE = 3  # cells of a pattern on each side of the patch; most graded meshes have 3 or 4
# Cells of the patch along x or y. More sizes waste fewer unknowns and divide the scenes into more patterns; nodes of
# nearly all (with those at the sides) divide into quarters of equal size, so that fronts need little padding
SIZES = (8, 12, 16, 20, 24, 32)


@dataclass(frozen=True)
class GridPattern:
    """Numbers of cells (x, y, z) of a grid, of which `side` on each side in x and y can not be touched.

    The patch, nodes of the face on and within the other cells, holds all nodes on which contact can act. Nodes are
    numbered with z fastest and the bonded base at z = 0.
    """

    cells: tuple[int, int, int]
    side: int = SIDE

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
class Embedded:
    """A scene's mesh within a pattern: points (n, 3) [mm] of all nodes, void ones beside the gel; whether each cell
    (e,) exists; its layer (e,), 0 if void; the pattern's number of each node of the mesh (m,) and of each cell."""

    pattern: GridPattern
    points: Array
    exists: Array
    layer: Array
    nodes: Array
    cells: Array

    @property
    def facets(self) -> Array:
        """The pattern's numbers of the mesh's coated facets, in their order."""
        return np.flatnonzero(self.exists.reshape(-1, self.pattern.cells[2])[:, -1])

    @property
    def used(self) -> Array:
        """Whether each node (n,) of the pattern belongs to the mesh."""
        out = np.zeros(self.pattern.size, bool)
        out[self.nodes] = True
        return out

    def spread(self, values: Array, void: Array | float = 0.0) -> Array:
        """Values (m, ...) at the mesh's nodes as values (n, ...) at the pattern's, `void` elsewhere."""
        out = np.empty((self.pattern.size, *values.shape[1:]), values.dtype)
        out[:] = void
        out[self.nodes] = values
        return out


def embedded(scene: Scene) -> Embedded | None:
    """The scene's mesh, as `mesh.of` makes it, in the smallest pattern that holds it; None: it has no tensor grid or is
    larger than all patterns."""
    if scene.element != "hex":
        return None
    return in_pattern(mesh.axes(scene.gel, mesh.footprint(scene), scene.edge), scene)


def in_pattern(axes: mesh.Axes, scene: Scene) -> Embedded | None:
    """The mesh on these axes in the smallest pattern that holds it; None: none does."""
    along = [_least(len(at) - 1, fine) for at, fine in ((axes.x, axes.fine_x), (axes.y, axes.fine_y))]
    if along[0] is None or along[1] is None:
        return None
    (nx, ox), (ny, oy) = along[0], along[1]
    pattern = GridPattern((nx, ny, len(axes.z) - 1))
    x, y = _longer(axes.x, nx + 1, ox), _longer(axes.y, ny + 1, oy)
    points = replace(axes, x=x, y=y).points(scene.gel)
    exists = np.zeros(pattern.cells, bool)
    exists[ox : ox + len(axes.x) - 1, oy : oy + len(axes.y) - 1] = axes.inside(scene.gel)[:, :, None]
    cells = np.flatnonzero(exists.ravel())
    layer = np.where(exists, axes.layer, 0).ravel()
    return Embedded(pattern, points, exists.ravel(), layer, np.unique(pattern.hexes[cells]), cells)


def _least(count: int, fine: tuple[int, int]) -> tuple[int, int] | None:
    """Cells along one axis of the smallest pattern for a grid of `count` cells, fine between two of its nodes, and
    where in it the grid begins."""
    first, last = fine
    for size in SIZES:
        total = size + 2 * SIDE
        low, high = max(0, SIDE - first), min(total - count, SIDE + size - last)
        if low <= high:
            return total, (low + high) // 2
    return None


def _longer(at: Array, count: int, first: int) -> Array:
    """Coordinates (count,) with `at` from number `first` on, continued by equal intervals."""
    before = at[0] + (at[1] - at[0]) * np.arange(-first, 0)
    after = at[-1] + (at[-1] - at[-2]) * np.arange(1, count - len(at) - first + 1)
    return np.concatenate([before, at, after])
