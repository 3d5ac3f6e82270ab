"""Deformed faces that cast shadows; physics.shadows has their horizons.

A face is given by heights over a regular grid, with the gel below it. From a point of it along an azimuth it hides
all directions steeper than its horizon, so one march along the azimuth decides for lights at all heights. Blocks of the
grid whose lowest point is out of the way are skipped.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacgen.physics import shadows
from tacgen.physics.runtime import call
from tacgen.physics.shadows import LARGE_BLOCK_CELLS, SMALL_BLOCK_CELLS

Floats = NDArray[np.float64]
BLOCK_SIZES = SMALL_BLOCK_CELLS, LARGE_BLOCK_CELLS


class Terrain(NamedTuple):
    """Heights (h, w) [mm] over a rectangle of `size` (x, y) [mm] centred on 0, and the least of what casts shadows in
    each block, infinite where nothing does."""

    heights: Floats
    small: Floats
    large: Floats
    size: tuple[float, float]
    extent: Floats  # the least of all [mm], and columns and rows beyond which nothing casts shadows [cells], (5,)

    @classmethod
    def of(cls, heights: Floats, size: tuple[float, float], before: Floats | None = None) -> "Terrain":
        """The terrain of a face; with its heights `before`, only places that have receded since then cast shadows."""
        small, large = (np.empty((1, *(-(-(n - 1) // cells) for n in heights.shape))) for cells in BLOCK_SIZES)
        extent, before = np.empty((1, 5)), None if before is None else before.reshape(-1)
        call(shadows.lowest, small.shape, heights.reshape(-1), before, *heights.shape, BLOCK_SIZES[0], 1, small)
        ratio = BLOCK_SIZES[1] // BLOCK_SIZES[0]
        call(shadows.lowest, large.shape, small.reshape(-1), None, *small.shape[1:], ratio, 0, large)
        call(shadows.extents, (1,), small, extent)
        return cls(heights, small[0], large[0], size, extent[0])
