"""Inverses of small blocks on a GPU, one program each, by Triton: PyTorch's own take dozens of launches; and products
of matrices in slots, which PyTorch would copy first.

In plain operations the inverses are torch.linalg.cholesky_ex with solve_triangular, and torch.linalg.inv_ex, of numbers
of single precision. Imported only where there is a GPU.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

LARGEST = 64  # rows of a block
SIZES = ("at", "n", "block", "row", "column")  # no code of its own for each value that they may have


@triton.jit
def _loaded(first, i, j, n, row, column):
    """A square of a matrix of n rows, of the unit matrix beyond it."""
    return tl.load(first + i * row + j * column, mask=(i < n) & (j < n), other=tl.where(i == j, 1.0, 0.0))


@triton.jit
def _picked(M, there, axis: tl.constexpr):
    """The only number along an axis that is there: of integers, so that a row in one thread's registers is just read."""
    numbers = tl.where(there, M.to(tl.int32, bitcast=True), 0)
    return tl.sum(numbers, axis).to(tl.float32, bitcast=True)


@triton.jit
def _eliminated(M, SIZE: tl.constexpr):
    """L^-1 of symmetric M = L L^T, and its first leading minor that is not positive, 0 if all are.

    Row operations that make M an upper triangle make the unit matrix L^-1, but for the scale. A thread of one warp has
    a column, and gets the others' numbers of the row that is eliminated, which are those of the column too.
    """
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    X = tl.where(i == j, 1.0, 0.0)
    bad = 0
    for k in tl.static_range(SIZE):
        along = _picked(M, i == k, 0)
        down = tl.broadcast_to(along[:, None], (SIZE, SIZE))
        pivot = _picked(down, i == k, 0)[None, :]
        bad = tl.where((bad == 0) & ~(tl.min(pivot) > 0), k + 1, bad)
        factor = down * (1.0 / pivot)
        M = tl.where(i > k, M - factor * along[None, :], M)
        before = _picked(X, i == k, 0)[None, :]
        X = tl.where(i == k, X * (1.0 / tl.sqrt(pivot)), tl.where(i > k, X - factor * before, X))
    return X, bad


@triton.jit
def _block(first, n, row, column, SIZE: tl.constexpr, HALVES: tl.constexpr):
    """L^-1 of a block of n rows at `first`, or of SIZE and twice as many with HALVES, of which the lower triangle is
    read: its squares on the diagonal and the one below, and the first leading minor that is not positive."""
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    X, bad = _eliminated(_loaded(first, tl.maximum(i, j), tl.minimum(i, j), n, row, column), SIZE)
    Y, low = X, X
    if HALVES:
        L = tl.load(first + (i + SIZE) * row + j * column, mask=i + SIZE < n, other=0.0)
        L = tl.dot(L, tl.trans(X), input_precision="ieee")
        M = _loaded(first, SIZE + tl.maximum(i, j), SIZE + tl.minimum(i, j), n, row, column)
        Y, after = _eliminated(M - tl.dot(L, tl.trans(L), input_precision="ieee"), SIZE)
        bad = tl.where((bad == 0) & (after > 0), after + SIZE, bad)
        low = -tl.dot(tl.dot(Y, L, input_precision="ieee"), X, input_precision="ieee")
    return X, low, Y, bad


@triton.jit(do_not_specialize=SIZES)
def _lower_inverse(A, info, n, block, row, column, SIZE: tl.constexpr, HALVES: tl.constexpr):
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    first = A + tl.program_id(0).to(tl.int64) * block
    X, low, Y, bad = _block(first, n, row, column, SIZE, HALVES)
    tl.store(first + i * row + j * column, X, mask=(i < n) & (j < n))
    if HALVES:
        tl.store(first + (i + SIZE) * row + j * column, low, mask=i + SIZE < n)
        tl.store(first + i * row + (j + SIZE) * column, low * 0, mask=j + SIZE < n)
        tl.store(first + (i + SIZE) * row + (j + SIZE) * column, Y, mask=(i + SIZE < n) & (j + SIZE < n))
    tl.store(info + tl.program_id(0), bad)


