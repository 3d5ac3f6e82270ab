"""Inverse factors of matrices and solutions of systems on a GPU, by Triton: a warp inverts 32 rows, and larger matrices
go in steps of as many, of two launches. And products of matrices in slots, which PyTorch would copy first.

In plain operations these are torch.linalg.cholesky_ex with solve_triangular, and torch.linalg.solve, of numbers of
single precision. Imported only where there is a GPU.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

DOT_PRECISION = tl.constexpr("ieee")  # of products, see tl.dot
ELIMINATED_ROWS = 32  # rows of a matrix that are eliminated at once, and that one program inverts
PRODUCT_TILE = 64  # rows and columns of a product that a program computes
SINGLE_WARP = {"num_warps": 1, "num_stages": 1}  # one warp, and no loads before their turn: it reads what it wrote
# no code of its own for each value that they may have
UNSPECIALIZED_BLOCKS = ("first", "at", "n", "width", "later", "block", "row", "length")


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


@triton.jit(do_not_specialize=UNSPECIALIZED_BLOCKS)
def _lower_inverse(A, info, n, block, row, SIZE: tl.constexpr):
    i, j = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    first = A + tl.program_id(0).to(tl.int64) * block
    X, bad = _eliminated(_symmetric(first, n, row, SIZE), SIZE)
    tl.store(first + i * row + j, X, mask=(i < n) & (j < n))
    tl.store(info + tl.program_id(0), bad)


@triton.jit(do_not_specialize=UNSPECIALIZED_BLOCKS)
def _rows(A, R, info, at, n, block, row, length, SIZE: tl.constexpr):
    """A step of the elimination by blocks: rows of [A | 1] from `at` on times the inverse factor of their block on the
    diagonal, into R (b, SIZE, length). Before `at` A has the transformed unit matrix already."""
    which = tl.program_id(0).to(tl.int64)
    start = A + which * block
    i, j = tl.arange(0, SIZE)[:, None], tl.program_id(1) * SIZE + tl.arange(0, SIZE)[None, :]
    X, bad = _eliminated(_symmetric(start + at * (row + 1), n - at, row, SIZE), SIZE)
    inside = ((j < at) | (j >= at + SIZE)) & (j < n) & (at + i < n)
    rows = tl.load(start + tl.where(j < at, (at + i) * row + j, at + i + j * row), mask=inside, other=0.0)
    rows = tl.dot(X, tl.where(j == at + i, 1.0, rows), input_precision=DOT_PRECISION)
    tl.store(R + which * SIZE * length + i * length + j, rows)
    if tl.program_id(1) == 0:
        known = tl.load(info + which, mask=at > 0, other=0)
        tl.store(info + which, tl.where((known == 0) & (bad > 0), bad + at, known))


@triton.jit(do_not_specialize=UNSPECIALIZED_BLOCKS)
def _later_rows(A, R, at, n, block, row, length, STEP: tl.constexpr, TILE: tl.constexpr):
    """Subtract the rows R (b, ELIMINATED_ROWS, length) of a step from those below; and they take their places, with 0
    above the diagonal."""
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
            out = tl.dot(tl.trans(P), Q, out, input_precision=DOT_PRECISION)
        place = A + which * block + i[:, None] * row + j[None, :]
        inside = (i < n)[:, None] & (j < n)[None, :]
        left = tl.load(place, mask=inside & ((j < at) | (j >= at + STEP))[None, :], other=0.0)
        tl.store(place, left - out, mask=inside)


@triton.jit
def _inverted(M, SIZE: tl.constexpr):
    """M^-1 by Gauss-Jordan elimination in place, without pivots, and whether all pivots are positive. A thread has a
    column, and asks that of each pivot for its numbers by shuffles."""
    i, j, each = tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :], tl.arange(0, SIZE)
    positive = tl.full((SIZE,), 1, tl.int32)
    for k in tl.static_range(SIZE):
        down = tl.gather(M, tl.full((SIZE, SIZE), k, tl.int32), 1)
        along, pivot = tl.where(each == k, 1.0, _picked(M, i == k, 0)), _picked(down, i == k, 0)
        positive = tl.where(pivot > 0, positive, 0)
        along = along * (1.0 / pivot)
        M = tl.where(i == k, along[None, :], tl.where(j == k, 0.0, M) - down * along[None, :])
    return M, tl.min(positive, 0)


@triton.jit
def _columns(tile, at, n, width, later, SIZE: tl.constexpr):
    """The first column of a tile, `later` of which are of A behind the block at `at`, all others of B; and where it
    ends."""
    in_A = tile < later
    return tl.where(in_A, at + SIZE * (1 + tile), n + SIZE * (tile - later)), tl.where(in_A, n, width)


@triton.jit
def _own(OWN, SLOTS, which, first, n, GIVEN: tl.constexpr):
    """How many rows of a scene's matrix, from `first` on, are not those of the unit matrix."""
    own = n
    if GIVEN:
        own = (tl.load(OWN + tl.load(SLOTS + which)) - first).to(tl.int32)
    return own


