"""Products of many small matrices and vectors, as sums: batched multiplication is slow for so few rows."""

from torch import Tensor


def times(A: Tensor, v: Tensor) -> Tensor:
    """A v of small matrices (..., m, n) and vectors (..., n)."""
    return (A * v[..., None, :]).sum(-1)


def product(A: Tensor, B: Tensor) -> Tensor:
    """A B of small matrices (..., m, n) and (..., n, k)."""
    return (A[..., :, :, None] * B[..., None, :, :]).sum(-2)


def outer(a: Tensor, b: Tensor) -> Tensor:
    """a b^T of vectors (..., m) and (..., n)."""
    return a[..., :, None] * b[..., None, :]