@triton.jit(do_not_specialize=SIZES)
def _rows(A, R, info, at, n, block, row, column, SIZE: tl.constexpr):
    """A step of the elimination by blocks: the rows `at` ... at + 2 SIZE of [A | 1], times the inverse factor of their
    block on the diagonal, into R (b, 2 SIZE, n). Before `at` A has the transformed unit matrix already."""
    which = tl.program_id(0).to(tl.int64)
    start = A + which * block
    i, j = tl.arange(0, SIZE)[:, None], tl.program_id(1) * SIZE + tl.arange(0, SIZE)[None, :]
    X, low, Y, bad = _block(start + at * (row + column), n - at, row, column, SIZE, True)
    diagonal = (j >= at) & (j < at + 2 * SIZE)
    before = j < at
    first = start + tl.where(before, (at + i) * row + j * column, (at + i) * column + j * row)
    inside = ~diagonal & (j < n)
    upper = tl.load(first, mask=inside & (at + i < n), other=0.0)
    lower = tl.load(
        first + tl.where(before, SIZE * row, SIZE * column), mask=inside & (at + SIZE + i < n), other=0.0
    )
    upper = tl.where(diagonal & (j == at + i), 1.0, upper)
    lower = tl.where(diagonal & (j == at + SIZE + i), 1.0, lower)
    to = R + which * 2 * SIZE * n + i * n + j
    tl.store(to, tl.dot(X, upper, input_precision="ieee"), mask=j < n)
    lower = tl.dot(Y, lower, input_precision="ieee") + tl.dot(low, upper, input_precision="ieee")
    tl.store(to + SIZE * n, lower, mask=j < n)
    if tl.program_id(1) == 0:
        known = tl.load(info + which)
        tl.store(info + which, tl.where((known == 0) & (bad > 0), bad + at, known))


@triton.jit(do_not_specialize=SIZES)
def _later_rows(A, R, at, n, block, row, column, STEP: tl.constexpr, DEEP: tl.constexpr):
    """What the rows R (b, STEP, n) of a step leave of those below; and they take their places, with 0 above the
    diagonal."""
    which, tile = tl.program_id(0).to(tl.int64), tl.program_id(1)
    mine, first = at + tile * STEP + tl.arange(0, STEP), R + which * STEP * n
    j = tl.program_id(2) * STEP + tl.arange(0, STEP)
    place = A + which * block + mine[:, None] * row + j[None, :] * column
    inside = (mine < n)[:, None] & (j < n)[None, :]
    if tile == 0:
        there = inside & (j < at + STEP)[None, :]
        out = tl.load(first + (mine - at)[:, None] * n + j[None, :], mask=there, other=0.0)
        tl.store(place, out, mask=inside)
    elif tl.program_id(2) * STEP <= at + tile * STEP:
        left = tl.load(place, mask=inside & ((j < at) | (j >= at + STEP))[None, :], other=0.0)
        out = tl.zeros((STEP, STEP), tl.float32)
        for k in tl.static_range(0, STEP, DEEP):
            each = first + (k + tl.arange(0, DEEP))[:, None] * n
            P = tl.load(each + mine[None, :], mask=(mine < n)[None, :], other=0.0)
            Q = tl.load(each + j[None, :], mask=(j < n)[None, :], other=0.0)
            out = tl.dot(tl.trans(P), Q, out, input_precision="tf32x3")
        tl.store(place, left - out, mask=inside)


@triton.jit
def _inverted(M, SIZE: tl.constexpr):
    """M^-1 by Gauss-Jordan elimination in place, without pivots."""
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    for k in range(SIZE):
        along = tl.sum(tl.where(i == k, M, 0.0), 0)[None, :]
        down = tl.sum(tl.where(j == k, M, 0.0), 1)[:, None]
        pivot = tl.sum(tl.where(j == k, along, 0.0), 1)[:, None]
        along = tl.where(j == k, 1.0, along) / pivot
        M = tl.where(i == k, along, tl.where(j == k, 0.0, M) - down * along)
    return M


@triton.jit(do_not_specialize=SIZES)
def _inverse(A, n, block, row, column, SIZE: tl.constexpr, HALVES: tl.constexpr):
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    first = A + tl.program_id(0).to(tl.int64) * block
    P = _inverted(_loaded(first, i, j, n, row, column), SIZE)
    if HALVES:
        right = first + i * row + (j + SIZE) * column
        low = first + (i + SIZE) * row + j * column
        Q = tl.load(right, mask=j + SIZE < n, other=0.0)
        R = tl.load(low, mask=i + SIZE < n, other=0.0)
        below, beside = tl.dot(R, P, input_precision="ieee"), tl.dot(P, Q, input_precision="ieee")
        T = _loaded(first, i + SIZE, j + SIZE, n, row, column)
        T = _inverted(T - tl.dot(below, Q, input_precision="ieee"), SIZE)
        R = -tl.dot(T, below, input_precision="ieee")
        P = P - tl.dot(beside, R, input_precision="ieee")
        tl.store(low, R, mask=i + SIZE < n)
        tl.store(right, -tl.dot(beside, T, input_precision="ieee"), mask=j + SIZE < n)
        tl.store(right + SIZE * row, T, mask=(i + SIZE < n) & (j + SIZE < n))
    tl.store(first + i * row + j * column, P, mask=(i < n) & (j < n))