@triton.jit(do_not_specialize=UNSPECIALIZED_BLOCKS)
def _pivot_rows(
    W, POSITIVE, OWN, SLOTS, first, at, n, width, later, block, row, SIZE: tl.constexpr, GIVEN: tl.constexpr
):  # fmt: skip
    """A step of Gauss-Jordan elimination by blocks: rows from `at` on times the inverse of their block on the diagonal,
    in the columns of A behind it, which are `later` tiles, and in those of B. All programs invert it: that takes less
    time than another launch."""
    which, i, each = tl.program_id(0).to(tl.int64), tl.arange(0, SIZE)[:, None], tl.arange(0, SIZE)[None, :]
    own = _own(OWN, SLOTS, which, first, n, GIVEN)
    start, limit = _columns(tl.program_id(1), at, n, width, later, SIZE)
    positive = 1
    if (at < own) & ((start < own) | (start >= n) | (tl.program_id(1) == 0)):  # the first tells of the pivots
        rows = W + which * block + (at + i) * row
        there, other = (at + i < n) & (at + each < n), tl.where(i == each, 1.0, 0.0)
        X, positive = _inverted(tl.load(rows + at + each, mask=there, other=other), SIZE)
        inside = (at + i < n) & (start + each < limit)
        old = tl.load(rows + start + each, mask=inside, other=0.0)
        tl.store(rows + start + each, tl.dot(X, old, input_precision=DOT_PRECISION), mask=inside)
    if tl.program_id(1) == 0:
        tl.store(POSITIVE + which, tl.load(POSITIVE + which, mask=at > 0, other=1) & positive)


@triton.jit(do_not_specialize=UNSPECIALIZED_BLOCKS)
def _other_rows(
    W, OWN, SLOTS, first, at, n, width, later, block, row, SIZE: tl.constexpr, GIVEN: tl.constexpr
):  # fmt: skip
    """Subtract these rows from all others."""
    which, top = tl.program_id(0).to(tl.int64), tl.program_id(1) * SIZE
    own = _own(OWN, SLOTS, which, first, n, GIVEN)
    start, limit = _columns(tl.program_id(2), at, n, width, later, SIZE)
    if (top != at) & (top < own) & (at < own) & ((start < own) | (start >= n)):
        W += which * block
        each = tl.arange(0, SIZE)
        i, j, pivots = top + each[:, None], start + each[None, :], at + each < n
        P = tl.load(W + i * row + at + each[None, :], mask=(i < n) & pivots[None, :], other=0.0)
        Q = tl.load(W + (at + each[:, None]) * row + j, mask=pivots[:, None] & (j < limit), other=0.0)
        place, inside = W + i * row + j, (i < n) & (j < limit)
        left = tl.load(place, mask=inside, other=0.0)
        tl.store(place, left - tl.dot(P, Q, input_precision=DOT_PRECISION), mask=inside)


def lower_inverse(A: Tensor) -> Tensor:
    """Overwrite symmetric matrices A (b, n, n), of which the lower triangle is read, by L^-1, where A = L L^T.

    Returns the leading minors (b,) that are not positive, 0 where a matrix is positive definite.
    """
    n, info = A.shape[-1], torch.empty(len(A), dtype=torch.int32, device=A.device)
    if n <= ELIMINATED_ROWS:
        _lower_inverse[(len(A),)](A, info, n, A.stride(0), A.stride(1), SIZE=16 if n <= 16 else 32, **SINGLE_WARP)
        return info
    tiles = triton.cdiv(n, ELIMINATED_ROWS)
    R = A.new_empty(len(A), ELIMINATED_ROWS, ELIMINATED_ROWS * tiles)
    sizes = n, A.stride(0), A.stride(1), R.shape[2]
    for at in range(0, n, ELIMINATED_ROWS):
        _rows[(len(A), tiles)](A, R, info, at, *sizes, SIZE=ELIMINATED_ROWS, **SINGLE_WARP)
        later = 1 + triton.cdiv(max(n - at - ELIMINATED_ROWS, 0), PRODUCT_TILE)
        _later_rows[(len(A), later, triton.cdiv(n, PRODUCT_TILE))](
            A, R, at, *sizes, STEP=ELIMINATED_ROWS, TILE=PRODUCT_TILE
        )
    return info


