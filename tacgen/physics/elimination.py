"""Elimination of blocks of rows of many matrices, without pivots, as Warp kernels.

A warp of a GPU eliminates a block: each of its threads has a column, and is told by the others what it needs of theirs.
On a core one thread has all columns of a smaller block.
"""

from dataclasses import dataclass
from typing import Any

import warp as wp

from tacgen.physics.runtime import ELIMINATION, WARP_THREADS
from tacgen.physics.types import Longs


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, value, lane);
#else
    return value;
#endif
""")
def told(value: wp.float32, lane: int) -> wp.float32: ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, value, lane);
#else
    return value;
#endif
""")
def told(value: wp.float64, lane: int) -> wp.float64: ...  # noqa: F811  (Warp chooses by types)


@dataclass(frozen=True)
class Eliminations:
    """Kernels for blocks of `size` rows, of numbers of a type, by so many `lanes`: threads of a block of rows."""

    size: int
    lanes: int
    factor_rows: wp.Kernel
    later_rows: wp.Kernel
    pivot_rows: wp.Kernel
    other_rows: wp.Kernel


@wp.func
def own_rows(own: Longs, slots: Longs, which: int, first: int, n: int):
    """How many rows of a scene's matrix, from `first` on, are not those of the unit matrix."""
    if own.shape[0] > 0:
        return int(own[slots[which]]) - first
    return n


