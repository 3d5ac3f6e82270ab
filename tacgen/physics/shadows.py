"""Horizons of deformed faces, as Warp functions and kernels: the slope below which a face shades light from the side.

Faces are given by heights over a regular grid, frame after frame in flat arrays, and by the least of what casts shadows
in small and large blocks of cells of the grid, infinite where nothing does.
"""

import warp as wp

from tacgen.physics.flat import get
from tacgen.physics.types import Reals, Reals2, Reals3, real

SMALL_BLOCK_CELLS, LARGE_BLOCK_CELLS = 8, 32  # cells along the side of a block
MIN_SHADOWING_FALL_MM = 0.02  # smallest fall of a place since untouched with which it casts a shadow [mm]
SMALL, LARGE = wp.constant(SMALL_BLOCK_CELLS), wp.constant(LARGE_BLOCK_CELLS)
FALL = wp.constant(real(MIN_SHADOWING_FALL_MM))
FAR = wp.constant(real(float("inf")))
BEHIND = wp.constant(real(1e-4))  # way by which a ray goes on beyond a block's rim, into the next [mm]


@wp.struct
class Ground:
    """One face of several: where its numbers begin in the arrays, and its grid of `rows` x `columns` heights."""

    first: int
    small: int
    large: int
    rows: int
    columns: int
    small_columns: int
    large_columns: int
    middle: wp.vec2d  # half of the rectangle's sides [mm]
    pitch: wp.vec2d  # cells along each side [1/mm]
    step: real  # mean side of a cell [mm]
    lowest: real  # of what casts shadows [mm]
    box: wp.vec4d  # least and greatest column, least and greatest row beyond which nothing casts shadows [cells]


@wp.func
def blocks(count: int, cells: int) -> int:
    """Blocks of so many cells along a line of so many nodes."""
    return (count - 2) / cells + 1


@wp.func
def terrain(extent: Reals, f: int, rows: int, columns: int, wide: real, tall: real) -> Ground:
    """The face `f` over a rectangle of sides `wide`, `tall` [mm], by `extent` (5 f,), see `extents`."""
    t = Ground()
    t.rows = rows
    t.columns = columns
    t.small_columns = blocks(columns, SMALL)
    t.large_columns = blocks(columns, LARGE)
    t.first = f * rows * columns
    t.small = f * blocks(rows, SMALL) * t.small_columns
    t.large = f * blocks(rows, LARGE) * t.large_columns
    t.middle = wp.vec2d(real(0.5) * wide, real(0.5) * tall)
    t.pitch = wp.vec2d(real(columns - 1) / wide, real(rows - 1) / tall)
    t.step = real(0.5) * (wide / real(columns - 1) + tall / real(rows - 1))
    t.lowest = extent[5 * f]
    t.box = wp.vec4d(extent[5 * f + 1], extent[5 * f + 2], extent[5 * f + 3], extent[5 * f + 4])
    return t


