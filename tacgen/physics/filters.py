"""Filters of pictures, as Warp kernels: a Gaussian, means over blocks and their splines, and curves by tables.

Pictures are flat, row by row and the values of a pixel together; a thread does a row.
"""

import warp as wp

from tacgen.physics.flat import get, is_nan, put
from tacgen.physics.types import Reals, Reals2, Vectors, real

MARGIN_BLOCKS = 2  # blocks around a picture that the splines need
MARGIN = wp.constant(MARGIN_BLOCKS)
BEFORE_LAST = wp.constant(real(1e-9))  # by which a place stays before a table's last entry [entries]


@wp.kernel(enable_backward=False, module="tacgen.optics")
def blurred(picture: Reals, down: Reals, across: Reals, rows: int, size: int, count: int, line: Reals, out: Reals):
    """A picture of rows of `size` numbers, `count` a pixel, averaged down and then across by weights (n,) of the
    distances 0 to n - 1 [px]; line: room for a row (rows, size + 2 count (n - 1)) each."""
    y = wp.tid()
    start, side = y * size, (across.shape[0] - 1) * count
    first = y * (size + 2 * side)
    middle = first + side
    i = int(0)
    while i < size:
        put(line, middle + i, get(down, 0) * get(picture, start + i))
        i += 1
    k = int(1)
    while k < down.shape[0]:
        weight, above, below = get(down, k), wp.max(y - k, 0) * size, wp.min(y + k, rows - 1) * size
        i = int(0)
        while i < size:
            value = get(line, middle + i) + weight * (get(picture, above + i) + get(picture, below + i))
            put(line, middle + i, value)
            i += 1
        k += 1
    i = int(0)
    while i < side:
        put(line, first + i, get(line, middle + i % count))
        put(line, middle + size + i, get(line, middle + size - count + i % count))
        i += 1
    i = int(0)
    while i < size:
        put(out, start + i, get(across, 0) * get(line, middle + i))
        i += 1
    k = int(1)
    while k < across.shape[0]:
        weight, before, after = get(across, k), middle - k * count, middle + k * count
        i = int(0)
        while i < size:
            value = get(out, start + i) + weight * (get(line, before + i) + get(line, after + i))
            put(out, start + i, value)
            i += 1
        k += 1


@wp.kernel(enable_backward=False, module="tacgen.optics")
def means(picture: Reals2, n: int, out: Reals2):
    """Means over blocks of n x n pixels of a picture (h, w) and of MARGIN_BLOCKS blocks around it, where its edge goes
    on."""
    j = wp.tid()
    h, w, scale = picture.shape[0], picture.shape[1], real(n * n)
    for i in range(out.shape[1]):
        total = real(0.0)
        y = (j - MARGIN) * n
        while y < (j - MARGIN + 1) * n:
            row, x = wp.clamp(y, 0, h - 1), (i - MARGIN) * n
            while x < (i - MARGIN + 1) * n:
                total += picture[row, wp.clamp(x, 0, w - 1)]
                x += 1
            y += 1
        out[j, i] = total / scale


@wp.func
def first_block(x: int, n: int) -> int:
    """The first of the four blocks whose splines reach a pixel."""
    return (2 * x + 1 + n) / (2 * n) - 2 + MARGIN


@wp.kernel(enable_backward=False, module="tacgen.optics")
def spread(coarse: Reals2, weights: Reals2, down: Reals2, out: Reals2):
    """A picture (h, w) by splines on blocks of n x n pixels, first down (h, blocks) and then across; weights (n, 4) at
    the pixels along a block of the splines of the four blocks that reach it."""
    y = wp.tid()
    n = weights.shape[0]
    row, at = first_block(y, n), y % n
    for x in range(coarse.shape[1]):
        total = real(0.0)
        for m in range(4):
            total += weights[at, m] * coarse[row + m, x]
        down[y, x] = total
    for x in range(out.shape[1]):
        column, at = first_block(x, n), x % n
        total = real(0.0)
        for m in range(4):
            total += weights[at, m] * down[y, column + m]
        out[y, x] = total


@wp.kernel(enable_backward=False, module="tacgen.optics")
def tabulated(x: Reals, first: real, step: real, values: Vectors, out: Vectors):
    """Values (n,) at x (n,) of a curve tabulated from `first` on, linear, constant beyond its ends; 1 where nan."""
    i = wp.tid()
    here, made = get(x, i), wp.vec3d(real(1.0), real(1.0), real(1.0))
    at = wp.clamp((here - first) / step, real(0.0), real(values.shape[0] - 1) - BEFORE_LAST)
    if not is_nan(here):
        k = int(at)
        low = get(values, k)
        made = low + (at - real(k)) * (get(values, k + 1) - low)
    put(out, i, made)
