"""Dense factors, solutions and products of many small matrices."""

import torch
from torch import Tensor

from tacgen.physics.elimination import ON_CORE, ON_GPU, Eliminations
from tacgen.physics.runtime import launch

MAX_DIRECT_ROWS = 320  # rows up to which a matrix is eliminated by our kernels alone; larger ones by halves
UPDATE_STRIP_COLUMNS = 192  # columns of an update that are computed at once, from the diagonal down: a multiple of 3
Own = tuple[Tensor, Tensor]  # numbers of rows by slot (capacity,), and slots (s,)


def half(n: int) -> int:
    """Rows of the first of two parts of a matrix of n rows, a multiple of those that kernels eliminate at once."""
    return 32 * round(n / 64 + 1e-9)


def _kernels(x: Tensor) -> Eliminations:
    """Kernels that eliminate blocks of such numbers, on a GPU of single precision."""
    return ON_GPU if x.is_cuda else ON_CORE[x.element_size()]


def invert_factor(A: Tensor) -> Tensor:
    """Overwrite symmetric matrices A (b, n, n), of which the lower triangle is read, by L^-1, where A = L L^T.

    Returns the leading minor (b,) that is not positive, 0 where the matrix is positive definite; where it is not,
    numbers mean nothing.
    """
    n = A.shape[-1]
    if n <= MAX_DIRECT_ROWS:
        return _inverse_factor(A)
    k = half(n)
    first, corner, low, last = A[:, :k, :k], A[:, :k, k:], A[:, k:, :k], A[:, k:, k:]
    info = invert_factor(first)
    L = times_transposed(low, first)
    last.baddbmm_(L, L.mT, alpha=-1)
    after = invert_factor(last)
    low.baddbmm_(last @ L, first, beta=0, alpha=-1)
    corner.zero_()
    return torch.where((info == 0) & (after > 0), after + k, info)


def _inverse_factor(A: Tensor) -> Tensor:
    b, n, info, by = len(A), A.shape[-1], torch.empty(len(A), dtype=torch.int32, device=A.device), _kernels(A)
    tiles = -(-n // by.size)
    R = A if tiles == 1 else A.new_empty(b, by.size, n)
    for at in range(0, n, by.size):
        launch(by.factor_rows, (b, tiles, by.lanes), A, R, info, at, n)
        if tiles > 1:
            launch(by.later_rows, (b, -(-(n - at) // by.size), tiles, by.lanes), A, R, at, n)
    return info


def eliminate(W: Tensor, n: int, own: Own | None = None, first: int = 0) -> Tensor:
    """Overwrite B of W = [A | B] (s, n, n + m) by A^-1 B, by Gauss-Jordan elimination without pivots, of blocks;
    numbers in A mean nothing afterwards, nor do others of a scene where a block is singular. own: numbers of rows of
    each slot's matrix (capacity,) and slots (s,), of a matrix whose rows before `first` are not those of W: beyond them
    A is the unit matrix, B is 0, and nothing is done.

    Returns which A (s,), if they are symmetric, are positive definite.
    """
    if n > MAX_DIRECT_ROWS:
        k = half(n)
        above, below = W[:, :k], W[:, k:]
        positive = eliminate(above, k, own, first)
        below[..., k:].baddbmm_(below[..., :k], above[..., k:], alpha=-1)
        positive = positive & eliminate(below[..., k:], n - k, own, first + k)
        above[..., n:].baddbmm_(above[..., k:n], below[..., n:], alpha=-1)
        return positive
    s, by = len(W), _kernels(W)
    counts, slots = own or (None, torch.arange(s, device=W.device))
    positive = torch.empty(s, dtype=torch.int32, device=W.device)
    for at in range(0, n, by.size):
        tiles = -(-(W.shape[2] - min(at + by.size, n)) // by.size)
        launch(by.pivot_rows, (s, tiles, by.lanes), W, positive, counts, slots, first, at, n)
        launch(by.other_rows, (s, -(-n // by.size), tiles, by.lanes), W, counts, slots, first, at, n)
    return positive > 0


def times_transposed(A: Tensor, L: Tensor) -> Tensor:
    """A L^T of A (b, m, w) and lower triangles L (b, w, w)."""
    w, out = L.shape[-1], A.new_empty(A.shape)
    for at in range(0, w, UPDATE_STRIP_COLUMNS):
        to = min(at + UPDATE_STRIP_COLUMNS, w)
        out[:, :, at:to].baddbmm_(A[:, :, :to], L[:, at:to, :to].mT, beta=0)
    return out


def squared(L: Tensor) -> Tensor:
    """L L^T from the diagonal down, of L (b, m, w); numbers elsewhere mean nothing."""
    m = L.shape[1]
    out = L.new_empty(len(L), m, m)
    for at in range(0, m, UPDATE_STRIP_COLUMNS):
        to = min(at + UPDATE_STRIP_COLUMNS, m)
        out[:, at:, at:to].baddbmm_(L[:, at:], L[:, at:to].mT, beta=0)
    return out