@wp.func
def horizon(
    heights: Reals, small: Reals, large: Reals, t: Ground, x: real, y: real, z: real, dx: real, dy: real, reach: real,
    above: wp.vec2d, below: wp.vec2d,
) -> real:  # fmt: skip
    """Slope (rise per sideways way) of the steepest ray from a point that a face lets pass on its way to a light.

    Args:
        heights, small, large, t: the faces, and which one.
        x, y, z: the point [mm].
        dx, dy: unit vector sideways to the light.
        reach: sideways way [mm] to it.
        above, below: least and greatest slope of two bundles of rays, the steeper first. The result is exact within
            these ranges; outside, it only lies on the same side of each of the four limits as the horizon.
    """
    passed, limit = above[1], above[1]
    if t.lowest == FAR:
        return passed
    u0, v0 = (x + t.middle[0]) * t.pitch[0], (y + t.middle[1]) * t.pitch[1]  # in cells
    du, dv = dx * t.pitch[0], dy * t.pitch[1]
    du = wp.where(wp.abs(du) > real(1e-9), du, real(1e-9))
    dv = wp.where(wp.abs(dv) > real(1e-9), dv, real(1e-9))
    across, down = real(1.0) / du, real(1.0) / dv
    right, under = wp.where(du > real(0.0), 1, 0), wp.where(dv > real(0.0), 1, 0)
    last, bottom = real(t.columns - 1), real(t.rows - 1)
    first = wp.max(
        (wp.where(right == 1, real(0.0), last) - u0) * across, (wp.where(under == 1, real(0.0), bottom) - v0) * down
    )
    first = wp.max(first, real(1.5) * t.step) + real(1e-6)
    r = wp.min(
        (wp.where(right == 1, last, real(0.0)) - u0) * across, (wp.where(under == 1, bottom, real(0.0)) - v0) * down
    )
    r = wp.min(r, reach) - real(1e-6)
    first = wp.max(first, (wp.where(right == 1, t.box[0], t.box[1]) - u0) * across)
    first = wp.max(first, (wp.where(under == 1, t.box[2], t.box[3]) - v0) * down)
    r = wp.min(r, (wp.where(right == 1, t.box[1], t.box[0]) - u0) * across - BEHIND)
    r = wp.min(r, (wp.where(under == 1, t.box[3], t.box[2]) - v0) * down - BEHIND)
    if limit < real(0.0):  # farther away the ray is below the whole face
        r = wp.min(r, (t.lowest - z) / limit)
    enter = real(0.0)
    inside = bool(False)  # a block that must be walked through
    while r > first:  # from far to near: beyond a dome's rim this decides soonest
        u, v = u0 + r * du, v0 + r * dv
        i, j = int(u), int(v)
        if not inside:
            bi, bj = i / LARGE, j / LARGE
            drop = get(large, t.large + bj * t.large_columns + bi) - z
            enter = wp.max((real((bi + 1 - right) * LARGE) - u0) * across, (real((bj + 1 - under) * LARGE) - v0) * down)
            enter = wp.max(enter, first)
            skipped = drop >= limit * wp.where(drop < real(0.0), enter, r)
            if not skipped:
                bi, bj = i / SMALL, j / SMALL
                drop = get(small, t.small + bj * t.small_columns + bi) - z
                enter = wp.max(
                    (real((bi + 1 - right) * SMALL) - u0) * across, (real((bj + 1 - under) * SMALL) - v0) * down
                )
                enter = wp.max(enter, first)
                skipped = drop >= limit * wp.where(drop < real(0.0), enter, r)
            if skipped:
                r = wp.min(enter, r) - BEHIND
                continue
        a, b, at = u - real(i), v - real(j), t.first + j * t.columns + i
        rise = (real(1.0) - b) * ((real(1.0) - a) * get(heights, at) + a * get(heights, at + 1)) - z
        at += t.columns
        rise += b * ((real(1.0) - a) * get(heights, at) + a * get(heights, at + 1))
        if rise < limit * r:
            passed = rise / r
            limit = rise / r
            if passed <= below[0]:
                return passed
            if passed <= above[0]:
                limit = wp.min(passed, below[1])
        r -= t.step + real(0.04) * r
        inside = r > enter
    return passed


@wp.kernel(enable_backward=False, module="tacgen.optics")
def lowest(heights: Reals, before: Reals, rows: int, columns: int, cells: int, rim: int, out: Reals3):
    """Least of each block (f, n, m) of `cells` x `cells` entries of grids (f rows columns,), and of the `rim` entries
    beside them right and below; with rows in `before` (rows columns,), of those that have fallen since, else infinite.
    """
    f, bj, bi = wp.tid()
    least = real(wp.inf)
    last, right = wp.min((bj + 1) * cells + rim, rows), wp.min((bi + 1) * cells + rim, columns)
    fallen, start = before.shape[0] > 0, f * rows * columns
    j = bj * cells
    while j < last:
        i = j * columns + bi * cells
        end = j * columns + right
        while i < end:
            z = get(heights, start + i)
            if fallen:
                z = wp.where(z < get(before, i) - FALL, z, real(wp.inf))
            least = wp.min(least, z)
            i += 1
        j += 1
    out[f, bj, bi] = least


@wp.kernel(enable_backward=False, module="tacgen.optics")
def extents(small: Reals3, out: Reals2):
    """Least and box (f, 5) of `Ground`, by the least of small blocks (f, n, m); infinite at the grid's edges."""
    f = wp.tid()
    rows, columns = small.shape[1], small.shape[2]
    least = real(wp.inf)
    left, right, top, bottom = columns + 0, int(0), rows + 0, int(0)
    for j in range(rows):
        for i in range(columns):
            z = small[f, j, i]
            if z < FAR:
                least = wp.min(least, z)
                left, right = wp.min(left, i), wp.max(right, i + 1)
                top, bottom = wp.min(top, j), wp.max(bottom, j + 1)
    out[f, 0] = least
    out[f, 1] = wp.where(left > 0, real(left * SMALL), -FAR)
    out[f, 2] = wp.where(right < columns, real(right * SMALL), FAR)
    out[f, 3] = wp.where(top > 0, real(top * SMALL), -FAR)
    out[f, 4] = wp.where(bottom < rows, real(bottom * SMALL), FAR)
