"""The batch engine's linear algebra on the device there is, beside a core's.

python -m benchmarks.tensor_engine [--batch 1 64 256] [--draws 8] [--seconds 20] ...
"""

from collections.abc import Sequence

import numpy as np

from benchmarks.draws import Draw
from benchmarks.reference_runs import row_of
from tacgen.fem.assembly import Pattern
from tacgen.mechanics.scene import Scene
from tacgen.recipe import scene_of_row
from tacgen.tensor_engine import grids

Array = np.ndarray


def scene_of(draw: Draw, quality: str = "draft", sets: Sequence[str] = ()) -> Scene:
    """The scene of a draw."""
    return scene_of_row.build(
        row_of(("outputs=[force]", f"sensor={draw.sensor}", *draw.sets, f"quality={quality}", *sets))
    )


def elements_of(grid: grids.Embedded, pattern: Pattern, data: Array) -> Array:
    """Element tangents (e, 24, 24) whose sum is the matrix of `data`, the entries of the mesh's pattern: each block of
    two nodes is given wholly to the first element that has both."""
    n = pattern.nodes
    i, j, slots = pattern.pairs // n, pattern.pairs % n, pattern.blocks
    upper = np.where(slots >= 0, data[slots], 0.0)
    turned = upper[np.searchsorted(pattern.pairs, j * n + i)].transpose(0, 2, 1)
    both = np.where((slots >= 0) & (i == j)[:, None, None], 0.0, turned) + upper
    hexes = grid.pattern.hexes
    row, column = np.repeat(hexes, 8, axis=1).ravel(), np.tile(hexes, 8).ravel()
    keys, first = np.unique(row * grid.pattern.size + column, return_index=True)
    out = np.zeros((row.size, 3, 3))
    out[first[np.searchsorted(keys, grid.nodes[i] * grid.pattern.size + grid.nodes[j])]] = both
    return out.reshape(len(hexes), 8, 8, 3, 3).transpose(0, 1, 3, 2, 4).reshape(len(hexes), 24, 24)
