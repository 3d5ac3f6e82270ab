"""Products of matrices in slots and vectors."""

from torch import Tensor

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