def eliminate(W: Tensor, n: int, own: tuple[Tensor, Tensor] | None = None, first: int = 0) -> Tensor:
    """reduction.eliminate, of matrices of any size."""
    s, _, width = W.shape
    given, (counts, slots) = own is not None, own or (W, W)
    positive = torch.empty(s, dtype=torch.int32, device=W.device)
    for at in range(0, n, ELIMINATED_ROWS):
        later = triton.cdiv(max(n - at - ELIMINATED_ROWS, 0), ELIMINATED_ROWS)
        tiles, sizes = (
            later + triton.cdiv(width - n, ELIMINATED_ROWS),
            (first, at, n, width, later, W.stride(0), W.stride(1)),
        )
        _pivot_rows[(s, tiles)](W, positive, counts, slots, *sizes, SIZE=ELIMINATED_ROWS, GIVEN=given, **SINGLE_WARP)
        _other_rows[(s, triton.cdiv(n, ELIMINATED_ROWS), tiles)](
            W, counts, slots, *sizes, SIZE=ELIMINATED_ROWS, GIVEN=given, **SINGLE_WARP
        )
    return positive > 0


@triton.jit(do_not_specialize=("tiles", "rows", "columns"))
def _slot_times(
    A, SLOTS, DOWN, ACROSS, X, Y, tiles, rows, columns, slot, tile, row,
    USED: tl.constexpr, TURNED: tl.constexpr, SIZE: tl.constexpr, LONG: tl.constexpr,
):  # fmt: skip
    which = tl.program_id(0).to(tl.int64)
    kept = tl.load(SLOTS + which // tiles)
    first, down, across = A + kept * slot + which % tiles * tile, rows, columns
    if USED:
        down, across = tl.minimum(tl.load(DOWN + kept), rows), tl.minimum(tl.load(ACROSS + kept), columns)
    mine, each = tl.program_id(1) * SIZE + tl.arange(0, SIZE), tl.arange(0, LONG)
    out, k = tl.zeros((SIZE,), Y.dtype.element_ty), 0
    if TURNED:
        down = tl.where(tl.program_id(1) * SIZE < across, down, 0)
        while k < down:  # Triton's interpreter has no range of such numbers
            j = k + each
            x = tl.load(X + which * rows + j, mask=j < down, other=0.0)
            inside = (j < down)[:, None] & (mine < across)[None, :]
            M = tl.load(first + j[:, None] * row + mine[None, :], mask=inside, other=0.0)
            out += tl.sum(M.to(Y.dtype.element_ty) * x[:, None], 0)
            k += LONG
        tl.store(Y + which * columns + mine, out, mask=mine < columns)
    else:
        across = tl.where(tl.program_id(1) * SIZE < down, across, 0)
        while k < across:
            j = k + each
            x = tl.load(X + which * columns + j, mask=j < across, other=0.0)
            inside = (mine < down)[:, None] & (j < across)[None, :]
            M = tl.load(first + mine[:, None] * row + j[None, :], mask=inside, other=0.0)
            out += tl.sum(M.to(Y.dtype.element_ty) * x[None, :], 1)
            k += LONG
        tl.store(Y + which * rows + mine, out, mask=mine < rows)


def slot_times(
    A: Tensor, slots: Tensor, x: Tensor, transposed: bool = False, used: tuple[Tensor, Tensor] | None = None
) -> Tensor:
    """products.slot_times of A (capacity, r, c) or (capacity, t, r, c), whose columns are next to each other."""
    (rows, columns), tiles = A.shape[-2:], x.shape[:-1].numel() // max(len(slots), 1)
    count = columns if transposed else rows
    y = x.new_empty(*x.shape[:-1], count)
    if y.numel():
        # few of the results and much of a sum in a program: many programs, with few loads that wait for each other
        size, long = (32, 128 if transposed else 256) if max(rows, columns) > 64 else (32, 32)
        _slot_times[(len(slots) * tiles, triton.cdiv(count, size))](
            A, slots, *(used or (slots, slots)), x.contiguous(), y, tiles, rows, columns, A.stride(0),
            A.stride(-3) if A.dim() > 3 else 0, A.stride(-2), USED=used is not None, TURNED=transposed, SIZE=size,
            LONG=long,
        )  # fmt: skip
    return y