def lower_inverse(A: Tensor) -> Tensor:
    """Overwrite symmetric matrices A (b, n, n), of which the lower triangle is read, by L^-1, where A = L L^T.

    Returns the leading minors (b,) that are not positive, 0 where a matrix is positive definite.
    """
    n, info = A.shape[-1], torch.zeros(len(A), dtype=torch.int32, device=A.device)
    if n <= LARGEST:
        size = 16 if n <= 16 else 32
        _lower_inverse[(len(A),)](A, info, n, *A.stride(), SIZE=size, HALVES=n > size, num_warps=1)
        return info
    R = A.new_empty(len(A), LARGEST, n)
    for at in range(0, n, LARGEST):
        _rows[(len(A), triton.cdiv(n, LARGEST // 2))](
            A, R, info, at, n, *A.stride(), SIZE=LARGEST // 2, num_warps=1
        )
        grid = len(A), triton.cdiv(n - at, LARGEST), triton.cdiv(n, LARGEST)
        _later_rows[grid](A, R, at, n, *A.stride(), STEP=LARGEST, DEEP=32)
    return info


def inverse(A: Tensor) -> None:
    """Overwrite blocks A (b, n, n) by their inverses, without pivots."""
    n = A.shape[-1]
    size = 16 if n <= 16 else 32
    _inverse[(len(A),)](A, n, *A.stride(), SIZE=size, HALVES=n > size, num_warps=1 if n <= size else 4)


@triton.jit(do_not_specialize=("tiles", "rows", "columns"))
def _slot_times(
    A, SLOTS, X, Y, tiles, rows, columns, slot, tile, row, TURNED: tl.constexpr, SIZE: tl.constexpr, LONG: tl.constexpr
):  # fmt: skip
    which = tl.program_id(0).to(tl.int64)
    first = A + tl.load(SLOTS + which // tiles) * slot + which % tiles * tile
    mine, each = tl.program_id(1) * SIZE + tl.arange(0, SIZE), tl.arange(0, LONG)
    out = tl.zeros((SIZE,), Y.dtype.element_ty)
    if TURNED:
        k = 0
        while k < rows:  # Triton's interpreter has no range of such numbers
            j = k + each
            x = tl.load(X + which * rows + j, mask=j < rows, other=0.0)
            inside = (j < rows)[:, None] & (mine < columns)[None, :]
            M = tl.load(first + j[:, None] * row + mine[None, :], mask=inside, other=0.0)
            out += tl.sum(M.to(Y.dtype.element_ty) * x[:, None], 0)
            k += LONG
        tl.store(Y + which * columns + mine, out, mask=mine < columns)
    else:
        k = 0
        while k < columns:
            j = k + each
            x = tl.load(X + which * columns + j, mask=j < columns, other=0.0)
            inside = (mine < rows)[:, None] & (j < columns)[None, :]
            M = tl.load(first + mine[:, None] * row + j[None, :], mask=inside, other=0.0)
            out += tl.sum(M.to(Y.dtype.element_ty) * x[None, :], 1)
            k += LONG
        tl.store(Y + which * rows + mine, out, mask=mine < rows)


def slot_times(A: Tensor, slots: Tensor, x: Tensor, transposed: bool) -> Tensor:
    """products.slot_times of A (capacity, r, c) or (capacity, t, r, c), whose columns are next to each other."""
    (rows, columns), tiles = A.shape[-2:], x.shape[:-1].numel() // max(len(slots), 1)
    count = columns if transposed else rows
    y = x.new_zeros(*x.shape[:-1], count)
    if y.numel():
        # few of the results and much of a sum in a program: many programs, with few loads that wait for each other
        size, long = (32, 128 if transposed else 256) if max(rows, columns) > 64 else (32, 32)
        _slot_times[(len(slots) * tiles, triton.cdiv(count, size))](
            A, slots, x.contiguous(), y, tiles, rows, columns, A.stride(0), A.stride(-3) if A.dim() > 3 else 0,
            A.stride(-2), TURNED=transposed, SIZE=size, LONG=long,
        )  # fmt: skip
    return y