def _kernels(size: int, lanes: int, number: Any, key: str, module: str) -> Eliminations:
    each = size // lanes
    several = int(each > 1)  # so that a GPU's compiler knows the only column
    Block = wp.types.matrix(shape=(size, each), dtype=number)
    Column = wp.types.vector(length=size, dtype=number)
    Rows = wp.array3d(dtype=number)

    @wp.func
    def eliminated(A: Block, B: Block, lane: int, square_root: bool):
        """The columns B, and the first pivot of A that is not positive, from 1 on, or 0, after row operations that make
        A the unit matrix; or, for the `square_root`, an upper triangle L^T of symmetric A = L L^T.

        The row that is eliminated is the first one, and moves behind the others: registers have no numbers."""
        bad = int(0)
        k = int(0)
        while k < size:
            mine, owner = k / lanes * several, k % lanes
            pivot = told(A[0, mine], owner)
            if bad == 0 and not pivot > number(0.0):
                bad = k + 1
            scale = number(1.0) / pivot
            along, beside = A[0] * scale, B[0] * scale
            last = size - k  # rows from here on are eliminated
            for i in range(1, size):
                row = wp.static(i)
                down = told(A[row, mine], owner)
                if square_root and row >= last:
                    down = number(0.0)
                A[wp.static(i - 1)] = A[row] - down * along
                B[wp.static(i - 1)] = B[row] - down * beside
            if square_root:
                root = wp.sqrt(pivot)
                along, beside = along * root, beside * root
            A[wp.static(size - 1)] = along
            B[wp.static(size - 1)] = beside
            k += 1
        return B, bad

    def factor_rows(A: Rows, R: Rows, info: wp.array(dtype=int), at: int, n: int):
        """A step of the factorisation by blocks: rows of [A | 1] from `at` on times the inverse factor of their block
        on the diagonal, into R (b, size, n). Before `at` A has the transformed unit matrix already."""
        b, tile, lane = wp.tid()
        block, columns = Block(), Block()
        for i in range(size):
            row = wp.static(i)
            for c in range(each):
                own = wp.static(c) * lanes + lane
                j = tile * size + own
                here, high, low = at + row, wp.min(at + wp.max(row, own), n - 1), wp.min(at + wp.min(row, own), n - 1)
                value = wp.where(own == row, number(1.0), number(0.0))
                block[row, wp.static(c)] = wp.where(wp.max(here, at + own) < n, A[b, high, low], value)
                high, low = wp.min(wp.max(here, j), n - 1), wp.min(wp.min(here, j), n - 1)
                value = wp.where(here < n and j < n, A[b, high, low], number(0.0))
                unit = wp.where(j == here, number(1.0), number(0.0))
                columns[row, wp.static(c)] = wp.where(j < at or j >= at + size, value, unit)
        columns, bad = eliminated(block, columns, lane, True)
        for i in range(size):
            row = wp.static(i)
            for c in range(each):
                j = tile * size + wp.static(c) * lanes + lane
                if j < n and at + row < n:
                    R[b, row, j] = columns[row, wp.static(c)]
        if tile == 0 and lane == 0:
            known = int(0)
            if at > 0:
                known = info[b]
            info[b] = wp.where(known == 0 and bad > 0, bad + at, known)

    def later_rows(A: Rows, R: Rows, at: int, n: int):
        """Subtract the rows R (b, size, n) of a step from those below; and they take their places, with 0 above the
        diagonal."""
        b, tile, j = wp.tid()
        top = at + tile * size
        if tile == 0:
            for i in range(size):
                if top + i < n:
                    A[b, top + i, j] = wp.where(j <= top + i, R[b, i, j], number(0.0))
        elif j < top + size:
            out = Column()
            k = int(0)
            while k < size:
                factor = R[b, k, j]
                for i in range(size):
                    out[wp.static(i)] += factor * R[b, k, wp.min(top + wp.static(i), n - 1)]
                k += 1
            for i in range(size):
                row = top + wp.static(i)
                if row < n and j <= row:
                    left = number(0.0)
                    if j < at or j >= at + size:
                        left = A[b, row, j] + number(0.0)
                    A[b, row, j] = left - out[wp.static(i)]

    def pivot_rows(W: Rows, positive: wp.array(dtype=int), own: Longs, slots: Longs, first: int, at: int, n: int):
        """A step of Gauss-Jordan elimination by blocks: rows of W = [A | B] from `at` on times the inverse of their
        block on the diagonal, in the columns behind it."""
        s, tile, lane = wp.tid()
        rows = own_rows(own, slots, s, first, n)
        start, bad = wp.min(at + size, n) + size * tile, int(0)
        if at < rows and (start < rows or start + size > n or tile == 0):  # the first tells of the pivots
            block, columns = Block(), Block()
            for i in range(size):
                row = wp.static(i)
                for c in range(each):
                    k = wp.static(c) * lanes + lane
                    here, j = wp.min(at + row, n - 1), start + k
                    value = wp.where(k == row, number(1.0), number(0.0))
                    there = at + row < n and at + k < n
                    block[row, wp.static(c)] = wp.where(there, W[s, here, wp.min(at + k, n - 1)], value)
                    value = W[s, here, wp.min(j, W.shape[2] - 1)] + number(0.0)
                    columns[row, wp.static(c)] = wp.where(at + row < n and j < W.shape[2], value, number(0.0))
            columns, bad = eliminated(block, columns, lane, False)
            for i in range(size):
                row = wp.static(i)
                for c in range(each):
                    j = start + wp.static(c) * lanes + lane
                    if j < W.shape[2] and at + row < n:
                        W[s, at + row, j] = columns[row, wp.static(c)]
        if tile == 0 and lane == 0:
            known = int(1)
            if at > 0:
                known = positive[s]
            positive[s] = wp.where(bad > 0, 0, known)

    def other_rows(W: Rows, own: Longs, slots: Longs, first: int, at: int, n: int):
        """Subtract these rows from all others, in the columns behind them."""
        s, tile, column = wp.tid()
        rows, top, j = own_rows(own, slots, s, first, n), tile * size, wp.min(at + size, n) + column
        if top == at or top >= rows or at >= rows or (j >= rows and j < n):
            return
        out = Column()
        k = int(0)
        while k < size and at + k < n:
            factor = W[s, at + k, j]
            for i in range(size):
                out[wp.static(i)] += factor * W[s, wp.min(top + wp.static(i), n - 1), at + k]
            k += 1
        for i in range(size):
            if top + wp.static(i) < n:
                W[s, top + wp.static(i), j] = W[s, top + wp.static(i), j] - out[wp.static(i)]

    made = (
        wp.Kernel(f, key=f"{f.__name__}_{key}", module=wp.get_module(module), options={"enable_backward": False})
        for f in (factor_rows, later_rows, pivot_rows, other_rows)
    )
    return Eliminations(size, lanes, *made)


ON_GPU = _kernels(WARP_THREADS, WARP_THREADS, wp.float32, "gpu", ELIMINATION)
ON_CORE = {  # by the bytes of a number
    size: _kernels(8, 1, number, f"core{size}", "tacgen.elimination_on_core")
    for size, number in ((4, wp.float32), (8, wp.float64))
}
