"""Products of matrices in slots and vectors: nothing is copied, and nothing else is read."""

from torch import Tensor

from tacgen.physics.runtime import BLOCK_THREADS, WARP_THREADS, lanes, launch
from tacgen.physics.substitution import PRODUCTS, SECTOR_NUMBERS, SHORT_ROW

Used = tuple[Tensor, Tensor]


def slot_times(A: Tensor, slots: Tensor, x: Tensor, transposed: bool = False, used: Used | None = None) -> Tensor:
    """The products (s, ..., r) of matrices A (capacity, ..., r, c) at slots (s,) and vectors x (s, ..., c), in the
    precision of x; transposed: of A^T (s, ..., c) and x (s, ..., r). used: numbers of rows and columns (capacity,)
    beyond which products are 0."""
    out = x.new_empty(*x.shape[:-1], A.shape[-1 if transposed else -2])
    matrices, vector, result = (part.unsqueeze(1) if A.dim() == 3 else part for part in (A, x, out))
    product(matrices, slots, vector, result, transposed=transposed, used=used)
    return out


def product(
    A: Tensor, slots: Tensor, x: Tensor, out: Tensor, *, transposed: bool = False, lower: bool = False,
    used: Used | None = None, start: Tensor | None = None, at: Tensor | None = None, to: Tensor | None = None,
) -> None:  # fmt: skip
    """A x, or start - A x, into `out`; see physics.substitution, whose arguments these are."""
    kernels, count = PRODUCTS[at is not None][transposed], A.shape[3 if transposed else 2]
    step = lanes(x, BLOCK_THREADS if transposed else WARP_THREADS)
    each = min(WARP_THREADS, step)  # results of so many threads
    if not transposed:
        each = max(step // SECTOR_NUMBERS, 1) if A.shape[3] <= SHORT_ROW else 1
    dim = len(slots) * A.shape[1], -(-count // each), step
    kernel = kernels[A.element_size(), x.element_size()]
    launch(kernel, dim, A, slots, *(used or (None, None)), lower, x, at, start, step, out, to)
