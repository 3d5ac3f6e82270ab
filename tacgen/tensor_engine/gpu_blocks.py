"""Inverses of small blocks on a GPU, one program each, by Triton: PyTorch's own take dozens of launches; and products
of matrices in slots, which PyTorch would copy first.

In plain operations the inverses are torch.linalg.cholesky_ex with solve_triangular, and torch.linalg.inv_ex, of numbers
of single precision. Imported only where there is a GPU.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

PRECISION = tl.constexpr("tf32x3")  # of products, see tl.dot: three of tensor cores have that of single precision
LARGEST = 64  # rows of a block
SIZES = ("at", "n", "block", "row", "length")  # no code of its own for each value that they may have


@triton.jit
def _loaded(first, i, j, n, row):
    """A square of a matrix of n rows, of the unit matrix beyond it."""
    return tl.load(first + i * row + j, mask=(i < n) & (j < n), other=tl.where(i == j, 1.0, 0.0))


@triton.jit
def _symmetric(first, n, row, SIZE: tl.constexpr):
    """A square of a symmetric matrix of n rows, of which the lower triangle is read; of the unit matrix beyond it."""
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    low = tl.load(first + i * row + j, mask=(i < n) & (j <= i), other=0.0)
    return tl.where(i == j, tl.where(i < n, low, 1.0), low + tl.trans(low))


@triton.jit
def _picked(M, there, axis: tl.constexpr):
    """The only number along an axis that is there: in integers, where adding 0 is nothing that a compiler must do."""
    numbers = tl.where(there, M.to(tl.int32, bitcast=True), 0)
    return tl.sum(numbers, axis).to(tl.float32, bitcast=True)


@triton.jit
def _eliminated(M, SIZE: tl.constexpr):
    """L^-1 of symmetric M = L L^T, and its first leading minor that is not positive, 0 if all are.

    Row operations that make M an upper triangle make the unit matrix L^-1, but for the scale; its columns take the
    place of those eliminated. A thread of one warp has a column, and gets from the others the row that is eliminated,
    which is the column below as well.
    """
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    bad = 0
    for k in tl.static_range(SIZE):
        down = _picked(M, i == k, 0)
        pivot = _picked(down, tl.arange(0, SIZE) == k, 0)
        bad = tl.where((bad == 0) & ~(pivot > 0), k + 1, bad)
        along = tl.where(tl.arange(0, SIZE) == k, 1.0, down)
        M = tl.where(i > k, tl.where(j == k, 0.0, M) - down[:, None] * (along * (1.0 / pivot))[None, :], M)
        M = tl.where(i == k, along[None, :] * (1.0 / tl.sqrt(pivot)), M)
    return tl.where(j <= i, M, 0.0), bad


@triton.jit
def _block(first, n, row, room, length, SIZE: tl.constexpr, HALVES: tl.constexpr):
    """L^-1 of a block of n rows at `first`, up to SIZE or with HALVES twice as many, of which the lower triangle is
    read: its squares on the diagonal and the one below, and the first leading minor that is not positive. At `room`, in
    rows of this length, there is room for a square: what is written and read again is in columns of threads."""
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    X, bad = _eliminated(_symmetric(first, n, row, SIZE), SIZE)
    Y, low = X, X
    if HALVES:
        L = tl.load(first + (i + SIZE) * row + j, mask=i + SIZE < n, other=0.0)
        L = tl.dot(L, tl.trans(X), input_precision=PRECISION)
        place, inside = first + (i + SIZE) * row + j + SIZE, (i + SIZE < n) & (j <= i)
        M = tl.load(place, mask=inside, other=0.0) - tl.dot(L, tl.trans(L), input_precision=PRECISION)
        tl.store(room + i * length + j, M, mask=inside)
        tl.debug_barrier()
        Y, after = _eliminated(_symmetric(room, n - SIZE, length, SIZE), SIZE)
        tl.debug_barrier()
        bad = tl.where((bad == 0) & (after > 0), after + SIZE, bad)
        low = -tl.dot(tl.dot(Y, L, input_precision=PRECISION), X, input_precision=PRECISION)
    return X, low, Y, bad


@triton.jit(do_not_specialize=SIZES)
def _lower_inverse(A, info, n, block, row, SIZE: tl.constexpr, HALVES: tl.constexpr):
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    first = A + tl.program_id(0).to(tl.int64) * block
    X, low, Y, bad = _block(first, n, row, first + SIZE * (row + 1), row, SIZE, HALVES)
    tl.store(first + i * row + j, X, mask=(i < n) & (j < n))
    if HALVES:
        tl.store(first + (i + SIZE) * row + j, low, mask=i + SIZE < n)
        tl.store(first + i * row + j + SIZE, low * 0, mask=j + SIZE < n)
        tl.store(first + (i + SIZE) * row + j + SIZE, Y, mask=(i + SIZE < n) & (j + SIZE < n))
    tl.store(info + tl.program_id(0), bad)


@triton.jit(do_not_specialize=SIZES)
def _rows(A, R, info, at, n, block, row, length, SIZE: tl.constexpr):
    """A step of the elimination by blocks: the rows `at` ... at + 2 SIZE of [A | 1], times the inverse factor of their
    block on the diagonal, into R (b, 2 SIZE, length). Before `at` A has the transformed unit matrix already."""
    which = tl.program_id(0).to(tl.int64)
    start = A + which * block
    i, j = tl.arange(0, SIZE)[:, None], tl.program_id(1) * SIZE + tl.arange(0, SIZE)[None, :]
    to = R + which * 2 * SIZE * length + tl.program_id(1) * SIZE
    X, low, Y, bad = _block(start + at * (row + 1), n - at, row, to, length, SIZE, True)
    to += i * length + tl.arange(0, SIZE)[None, :]
    before, diagonal = j < at, (j >= at) & (j < at + 2 * SIZE)
    first = start + tl.where(before, (at + i) * row + j, at + i + j * row)
    inside = ~diagonal & (j < n)
    upper = tl.load(first, mask=inside & (at + i < n), other=0.0)
    lower = tl.load(first + tl.where(before, SIZE * row, SIZE), mask=inside & (at + SIZE + i < n), other=0.0)
    upper = tl.where(diagonal & (j == at + i), 1.0, upper)
    lower = tl.where(diagonal & (j == at + SIZE + i), 1.0, lower)
    tl.store(to, tl.dot(X, upper, input_precision=PRECISION))
    lower = tl.dot(Y, lower, input_precision=PRECISION) + tl.dot(low, upper, input_precision=PRECISION)
    tl.store(to + SIZE * length, lower)
    if tl.program_id(1) == 0:
        known = tl.load(info + which, mask=at > 0, other=0)
        tl.store(info + which, tl.where((known == 0) & (bad > 0), bad + at, known))


@triton.jit(do_not_specialize=SIZES)
def _later_rows(A, R, at, n, block, row, length, STEP: tl.constexpr, DEEP: tl.constexpr):
    """What the rows R (b, STEP, length) of a step leave of those below; and they take their places, with 0 above the
    diagonal."""
    which, tile = tl.program_id(0).to(tl.int64), tl.program_id(1)
    mine, first = at + tile * STEP + tl.arange(0, STEP), R + which * STEP * length
    j = tl.program_id(2) * STEP + tl.arange(0, STEP)
    place = A + which * block + mine[:, None] * row + j[None, :]
    inside = (mine < n)[:, None] & (j < n)[None, :]
    if tile == 0:
        there = inside & (j < at + STEP)[None, :]
        out = tl.load(first + (mine - at)[:, None] * length + j[None, :], mask=there, other=0.0)
        tl.store(place, out, mask=inside)
    elif tl.program_id(2) * STEP <= at + tile * STEP:
        out = tl.zeros((STEP, STEP), tl.float32)
        for k in tl.static_range(0, STEP, DEEP):
            each = first + (k + tl.arange(0, DEEP))[:, None] * length
            P = tl.load(each + mine[None, :], mask=(mine < n)[None, :], other=0.0)
            Q = tl.load(each + j[None, :], mask=(j < n)[None, :], other=0.0)
            out = tl.dot(tl.trans(P), Q, out, input_precision=PRECISION)
        left = tl.load(place, mask=inside & ((j < at) | (j >= at + STEP))[None, :], other=0.0)
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
def _inverse(A, n, block, row, SIZE: tl.constexpr, HALVES: tl.constexpr):
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    first = A + tl.program_id(0).to(tl.int64) * block
    P = _inverted(_loaded(first, i, j, n, row), SIZE)
    if HALVES:
        right = first + i * row + (j + SIZE)
        low = first + (i + SIZE) * row + j
        Q = tl.load(right, mask=j + SIZE < n, other=0.0)
        R = tl.load(low, mask=i + SIZE < n, other=0.0)
        below, beside = tl.dot(R, P, input_precision=PRECISION), tl.dot(P, Q, input_precision=PRECISION)
        T = _loaded(first, i + SIZE, j + SIZE, n, row)
        T = _inverted(T - tl.dot(below, Q, input_precision=PRECISION), SIZE)
        R = -tl.dot(T, below, input_precision=PRECISION)
        P = P - tl.dot(beside, R, input_precision=PRECISION)
        tl.store(low, R, mask=i + SIZE < n)
        tl.store(right, -tl.dot(beside, T, input_precision=PRECISION), mask=j + SIZE < n)
        tl.store(right + SIZE * row, T, mask=(i + SIZE < n) & (j + SIZE < n))
    tl.store(first + i * row + j, P, mask=(i < n) & (j < n))


def lower_inverse(A: Tensor) -> Tensor:
    """Overwrite symmetric matrices A (b, n, n), of which the lower triangle is read, by L^-1, where A = L L^T.

    Returns the leading minors (b,) that are not positive, 0 where a matrix is positive definite.
    """
    n, info = A.shape[-1], torch.empty(len(A), dtype=torch.int32, device=A.device)
    if n <= LARGEST:
        size = 16 if n <= 16 else 32
        _lower_inverse[(len(A),)](A, info, n, A.stride(0), A.stride(1), SIZE=size, HALVES=n > size, num_warps=1)
        return info
    tiles = triton.cdiv(n, LARGEST // 2)
    R = A.new_empty(len(A), LARGEST, LARGEST // 2 * tiles)
    sizes = n, A.stride(0), A.stride(1), R.shape[2]
    for at in range(0, n, LARGEST):
        _rows[(len(A), tiles)](A, R, info, at, *sizes, SIZE=LARGEST // 2, num_warps=1)
        grid = len(A), triton.cdiv(n - at, LARGEST), triton.cdiv(n, LARGEST)
        _later_rows[grid](A, R, at, *sizes, STEP=LARGEST, DEEP=32)
    return info


def inverse(A: Tensor) -> None:
    """Overwrite blocks A (b, n, n) by their inverses, without pivots."""
    n = A.shape[-1]
    size = 16 if n <= 16 else 32
    _inverse[(len(A),)](A, n, A.stride(0), A.stride(1), SIZE=size, HALVES=n > size, num_warps=1 if n <= size else 4)


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
