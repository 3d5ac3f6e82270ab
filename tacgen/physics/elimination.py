"""Elimination of blocks of rows of many matrices, without pivots, as Warp kernels.

A warp of a GPU eliminates a block: each of its threads has a column, and is told by the others what it needs of theirs.
On a core one thread has all columns of a smaller block.
"""

from dataclasses import dataclass
from typing import Any

import warp as wp

from tacgen.physics.runtime import ELIMINATION, WARP_THREADS
from tacgen.physics.types import Longs

TOLD = """
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, value, lane);
#else
    return value;
#endif
"""


@wp.func_native(TOLD)
def told(value: wp.float32, lane: int) -> wp.float32: ...


@wp.func_native(TOLD)
def told(value: wp.float64, lane: int) -> wp.float64: ...  # noqa: F811  (Warp chooses by types)


# In C++, whose compiler unrolls these loops: rows stay in registers, and nothing is done with those that are 0. NUMBER,
# SIZE, LANES, EACH and choices are put in: a block has SIZE rows, and EACH of its columns to a lane.
ELIMINATED = """
    auto told = [](NUMBER value, int lane) {TOLD};
    wp::mat_t<SIZE + 1, EACH, NUMBER> out;
    int bad = 0;
    #pragma unroll
    for (int k = 0; k < SIZE; ++k) {
        const NUMBER pivot = told(A.data[k][k / LANES], k % LANES), scale = NUMBER(1) / pivot;
        if (bad == 0 && !(pivot > 0)) bad = k + 1;
        #pragma unroll
        for (int i = k + 1; i < SIZE; ++i) {
            const NUMBER down = told(A.data[i][k / LANES], k % LANES) * scale;
            #pragma unroll
            for (int c = 0; c < EACH; ++c) {
                A.data[i][c] -= down * A.data[k][c];
                B.data[i][c] -= down * B.data[k][c];
            }
        }
        const NUMBER size = SQUARE_ROOT ? scale * ::sqrt(pivot) : scale;
        #pragma unroll
        for (int c = 0; c < EACH; ++c) {
            A.data[k][c] *= size;
            B.data[k][c] *= size;
        }
    }
    #pragma unroll
    for (int k = SQUARE_ROOT ? 0 : SIZE - 1; k > 0; --k) {
        #pragma unroll
        for (int i = 0; i < k; ++i) {
            const NUMBER up = told(A.data[i][k / LANES], k % LANES);
            #pragma unroll
            for (int c = 0; c < EACH; ++c) B.data[i][c] -= up * B.data[k][c];
        }
    }
    #pragma unroll
    for (int c = 0; c < EACH; ++c) {
        #pragma unroll
        for (int i = 0; i < SIZE; ++i) out.data[i][c] = B.data[i][c];
        out.data[SIZE][c] = NUMBER(bad);
    }
    return out;
"""
PRODUCT = """
SHARED alignas(16) NUMBER p[SIZE][SIZE + 4], q[SIZE][SIZE];  // 4 numbers spread columns over the banks of memory
    SYNCHRONIZE
    #pragma unroll
    for (int i = 0; i < SIZE; ++i) {
        #pragma unroll
        for (int c = 0; c < EACH; ++c) {
            const int column = c * LANES + lane;
            p[TURNED ? i : column][TURNED ? column : i] = P.data[i][c];  // [k][i]
            q[i][column] = Q.data[i][c];
        }
    }
    SYNCHRONIZE
    wp::mat_t<SIZE, EACH, NUMBER> out;
    #pragma unroll 4
    for (int k = 0; k < SIZE; ++k) {
        #pragma unroll
        for (int i = 0; i < SIZE; ++i) {
            #pragma unroll
            for (int c = 0; c < EACH; ++c) out.data[i][c] += p[k][i] * q[k][c * LANES + lane];
        }
    }
    return out;
"""
ON_A_GPU = "\n#if defined(__CUDA_ARCH__)\n{}\n#endif\n"
SHARED, SYNCHRONIZE = ON_A_GPU.format("__shared__"), ON_A_GPU.format("__syncwarp();")


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
    Block = wp.types.matrix(shape=(size, each), dtype=number)
    Eliminated = wp.types.matrix(shape=(size + 1, each), dtype=number)
    Rows = wp.array3d(dtype=number)
    names = {"SIZE": size, "LANES": lanes, "EACH": each, "NUMBER": f"wp::{number.__name__}"}
    names |= {"TOLD": TOLD, "SHARED": SHARED, "SYNCHRONIZE": SYNCHRONIZE}

    def native(code: str, choice: str, chosen: bool) -> str:  # a function for each, called once, which is inlined
        for name, value in (names | {choice: str(chosen).lower()}).items():
            code = code.replace(name, str(value))
        return code

    @wp.func_native(native(ELIMINATED, "SQUARE_ROOT", False))
    def eliminated(A: Block, B: Block) -> Eliminated:  # type: ignore[valid-type]
        """The columns B after row operations that make A the unit matrix, and behind them the first pivot that is not
        positive, from 1 on, or 0."""
        ...

    @wp.func_native(native(ELIMINATED, "SQUARE_ROOT", True))
    def factored(A: Block, B: Block) -> Eliminated:  # type: ignore[valid-type]
        """As `eliminated`, by operations that make symmetric A = L L^T the upper triangle L^T."""
        ...

    @wp.func_native(native(PRODUCT, "TURNED", False))
    def product(P: Block, Q: Block, lane: int) -> Block: ...  # type: ignore[valid-type]

    @wp.func_native(native(PRODUCT, "TURNED", True))
    def turned_product(P: Block, Q: Block, lane: int) -> Block:  # type: ignore[valid-type]
        """P^T Q."""
        ...

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
        done = factored(block, columns)
        for i in range(size):
            row = wp.static(i)
            for c in range(each):
                j = tile * size + wp.static(c) * lanes + lane
                if j < n and at + row < n:
                    R[b, row, j] = done[row, wp.static(c)]
        if tile == 0 and lane == 0:
            known, bad = int(0), int(done[size, 0])
            if at > 0:
                known = info[b]
            info[b] = wp.where(known == 0 and bad > 0, bad + at, known)

    def later_rows(A: Rows, R: Rows, at: int, n: int):
        """Subtract the rows R (b, size, n) of a step from those below; and they take their places, with 0 above the
        diagonal."""
        b, tile, group, lane = wp.tid()
        top, first = at + tile * size, group * size
        if tile > 0 and first >= top + size:
            return
        P, Q, left = Block(), Block(), Block()
        for i in range(size):
            row = wp.static(i)
            for c in range(each):
                column = wp.static(c) * lanes + lane
                j = first + column
                P[row, wp.static(c)] = R[b, row, wp.min(top + column, n - 1)]
                Q[row, wp.static(c)] = R[b, row, wp.min(j, n - 1)]
                value = A[b, wp.min(top + row, n - 1), wp.min(j, n - 1)]
                left[row, wp.static(c)] = wp.where(j < at or j >= at + size, value, number(0.0))
        if tile == 0:
            left = Q
        else:
            left -= turned_product(P, Q, lane)
        for i in range(size):
            row = top + wp.static(i)
            for c in range(each):
                j = first + wp.static(c) * lanes + lane
                if row < n and j <= row:
                    A[b, row, j] = left[wp.static(i), wp.static(c)]
                elif tile == 0 and row < n and j < n:
                    A[b, row, j] = number(0.0)

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
                    columns[row, wp.static(c)] = W[s, here, wp.min(j, W.shape[2] - 1)]
            done = eliminated(block, columns)
            bad = int(done[size, 0])
            for i in range(size):
                row = wp.static(i)
                for c in range(each):
                    j = start + wp.static(c) * lanes + lane
                    if j < W.shape[2] and at + row < n:
                        W[s, at + row, j] = done[row, wp.static(c)]
        if tile == 0 and lane == 0:
            known = int(1)
            if at > 0:
                known = positive[s]
            positive[s] = wp.where(bad > 0, 0, known)

    def other_rows(W: Rows, own: Longs, slots: Longs, first: int, at: int, n: int):
        """Subtract these rows from all others, in the columns behind them."""
        s, tile, group, lane = wp.tid()
        rows, top, start = own_rows(own, slots, s, first, n), tile * size, wp.min(at + size, n) + group * size
        if top == at or top >= rows or at >= rows or (start >= rows and start + size <= n):
            return
        P, Q, left = Block(), Block(), Block()
        for i in range(size):
            row = wp.static(i)
            for c in range(each):
                column = wp.static(c) * lanes + lane
                j, here = wp.min(start + column, W.shape[2] - 1), wp.min(top + row, n - 1)
                P[row, wp.static(c)] = wp.where(at + column < n, W[s, here, wp.min(at + column, n - 1)], number(0.0))
                Q[row, wp.static(c)] = wp.where(at + row < n, W[s, wp.min(at + row, n - 1), j], number(0.0))
                left[row, wp.static(c)] = W[s, here, j]
        left -= product(P, Q, lane)
        for i in range(size):
            for c in range(each):
                j = start + wp.static(c) * lanes + lane
                if top + wp.static(i) < n and j < W.shape[2]:
                    W[s, top + wp.static(i), j] = left[wp.static(i), wp.static(c)]

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
