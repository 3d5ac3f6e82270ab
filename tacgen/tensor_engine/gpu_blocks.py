"""Inverses of small blocks on a GPU, one program each, by Triton: PyTorch's own take dozens of launches; and products
of matrices in slots, which PyTorch would copy first.

In plain operations the inverses are torch.linalg.cholesky_ex with solve_triangular, and torch.linalg.inv_ex, of numbers
of single precision. Imported only where there is a GPU.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

PRECISION = tl.constexpr("ieee")  # of products, see tl.dot
LARGEST = 64  # rows of a matrix that one program inverts, and of a tile of a larger one
STEP = 64  # rows of a larger one that are eliminated at once: 32 or 64
ALONE = {"num_warps": 1, "num_stages": 1}  # one warp, and no loads before their turn: it reads what it wrote
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
def _block(first, n, row, room, other, length, SIZE: tl.constexpr, HALVES: tl.constexpr):
    """L^-1 of a block of n rows at `first`, up to SIZE or with HALVES twice as many, of which the lower triangle is
    read: its squares on the diagonal and the one below, and the first leading minor that is not positive. At `room` and
    `other`, in rows of this length, there is room for squares."""
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    if HALVES:
        X = tl.zeros((SIZE, SIZE), tl.float32)
        Y, low, bad, source, stride = X, X, 0, first, row
        for half in range(2):  # one code for both
            X = Y
            Y, minor = _eliminated(_symmetric(source, n - half * SIZE, stride, SIZE), SIZE)
            bad = tl.where((bad == 0) & (minor > 0), minor + half * SIZE, bad)
            tl.debug_barrier()
            if half == 0:
                L = tl.load(first + (i + SIZE) * row + j, mask=i + SIZE < n, other=0.0)
                L = tl.dot(L, tl.trans(Y), input_precision=PRECISION)
                M = tl.load(first + (i + SIZE) * row + j + SIZE, mask=(i + SIZE < n) & (j <= i), other=0.0)
                M -= tl.dot(L, tl.trans(L), input_precision=PRECISION)
                tl.store(room + i * length + j, M, mask=(i + SIZE < n) & (j <= i))
                tl.store(other + i * length + j, L, mask=i + SIZE < n)
                tl.debug_barrier()
            source, stride = room, length
        L = tl.load(other + i * length + j, mask=i + SIZE < n, other=0.0)
        tl.debug_barrier()
        low = -tl.dot(tl.dot(Y, L, input_precision=PRECISION), X, input_precision=PRECISION)
    else:
        X, bad = _eliminated(_symmetric(first, n, row, SIZE), SIZE)
        Y, low = X, X
    return X, low, Y, bad


@triton.jit(do_not_specialize=SIZES)
def _lower_inverse(A, info, n, block, row, SIZE: tl.constexpr, HALVES: tl.constexpr):
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    first = A + tl.program_id(0).to(tl.int64) * block
    X, low, Y, bad = _block(first, n, row, first + SIZE * (row + 1), first + SIZE * row, row, SIZE, HALVES)
    tl.store(first + i * row + j, X, mask=(i < n) & (j < n))
    if HALVES:
        tl.store(first + (i + SIZE) * row + j, low, mask=i + SIZE < n)
        tl.store(first + i * row + j + SIZE, low * 0, mask=j + SIZE < n)
        tl.store(first + (i + SIZE) * row + j + SIZE, Y, mask=(i + SIZE < n) & (j + SIZE < n))
    tl.store(info + tl.program_id(0), bad)


@triton.jit(do_not_specialize=SIZES)
def _rows(A, R, info, at, n, block, row, length, SIZE: tl.constexpr, HALVES: tl.constexpr):
    """A step of the elimination by blocks: rows of [A | 1] from `at` on, SIZE or with HALVES twice as many, times the
    inverse factor of their block on the diagonal, into R (b, rows, length). Before `at` A has the transformed unit
    matrix already."""
    STEP: tl.constexpr = 2 * SIZE if HALVES else SIZE
    which = tl.program_id(0).to(tl.int64)
    start = A + which * block
    i, j = tl.arange(0, SIZE)[:, None], tl.program_id(1) * SIZE + tl.arange(0, SIZE)[None, :]
    to = R + which * STEP * length + tl.program_id(1) * SIZE
    X, low, Y, bad = _block(start + at * (row + 1), n - at, row, to, to + SIZE * length, length, SIZE, HALVES)
    to += i * length + tl.arange(0, SIZE)[None, :]
    before, inside = j < at, ((j < at) | (j >= at + STEP)) & (j < n)
    first = start + tl.where(before, (at + i) * row + j, at + i + j * row)
    upper = tl.load(first, mask=inside & (at + i < n), other=0.0)
    upper = tl.where(j == at + i, 1.0, upper)
    tl.store(to, tl.dot(X, upper, input_precision=PRECISION))
    if HALVES:
        lower = tl.load(first + tl.where(before, SIZE * row, SIZE), mask=inside & (at + SIZE + i < n), other=0.0)
        lower = tl.where(j == at + SIZE + i, 1.0, lower)
        lower = tl.dot(Y, lower, input_precision=PRECISION) + tl.dot(low, upper, input_precision=PRECISION)
        tl.store(to + SIZE * length, lower)
    if tl.program_id(1) == 0:
        known = tl.load(info + which, mask=at > 0, other=0)
        tl.store(info + which, tl.where((known == 0) & (bad > 0), bad + at, known))


@triton.jit(do_not_specialize=SIZES)
def _later_rows(A, R, at, n, block, row, length, STEP: tl.constexpr, TILE: tl.constexpr):
    """Subtract the rows R (b, STEP, length) of a step from those below; and they take their places, with 0 above the
    diagonal."""
    which, tile = tl.program_id(0).to(tl.int64), tl.program_id(1)
    first, j = R + which * STEP * length, tl.program_id(2) * TILE + tl.arange(0, TILE)
    if tile == 0:
        i = tl.arange(0, STEP)
        there = (j < tl.minimum(at + STEP, n))[None, :] & (at + i < n)[:, None]
        out = tl.load(first + i[:, None] * length + j[None, :], mask=there, other=0.0)
        place = A + which * block + (at + i)[:, None] * row + j[None, :]
        tl.store(place, out, mask=(at + i < n)[:, None] & (j < n)[None, :])
    elif tl.program_id(2) * TILE < at + STEP + tile * TILE:
        i = at + STEP + (tile - 1) * TILE + tl.arange(0, TILE)
        out = tl.zeros((TILE, TILE), tl.float32)
        for k in tl.static_range(0, STEP, 32):
            each = first + (k + tl.arange(0, 32))[:, None] * length
            P = tl.load(each + i[None, :], mask=(i < n)[None, :], other=0.0)
            Q = tl.load(each + j[None, :], mask=(j < n)[None, :], other=0.0)
            out = tl.dot(tl.trans(P), Q, out, input_precision=PRECISION)
        place = A + which * block + i[:, None] * row + j[None, :]
        inside = (i < n)[:, None] & (j < n)[None, :]
        left = tl.load(place, mask=inside & ((j < at) | (j >= at + STEP))[None, :], other=0.0)
        tl.store(place, left - out, mask=inside)


@triton.jit
def _inverted(M, SIZE: tl.constexpr):
    """M^-1 by Gauss-Jordan elimination in place, without pivots; columns are read from rows of N = M^T."""
    i, j, each = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :], tl.arange(0, SIZE)
    N = tl.where(i == j, M, tl.trans(M))  # the same; with M in it a compiler gives columns to threads as those of M
    for k in tl.static_range(SIZE):
        along, down = _picked(M, i == k, 0), _picked(N, i == k, 0)
        pivot = _picked(along, each == k, 0)
        along = tl.where(each == k, 1.0, along) / pivot
        M = tl.where(i == k, along[None, :], tl.where(j == k, 0.0, M) - down[:, None] * along[None, :])
        N = tl.where(i > k, tl.where(j == k, 0.0, N) - along[:, None] * tl.where(each == k, -1.0, down)[None, :], N)
    return M


@triton.jit(do_not_specialize=SIZES)
def _inverse(A, n, block, row, SIZE: tl.constexpr, HALVES: tl.constexpr):
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    first = A + tl.program_id(0).to(tl.int64) * block
    place = first + i * row + j
    right, low, last = place + SIZE, place + SIZE * row, place + SIZE * (row + 1)
    inside = (i + SIZE < n) & (j + SIZE < n)
    for half in range(2 if HALVES else 1):  # one code for both
        at = half * SIZE
        P = _inverted(_loaded(first + at * (row + 1), i, j, n - at, row), SIZE)
        tl.debug_barrier()
        tl.store(place + at * (row + 1), P, mask=(at + i < n) & (at + j < n))
        if HALVES and half == 0:
            below = tl.dot(tl.load(low, mask=i + SIZE < n, other=0.0), P, input_precision=PRECISION)
            less = tl.dot(below, tl.load(right, mask=j + SIZE < n, other=0.0), input_precision=PRECISION)
            tl.store(last, tl.load(last, mask=inside, other=0.0) - less, mask=inside)
            tl.debug_barrier()
            tl.store(low, below, mask=i + SIZE < n)
            tl.debug_barrier()
    if HALVES:
        tl.debug_barrier()
        P, T = tl.load(place), tl.load(last, mask=inside, other=0.0)
        Q, below = tl.load(right, mask=j + SIZE < n, other=0.0), tl.load(low, mask=i + SIZE < n, other=0.0)
        tl.debug_barrier()
        beside, R = tl.dot(P, Q, input_precision=PRECISION), -tl.dot(T, below, input_precision=PRECISION)
        tl.store(place, P - tl.dot(beside, R, input_precision=PRECISION))
        tl.store(low, R, mask=i + SIZE < n)
        tl.store(right, -tl.dot(beside, T, input_precision=PRECISION), mask=j + SIZE < n)


def lower_inverse(A: Tensor) -> Tensor:
    """Overwrite symmetric matrices A (b, n, n), of which the lower triangle is read, by L^-1, where A = L L^T.

    Returns the leading minors (b,) that are not positive, 0 where a matrix is positive definite.
    """
    n, info = A.shape[-1], torch.empty(len(A), dtype=torch.int32, device=A.device)
    if n <= LARGEST:
        size = 16 if n <= 16 else 32
        _lower_inverse[(len(A),)](A, info, n, A.stride(0), A.stride(1), SIZE=size, HALVES=n > size, **ALONE)
        return info
    tiles = triton.cdiv(n, 32)
    R = A.new_empty(len(A), STEP, 32 * tiles)
    sizes = n, A.stride(0), A.stride(1), R.shape[2]
    for at in range(0, n, STEP):
        _rows[(len(A), tiles)](A, R, info, at, *sizes, SIZE=32, HALVES=STEP > 32, **ALONE)
        later = 1 + triton.cdiv(max(n - at - STEP, 0), LARGEST)
        _later_rows[(len(A), later, triton.cdiv(n, LARGEST))](A, R, at, *sizes, STEP=STEP, TILE=LARGEST)
    return info


def inverse(A: Tensor) -> None:
    """Overwrite blocks A (b, n, n), n <= LARGEST, by their inverses, without pivots."""
    n = A.shape[-1]
    size = 16 if n <= 16 else 32
    _inverse[(len(A),)](A, n, A.stride(0), A.stride(1), SIZE=size, HALVES=n > size, **ALONE)


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


def slot_times(A: Tensor, slots: Tensor, x: Tensor, transposed: bool = False) -> Tensor:
    """products.slot_times of A (capacity, r, c) or (capacity, t, r, c), whose columns are next to each other."""
    (rows, columns), tiles = A.shape[-2:], x.shape[:-1].numel() // max(len(slots), 1)
    count = columns if transposed else rows
    y = x.new_empty(*x.shape[:-1], count)
    if y.numel():
        # few of the results and much of a sum in a program: many programs, with few loads that wait for each other
        size, long = (32, 128 if transposed else 256) if max(rows, columns) > 64 else (32, 32)
        _slot_times[(len(slots) * tiles, triton.cdiv(count, size))](
            A, slots, x.contiguous(), y, tiles, rows, columns, A.stride(0), A.stride(-3) if A.dim() > 3 else 0,
            A.stride(-2), TURNED=transposed, SIZE=size, LONG=long,
        )  # fmt: skip
    return y
