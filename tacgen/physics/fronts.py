"""Fronts of the batched multifrontal method, as Warp kernels: a number is read where it comes from, and written once.

See tensor_engine.fronts for what the arrays hold. `which` is a front of a scene, scene * t + front.
"""

from typing import Any

import warp as wp

from tacgen.physics.types import Flags, Ints2, Ints3, Ints4, Longs, in_precisions


@wp.kernel(enable_backward=False, module="tacgen.batches")
def entries(elements: wp.array2d(dtype=Any), parts: Ints2, diagonal: Flags, out: wp.array3d(dtype=Any)):
    """The blocks (s, pairs + 1, 9) of matrices, see Multifrontal.assembled; elements (s, e 576), parts (pairs, 8)."""
    s, pair, n = wp.tid()
    total = out.dtype(0.0)
    if pair < parts.shape[0]:
        stiff = bool(False)
        for k in range(8):
            part = parts[pair, k]
            if part >= 0:
                total += elements[s, part + 24 * (n / 3) + n % 3]
                if diagonal[pair]:
                    for other in range(9):
                        stiff = stiff or elements[s, part + 24 * (other / 3) + other % 3] != out.dtype(0.0)
        if diagonal[pair] and n % 4 == 0 and not stiff:
            total = out.dtype(1.0)
    out[s, pair, n] = total


@wp.func
def summed(
    below: wp.array2d(dtype=Any), places: Ints4, first: Ints2, length: Ints2, scene: int, front: int, row: int,
    column: int,
):  # fmt: skip
    """A number of a front at a row and a column of its lower triangle: the sum of the children's updates, and the unit
    matrix where nodes are padding."""
    same = wp.min(scene, places.shape[0] - 1)  # all scenes may have the same places
    out = below.dtype(0.0)
    if row == column and places[same, front, 0, row / 3] == -2:
        out = below.dtype(1.0)
    for c in range(first.shape[1]):
        down, along = places[same, front, c, row / 3], places[same, front, c, column / 3]
        if down >= 0 and along >= 0:
            i, j = 3 * down + row % 3, 3 * along + column % 3
            out += below[scene, first[front, c] + wp.max(i, j) * length[front, c] + wp.min(i, j)]
    return out


@wp.kernel(enable_backward=False, module="tacgen.batches")
def assembled(
    data: wp.array2d(dtype=Any), below: wp.array2d(dtype=Any), places: Ints4, first: Ints2, length: Ints2,
    numbers: Ints3, whole: bool, out: wp.array3d(dtype=Any),
):  # fmt: skip
    """Own columns (s t, w + m, w) of fronts, see multifrontal.assembled; above the diagonal only if `whole`. numbers
    (t, w + m, w): of the matrix's blocks in data (s, pairs 9), -1 or the last where there is none."""
    which, row, column = wp.tid()
    if column > row and not whole:
        return
    fronts = places.shape[1]
    scene, front = which / fronts, which % fronts
    i, j = wp.max(row, column), wp.min(row, column)
    total = summed(below, places, first, length, scene, front, i, j)
    if numbers.shape[0] > 0 and j / 3 < numbers.shape[2]:
        number = numbers[front, i / 3, j / 3]
        if number >= 0:
            total += data[scene, 9 * number + 3 * (i % 3) + j % 3]
    out[which, row, column] = total


@wp.kernel(enable_backward=False, module="tacgen.batches")
def kept(
    columns: wp.array3d(dtype=Any), low: wp.array3d(dtype=Any), slots: Longs, inverse: wp.array4d(dtype=Any),
    under: wp.array4d(dtype=Any),
):  # fmt: skip
    """Factors (s t, w, w) and (s t, m, w) to where they are kept: at slots of inverse (capacity, t, n, l) and under
    (capacity, t, k, l), which are 0 beyond them."""
    which, row, column = wp.tid()
    fronts, tall = inverse.shape[1], inverse.shape[2]
    scene, front = which / fronts, which % fronts
    slot, value = slots[scene], columns.dtype(0.0)
    if row < tall:
        if row < columns.shape[2] and column < columns.shape[2]:
            value = columns[which, row, column] + value
        inverse[slot, front, row, column] = value
    else:
        i = row - tall
        if i < low.shape[1] and column < low.shape[2]:
            value = low[which, i, column] + value
        under[slot, front, i, column] = value


@wp.kernel(enable_backward=False, module="tacgen.batches")
def left(
    below: wp.array2d(dtype=Any), places: Ints4, first: Ints2, length: Ints2, squares: wp.array3d(dtype=Any),
    whole: bool, out: wp.array4d(dtype=Any),
):  # fmt: skip
    """Updates (s, t, m, m) of the other rows: the children's sums less the squares (s t, m, m), of lower triangles, or
    if `whole` of both."""
    which, row, column = wp.tid()
    if column > row:
        return
    fronts, w = places.shape[1], 3 * places.shape[3] - out.shape[2]
    scene, front = which / fronts, which % fronts
    value = summed(below, places, first, length, scene, front, w + row, w + column) - squares[which, row, column]
    out[scene, front, row, column] = value
    if whole:
        out[scene, front, column, row] = value


ENTRIES = in_precisions(entries, ("elements", "out"))
ASSEMBLED = in_precisions(assembled, ("data", "below", "out"))
KEPT = in_precisions(kept, ("columns", "low", "inverse", "under"))
LEFT = in_precisions(left, ("below", "squares", "out"))
