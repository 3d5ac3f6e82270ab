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
SIZES = ("n", "block", "row", "column")  # no code of its own for each value that they may have


@triton.jit
def _loaded(first, i, j, n, row, column):
    """A square of a matrix of n rows, of the unit matrix beyond it."""
    return tl.load(first + i * row + j * column, mask=(i < n) & (j < n), other=tl.where(i == j, 1.0, 0.0))


@triton.jit
def _eliminated(M, SIZE: tl.constexpr):
    """L^-1 of symmetric M = L L^T, and its first leading minor that is not positive, 0 if all are.

    Row operations that make M an upper triangle make the unit matrix L^-1, but for the scale.
    """
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    X = tl.where(i == j, 1.0, 0.0)
    bad = 0
    for k in range(SIZE):
        along = tl.sum(tl.where(i == k, M, 0.0), 0)
        before = tl.sum(tl.where(i == k, X, 0.0), 0)
        down = tl.sum(tl.where(j == k, M, 0.0), 1)[:, None]
        pivot = tl.sum(tl.where(tl.arange(0, SIZE) == k, along, 0.0), 0)
        bad = tl.where((bad == 0) & ~(pivot > 0), k + 1, bad)
        factor = tl.where(i > k, down / pivot, 0.0)
        M = M - factor * along[None, :]
        X = tl.where(i == k, X / tl.sqrt(pivot), X - factor * before[None, :])
    return X, bad


@triton.jit(do_not_specialize=SIZES)
def _lower_inverse(A, info, n, block, row, column, SIZE: tl.constexpr, HALVES: tl.constexpr):
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    first = A + tl.program_id(0).to(tl.int64) * block
    X, bad = _eliminated(_loaded(first, tl.maximum(i, j), tl.minimum(i, j), n, row, column), SIZE)
    tl.store(first + i * row + j * column, X, mask=(i < n) & (j < n))
    if HALVES:
        low = (i + SIZE) * row + j * column
        L = tl.load(first + low, mask=i + SIZE < n, other=0.0)
        L = tl.dot(L, tl.trans(X), input_precision="ieee")
        M = _loaded(first, SIZE + tl.maximum(i, j), SIZE + tl.minimum(i, j), n, row, column)
        Y, after = _eliminated(M - tl.dot(L, tl.trans(L), input_precision="ieee"), SIZE)
        bad = tl.where((bad == 0) & (after > 0), after + SIZE, bad)
        L = tl.dot(tl.dot(Y, L, input_precision="ieee"), X, input_precision="ieee")
        tl.store(first + low, -L, mask=i + SIZE < n)
        tl.store(first + i * row + (j + SIZE) * column, L * 0, mask=j + SIZE < n)
        tl.store(first + (i + SIZE) * row + (j + SIZE) * column, Y, mask=(i + SIZE < n) & (j + SIZE < n))
    tl.store(info + tl.program_id(0), bad)


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
    """Overwrite symmetric blocks A (b, n, n), of which the lower triangle is read, by L^-1, where A = L L^T.

    Returns the leading minors (b,) that are not positive, 0 where a block is positive definite.
    """
    n, info = A.shape[-1], torch.zeros(len(A), dtype=torch.int32, device=A.device)
    size = 16 if n <= 16 else 32
    _lower_inverse[(len(A),)](A, info, n, *A.stride(), SIZE=size, HALVES=n > size, num_warps=1 if n <= size else 4)
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
