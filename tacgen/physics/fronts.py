"""Fronts of the batched multifrontal method, as Warp kernels: a number is read where it comes from, and written once.

See tensor_engine.multifrontal for what the arrays hold. `which` is a front of a scene, scene * t + front.
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
    """Numbers (3, 3) of a front at a row and a column of nodes in its lower triangle: the sum of the children's
    updates, and the unit matrix where nodes are padding."""
    same = wp.min(scene, places.shape[0] - 1)  # all scenes may have the same places
    out = wp.matrix(shape=(3, 3), dtype=below.dtype)
    if row == column and places[same, front, 0, row] == -2:
        for i in range(3):
            out[i, i] = below.dtype(1.0)
    for c in range(first.shape[1]):
        down, along = places[same, front, c, row], places[same, front, c, column]
        there = down >= 0 and along >= 0  # no branch stands before loads, which would wait for it
        start, step = first[front, c], length[front, c]
        part = wp.matrix(shape=(3, 3), dtype=below.dtype)
        for i in range(3):
            for j in range(3):
                k, n = 3 * wp.max(down, 0) + i, 3 * wp.max(along, 0) + j
                part[i, j] = below[scene, start + wp.max(k, n) * step + wp.min(k, n)]
        if there:
            out += part
    return out


@wp.kernel(enable_backward=False, module="tacgen.batches")
def assembled(
    data: wp.array2d(dtype=Any), below: wp.array2d(dtype=Any), places: Ints4, first: Ints2, length: Ints2,
    numbers: Ints3, whole: bool, out: wp.array3d(dtype=Any),
):  # fmt: skip
    """Own columns (s t, w + m, w) of fronts, see multifrontal.assembled; a thread has a node's rows and one's columns,
    those above the diagonal only if `whole`. numbers (t, w + m, w): of the matrix's blocks in data (s, pairs 9), -1 or
    the last where there is none."""
    which, row, column = wp.tid()
    if column > row and not whole:
        return
    fronts = places.shape[1]
    scene, front = which / fronts, which % fronts
    high, low = wp.max(row, column), wp.min(row, column)
    total = summed(below, places, first, length, scene, front, high, low)
    if numbers.shape[0] > 0 and low < numbers.shape[2]:
        number = numbers[front, high, low]
        if number >= 0:
            for i in range(3):
                for j in range(3):
                    from_row, from_column = i, j
                    if high == low:  # a block on the diagonal, whose lower triangle counts
                        from_row, from_column = wp.max(i, j), wp.min(i, j)
                    total[i, j] += data[scene, 9 * number + 3 * from_row + from_column]
    for i in range(3):
        for j in range(3):
            if column > row:
                out[which, 3 * row + j, 3 * column + i] = total[i, j]
            else:
                out[which, 3 * row + i, 3 * column + j] = total[i, j]


@wp.kernel(enable_backward=False, module="tacgen.batches")
def kept(
    columns: wp.array3d(dtype=Any), low: wp.array3d(dtype=Any), slots: Longs, inverse: wp.array4d(dtype=Any),
    under: wp.array4d(dtype=Any),
):  # fmt: skip
    """Factors (s t, w, w) and (s t, m, w) to where they are kept: at slots of inverse (capacity, t, n, l) and under
    (capacity, t, k, l), which are 0 beyond them; a thread has three columns."""
    which, row, three = wp.tid()
    fronts, tall = inverse.shape[1], inverse.shape[2]
    scene, front = which / fronts, which % fronts
    slot = slots[scene]
    for j in range(3):
        column = 3 * three + j
        if column >= inverse.shape[3]:
            return
        if row < tall:
            value = columns.dtype(0.0)
            if row < columns.shape[2] and column < columns.shape[2]:
                value = columns[which, row, column] + value
            inverse[slot, front, row, column] = value
        else:
            i, value = row - tall, columns.dtype(0.0)
            if i < low.shape[1] and column < low.shape[2]:
                value = low[which, i, column] + value
            under[slot, front, i, column] = value


@wp.kernel(enable_backward=False, module="tacgen.batches")
def left(
    below: wp.array2d(dtype=Any), places: Ints4, first: Ints2, length: Ints2, squares: wp.array3d(dtype=Any),
    whole: bool, out: wp.array4d(dtype=Any),
):  # fmt: skip
    """Updates (s, t, m, m) of the other rows: the children's sums less the squares (s t, m, m), of lower triangles, or
    if `whole` of both; a thread has a node's rows and one's columns."""
    which, row, column = wp.tid()
    if column > row:
        return
    fronts, w = places.shape[1], places.shape[3] - out.shape[2] / 3
    scene, front = which / fronts, which % fronts
    square = wp.matrix(shape=(3, 3), dtype=out.dtype)
    for i in range(3):
        for j in range(3):
            k, n = 3 * row + i, 3 * column + j
            square[i, j] = squares[which, wp.max(k, n), wp.min(k, n)]
    total = summed(below, places, first, length, scene, front, w + row, w + column) - square
    for i in range(3):
        for j in range(3):
            k, n, value = 3 * row + i, 3 * column + j, total[i, j]
            out[scene, front, k, n] = value
            if whole:
                out[scene, front, n, k] = value


ENTRIES = in_precisions(entries, ("elements", "out"))
ASSEMBLED = in_precisions(assembled, ("data", "below", "out"))
KEPT = in_precisions(kept, ("columns", "low", "inverse", "under"))
LEFT = in_precisions(left, ("below", "squares", "out"))
