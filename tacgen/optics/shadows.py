"""Horizons of a deformed face: the slope below which it shades light from the side.

A face is given by heights over a regular grid, with the gel below it. From a point of it along an azimuth it hides
all directions steeper than its horizon, so one march along the azimuth decides for lights at all heights. Blocks of the
grid whose lowest point is out of the way are skipped.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacgen.base.compiled import njit
from tacgen.physics import shadows
from tacgen.physics.runtime import call
from tacgen.physics.shadows import LARGE_BLOCK_CELLS, SMALL_BLOCK_CELLS

Floats = NDArray[np.float64]
# flags of LLVM's fast math with which sums in loops are vectorised
FAST_SUM_FLAGS = {"contract", "nsz", "arcp", "reassoc"}
BLOCK_SIZES = SMALL_BLOCK_CELLS, LARGE_BLOCK_CELLS
# unsigned: indices need no check of their sign
ONE_UINT, BLOCK_SIZES_UINT = np.uint32(1), (np.uint32(SMALL_BLOCK_CELLS), np.uint32(LARGE_BLOCK_CELLS))


class Terrain(NamedTuple):
    """Heights (h, w) [mm] over a rectangle of `size` (x, y) [mm] centred on 0, and the least of what casts shadows in
    each block, infinite where nothing does. Compiled code counts references to arrays, so numbers are in tuples."""

    heights: Floats
    small: Floats
    large: Floats
    size: tuple[float, float]
    lowest: float
    box: tuple[float, float, float, float]  # [cells] columns and rows beyond which nothing casts shadows

    @classmethod
    def of(cls, heights: Floats, size: tuple[float, float], before: Floats | None = None) -> "Terrain":
        """The terrain of a face; with its heights `before`, only places that have receded since then cast shadows."""
        small, large = (np.empty((1, *(-(-(n - 1) // cells) for n in heights.shape))) for cells in BLOCK_SIZES)
        extent, before = np.empty((1, 5)), None if before is None else before.reshape(-1)
        call(shadows.lowest, small.shape, heights.reshape(-1), before, *heights.shape, BLOCK_SIZES[0], 1, small)
        ratio = BLOCK_SIZES[1] // BLOCK_SIZES[0]
        call(shadows.lowest, large.shape, small.reshape(-1), None, *small.shape[1:], ratio, 0, large)
        call(shadows.extents, (1,), small, extent)
        least, left, right, top, bottom = extent[0].tolist()
        return cls(heights, small[0], large[0], size, least, (left, right, top, bottom))


@njit(cache=False, error_model="numpy", fastmath=FAST_SUM_FLAGS, inline="always")
def horizon(
    terrain: Terrain,
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    reach: float,
    above: tuple[float, float],
    below: tuple[float, float],
) -> float:
    """Slope (rise per sideways way) of the steepest ray from a point that the face lets pass on its way to a light.

    Args:
        terrain: the face.
        x, y, z: the point [mm].
        dx, dy: unit vector sideways to the light.
        reach: sideways way [mm] to it.
        above, below: (least, greatest) slope of two bundles of rays, the steeper first. The result is exact within
            these ranges; outside, it only lies on the same side of each of the four limits as the horizon.
    """
    heights, small, large, size, lowest, box = terrain
    rows, columns = heights.shape
    wx, wy = size[0] / (columns - 1), size[1] / (rows - 1)
    u0, v0 = (x + size[0] / 2) / wx, (y + size[1] / 2) / wy  # in cells
    du, dv = dx / wx, dy / wy
    du = du if abs(du) > 1e-9 else 1e-9
    dv = dv if abs(dv) > 1e-9 else 1e-9
    across, down = 1.0 / du, 1.0 / dv
    right, under = 1 if du > 0.0 else 0, 1 if dv > 0.0 else 0
    step = 0.5 * (wx + wy)
    first, r = 1.5 * step, reach
    first = max(first, ((1 - right) * (columns - 1) - u0) * across, ((1 - under) * (rows - 1) - v0) * down) + 1e-6
    r = min(r, (right * (columns - 1) - u0) * across, (under * (rows - 1) - v0) * down) - 1e-6
    passed = limit = above[1]
    if lowest == np.inf:
        return float(passed)
    enter, leave = (box[0], box[1]) if right else (box[1], box[0])
    first, r = max(first, (enter - u0) * across), min(r, (leave - u0) * across - 1e-4)
    enter, leave = (box[2], box[3]) if under else (box[3], box[2])
    first, r = max(first, (enter - v0) * down), min(r, (leave - v0) * down - 1e-4)
    if limit < 0.0:  # farther away the ray is below the whole face
        r = min(r, (lowest - z) / limit)
    while r > first:  # from far to near: beyond a dome's rim this decides soonest
        u, v = u0 + r * du, v0 + r * dv
        i, j = np.uint32(u), np.uint32(v)
        bi, bj = i // BLOCK_SIZES_UINT[1], j // BLOCK_SIZES_UINT[1]
        drop = large[bj, bi] - z
        enter = max(
            ((bi + 1 - right) * LARGE_BLOCK_CELLS - u0) * across,
            ((bj + 1 - under) * LARGE_BLOCK_CELLS - v0) * down,
            first,
        )
        if drop >= limit * (enter if drop < 0.0 else r):
            r = min(enter, r) - 1e-4
            continue
        bi, bj = i // BLOCK_SIZES_UINT[0], j // BLOCK_SIZES_UINT[0]
        drop = small[bj, bi] - z
        enter = max(
            ((bi + 1 - right) * SMALL_BLOCK_CELLS - u0) * across,
            ((bj + 1 - under) * SMALL_BLOCK_CELLS - v0) * down,
            first,
        )
        if drop >= limit * (enter if drop < 0.0 else r):
            r = min(enter, r) - 1e-4
            continue
        while True:
            a, b = u - i, v - j
            rise = (1 - b) * ((1 - a) * heights[j, i] + a * heights[j, i + ONE_UINT]) - z
            rise += b * ((1 - a) * heights[j + ONE_UINT, i] + a * heights[j + ONE_UINT, i + ONE_UINT])
            if rise < limit * r:
                passed = limit = rise / r
                if passed <= below[0]:
                    return float(passed)
                if passed <= above[0]:
                    limit = min(passed, below[1])
            r -= step + 0.04 * r
            if r <= enter:
                break
            u, v = u0 + r * du, v0 + r * dv
            i, j = np.uint32(u), np.uint32(v)
    return float(passed)
