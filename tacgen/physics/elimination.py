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
# Subtracts a product of blocks: A[row + i, column + j] -= sum over k < inner of P[p_row + i, p_column + k], or of
# P[p_row + k, p_column + i] if TURNED, times Q[q_row + k, q_column + j]; i < rows, j < columns, and not above the
# diagonal if TURNED. By addresses that are counted on: an index of Warp is multiplied, and may be negative. Beyond the
# last row and column these are read again, since a load behind a branch waits for it.
SUBTRACTED = """
    SHARED alignas(16) NUMBER p[SIZE][SIZE + 4], q[SIZE][SIZE];  // 4 numbers spread columns over the banks of memory
    auto place = [b](wp::array_t<NUMBER>& M, int i, int j) {
        return M.data + (size_t(b) * M.strides[0] + size_t(i) * M.strides[1]) / sizeof(NUMBER) + j;
    };
    auto least = [](int a, int b) { return a < b ? a : b; };
    const NUMBER *from_p = place(P, p_row, p_column), *from_q = place(Q, q_row, q_column);
    NUMBER* to = place(A, row, column);
    const int p_step = P.strides[1] / sizeof(NUMBER), q_step = Q.strides[1] / sizeof(NUMBER);
    const int step = A.strides[1] / sizeof(NUMBER), across = TURNED ? rows : inner, down = TURNED ? inner : rows;
    NUMBER mine[SIZE][EACH], others[SIZE][EACH], left[SIZE][EACH], sum[SIZE][EACH];
    #pragma unroll
    for (int i = 0; i < SIZE; ++i) {
        #pragma unroll
        for (int c = 0; c < EACH; ++c) {
            const int j = c * LANES + lane;
            mine[i][c] = from_p[least(i, down - 1) * p_step + least(j, across - 1)];
            others[i][c] = from_q[least(i, inner - 1) * q_step + least(j, columns - 1)];
            left[i][c] = to[least(i, rows - 1) * step + least(j, columns - 1)];
        }
    }
    SYNCHRONIZE
    #pragma unroll
    for (int i = 0; i < SIZE; ++i) {
        #pragma unroll
        for (int c = 0; c < EACH; ++c) {
            const int j = c * LANES + lane;
            p[TURNED ? i : j][TURNED ? j : i] = (TURNED ? i : j) < inner ? mine[i][c] : NUMBER(0);  // [k][i]
            q[i][j] = others[i][c];
            sum[i][c] = NUMBER(0);
        }
    }
    SYNCHRONIZE
    #pragma unroll 4
    for (int k = 0; k < SIZE; ++k) {
        #pragma unroll
        for (int i = 0; i < SIZE; ++i) {
            #pragma unroll
            for (int c = 0; c < EACH; ++c) sum[i][c] += p[k][i] * q[k][c * LANES + lane];
        }
    }
    #pragma unroll
    for (int i = 0; i < SIZE; ++i) {
        #pragma unroll
        for (int c = 0; c < EACH; ++c) {
            const int j = c * LANES + lane;
            if (i < rows && j < columns && !(TURNED && column + j > row + i))
                to[i * step + j] = (fresh ? NUMBER(0) : left[i][c]) - sum[i][c];
        }
    }
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

    @wp.func_native(native(SUBTRACTED, "TURNED", False))
    def subtract(
        A: Rows, P: Rows, Q: Rows, b: int, row: int, column: int, p_row: int, p_column: int, q_row: int, q_column: int,
        rows: int, columns: int, inner: int, fresh: bool, lane: int,
    ): ...  # fmt: skip

    @wp.func_native(native(SUBTRACTED, "TURNED", True))
    def subtract_turned(
        A: Rows, P: Rows, Q: Rows, b: int, row: int, column: int, p_row: int, p_column: int, q_row: int, q_column: int,
        rows: int, columns: int, inner: int, fresh: bool, lane: int,
    ):  # fmt: skip
        """Where `fresh`, A counts as 0."""
        ...

    def factor_rows(A: Rows, R: Rows, info: wp.array(dtype=int), at: int, n: int):
        """A step of the factorisation by blocks: rows of [A | 1] from `at` on times the inverse factor of their block
        on the diagonal, into R (b, size, n). Before `at` A has the transformed unit matrix already."""
        b, tile, lane = wp.tid()
        block, columns = Block(), Block()
        for c in range(each):
            own = wp.static(c) * lanes + lane
            j, k = tile * size + own, at + own
            for i in range(size):
                here = at + wp.static(i)
                high, low = wp.min(wp.max(here, k), n - 1), wp.min(wp.min(here, k), n - 1)
                block[wp.static(i), wp.static(c)] = A[b, high, low]
                high, low = wp.min(wp.max(here, j), n - 1), wp.min(wp.min(here, j), n - 1)
                columns[wp.static(i), wp.static(c)] = A[b, high, low]
            unit = (j - at) / size == 0 and j >= at  # the block's own columns are those of the unit matrix
            for i in range(size):
                here, one = at + wp.static(i), wp.where(own == wp.static(i), number(1.0), number(0.0))
                block[wp.static(i), wp.static(c)] = wp.where(
                    wp.max(here, k) < n, block[wp.static(i), wp.static(c)], one
                )
                value = wp.where(wp.max(here, j) < n, columns[wp.static(i), wp.static(c)], number(0.0))
                columns[wp.static(i), wp.static(c)] = wp.where(unit, one, value)
        done = factored(block, columns)
        for c in range(each):
            j = tile * size + wp.static(c) * lanes + lane
            for i in range(size):
                if wp.max(j, at + wp.static(i)) < n:
                    R[b, wp.static(i), j] = done[wp.static(i), wp.static(c)]
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
        if tile > 0:
            fresh = first >= at and first < at + size
            subtract_turned(A, R, R, b, top, first, 0, top, 0, first, n - top, n - first, size, fresh, lane)
            return
        rows = Block()  # of the first tile
        for c in range(each):
            j = wp.min(first + wp.static(c) * lanes + lane, n - 1)
            for i in range(size):
                rows[wp.static(i), wp.static(c)] = R[b, wp.static(i), j]
        for c in range(each):
            j = first + wp.static(c) * lanes + lane
            for i in range(size):
                row = top + wp.static(i)
                if wp.max(row, j) < n:
                    A[b, row, j] = wp.where(j <= row, rows[wp.static(i), wp.static(c)], number(0.0))

    def pivot_rows(W: Rows, positive: wp.array(dtype=int), own: Longs, slots: Longs, first: int, at: int, n: int):
        """A step of Gauss-Jordan elimination by blocks: rows of W = [A | B] from `at` on times the inverse of their
        block on the diagonal, in the columns behind it."""
        s, tile, lane = wp.tid()
        rows = own_rows(own, slots, s, first, n)
        start, bad = wp.min(at + size, n) + size * tile, int(0)
        if at < rows and (start < rows or start + size > n or tile == 0):  # the first tells of the pivots
            block, columns = Block(), Block()
            for c in range(each):
                k = wp.static(c) * lanes + lane
                pivot, j = wp.min(at + k, n - 1), wp.min(start + k, W.shape[2] - 1)
                for i in range(size):
                    here = wp.min(at + wp.static(i), n - 1)
                    block[wp.static(i), wp.static(c)] = W[s, here, pivot]
                    columns[wp.static(i), wp.static(c)] = W[s, here, j]
                for i in range(size):
                    one = wp.where(k == wp.static(i), number(1.0), number(0.0))
                    there = at + wp.max(k, wp.static(i)) < n
                    block[wp.static(i), wp.static(c)] = wp.where(there, block[wp.static(i), wp.static(c)], one)
            done = eliminated(block, columns)
            bad = int(done[size, 0])
            for c in range(each):
                j = start + wp.static(c) * lanes + lane
                for i in range(size):
                    if wp.max(j - W.shape[2], at + wp.static(i) - n) < 0:
                        W[s, at + wp.static(i), j] = done[wp.static(i), wp.static(c)]
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
        columns, inner = W.shape[2] - start, wp.min(n - at, size)
        subtract(W, W, W, s, top, start, top, at, at, start, n - top, columns, inner, False, lane)

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
