"""Adaptive evaluation of light, as Warp kernels: which samples are known, and which cells may be interpolated.

Cells hold the first and last row and column of samples. The kernels are serial, as their lists grow in order.
"""

import warp as wp

from tacgen.physics.flat import get, put
from tacgen.physics.types import Flags, Ints, Longs, Reals, Vectors, real


@wp.kernel(enable_backward=False, module="tacgen.optics")
def corners(cells: wp.array(dtype=wp.vec4i), known: Flags, width: int, out: Longs, count: Ints):
    """Flat indices (count,) of the corners of cells that are not `known` (h w,) yet; known from then on."""
    found = int(0)
    for m in range(cells.shape[0]):
        cell = cells[m]
        for y in range(2):
            for x in range(2, 4):
                at = cell[y] * width + cell[x]
                if not known[at]:
                    known[at] = True
                    out[found] = wp.int64(at)
                    found += 1
    count[0] = found


@wp.func
def straight(normals: Vectors, width: int, cell: wp.vec4i, down: real, across: real, bend: real) -> bool:
    """Whether all normals of a cell lie within `bend` of their bilinear interpolation; nan does not."""
    top, left = cell[0] * width, cell[2]
    bottom, right = cell[1] * width, cell[3]
    corner_a, corner_b = get(normals, top + left), get(normals, bottom + left)
    corner_c, corner_d = get(normals, top + right), get(normals, bottom + right)
    y = cell[0] + 0
    while y <= cell[1]:
        v = real(y - cell[0]) * down
        first = (real(1.0) - v) * corner_a + v * corner_b
        step = ((real(1.0) - v) * corner_c + v * corner_d - first) * across
        x = int(0)
        while x <= right - left:
            off = get(normals, y * width + left + x) - (first + real(x) * step)
            if not (wp.abs(off[0]) <= bend and wp.abs(off[1]) <= bend and wp.abs(off[2]) <= bend):
                return False
            x += 1
        y += 1
    return True


@wp.func
def alike(values: Reals, a: int, b: int, c: int, d: int, count: int, spread: real) -> bool:
    """Whether the `count` values at four places agree within a share."""
    for k in range(count):
        p, q, r, s = values[a + k], values[b + k], values[c + k], values[d + k]
        most = wp.max(wp.max(p, q), wp.max(r, s))
        if most - wp.min(wp.min(p, q), wp.min(r, s)) > spread * most:
            return False
    return True


@wp.kernel(enable_backward=False, module="tacgen.optics")
def filled(
    values: Reals, known: Flags, normals: Vectors, cells: wp.array(dtype=wp.vec4i), width: int, count: int, bend: real,
    spread: real, left: wp.array(dtype=wp.vec4i), number: Ints,
):  # fmt: skip
    """Interpolate values (h w, count) in place, but for what is `known` (h w,), in the cells that allow it; the halves
    of those that do not: left (number,)."""
    found = int(0)
    for m in range(cells.shape[0]):
        cell = cells[m]
        t, b, l, r = cell[0], cell[1], cell[2], cell[3]  # noqa: E741
        if b - t > 1 or r - l > 1:
            down, across = real(1.0) / real(b - t), real(1.0) / real(r - l)
            top, bottom = (t * width + l) * count, (b * width + l) * count
            wide = (r - l) * count
            even = alike(values, top, top + wide, bottom, bottom + wide, count, spread)
            if even and straight(normals, width, cell, down, across, bend):
                y = t + 0
                while y <= b:
                    v = real(y - t) * down
                    x = int(0)
                    while x <= r - l:
                        at = y * width + l + x
                        if not known[at]:
                            for c in range(count):
                                first = (real(1.0) - v) * get(values, top + c) + v * get(values, bottom + c)
                                last = (real(1.0) - v) * get(values, top + wide + c)
                                last += v * get(values, bottom + wide + c)
                                put(values, at * count + c, first + real(x) * ((last - first) * across))
                        x += 1
                    y += 1
            else:
                middle, centre = (t + b) / 2, (l + r) / 2
                for y in range(wp.where(middle > t, 2, 1)):
                    for x in range(wp.where(centre > l, 2, 1)):
                        left[found] = wp.vec4i(
                            wp.where(y == 1, middle, t), wp.where(y == 0 and middle > t, middle, b),
                            wp.where(x == 1, centre, l), wp.where(x == 0 and centre > l, centre, r),
                        )  # fmt: skip
                        found += 1
    number[0] = found
