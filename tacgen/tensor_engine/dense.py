"""Dense factors and products of many small matrices; on a GPU parts of them are kernels."""

import torch
from torch import Tensor

MAX_DIRECT_ROWS = (
    320  # rows up to which a matrix is inverted by kernels of its own on a GPU, or by LAPACK; larger ones by halves
)
UPDATE_STRIP_COLUMNS = 192  # columns of an update that are computed at once, from the diagonal down: a multiple of 3


def fused(x: Tensor) -> bool:
    """Whether Triton's kernels do the work on such numbers."""
    return bool(x.is_cuda) and x.dtype == torch.float32


def half(n: int) -> int:
    """Rows of the first of two parts of a matrix of n rows, a multiple of those that kernels eliminate at once."""
    return 32 * round(n / 64 + 1e-9)


def invert_factor(A: Tensor) -> Tensor:
    """Overwrite symmetric matrices A (b, n, n), of which the lower triangle is read, by L^-1, where A = L L^T.

    Returns the leading minor (b,) that is not positive, 0 where the matrix is positive definite; where it is not,
    numbers mean nothing.
    """
    n = A.shape[-1]
    if n <= MAX_DIRECT_ROWS and fused(A):
        from tacgen.tensor_engine import gpu_blocks

        return gpu_blocks.lower_inverse(A)
    if n <= MAX_DIRECT_ROWS:
        L, info = torch.linalg.cholesky_ex(A)
        A.copy_(torch.linalg.solve_triangular(L, torch.eye(n, dtype=A.dtype, device=A.device), upper=False))
        return info
    k = half(n)
    first, corner, low, last = A[:, :k, :k], A[:, :k, k:], A[:, k:, :k], A[:, k:, k:]
    info = invert_factor(first)
    L = times_transposed(low, first)
    last.baddbmm_(L, L.mT, alpha=-1)
    after = invert_factor(last)
    low.baddbmm_(last @ L, first, beta=0, alpha=-1)
    corner.zero_()
    return torch.where((info == 0) & (after > 0), after + k, info)


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
