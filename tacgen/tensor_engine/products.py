"""Products of many small matrices and vectors, as sums: batched multiplication is slow for so few rows; and of matrices
in slots and vectors."""

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


Used = tuple[Tensor, Tensor]


def slot_times(A: Tensor, slots: Tensor, x: Tensor, transposed: bool = False, used: Used | None = None) -> Tensor:
    """The products (s, ..., r) of matrices A (capacity, ..., r, c) at slots (s,) and vectors x (s, ..., c), in the
    precision of x; transposed: of A^T (s, ..., c) and x (s, ..., r). used: numbers of rows and columns (capacity,)
    beyond which products are 0. On a GPU nothing is copied, and nothing else is read."""
    if A.is_cuda:
        from tacgen.tensor_engine import gpu_blocks

        return gpu_blocks.slot_times(A, slots, x, transposed, used)
    some = A[slots].to(x.dtype)
    return ((some.mT if transposed else some) @ x[..., None]).squeeze(-1)
