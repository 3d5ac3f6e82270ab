"""Functions of many points that a GPU runs as a few kernels, not as one for each operation."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

import torch
from torch import Tensor

F = TypeVar("F", bound=Callable[..., Any])
VERSIONS = 64  # most versions of a function, for sizes that are 1 or not, before it runs as it is written
on = False  # whether anything is compiled: it takes a minute, which long runs make up for


def wanted(x: Tensor) -> bool:
    """Whether functions of x are compiled."""
    return on and bool(x.is_cuda)


def fused(function: F) -> F:
    """The function, which is compiled when it is first called with tensors on a GPU; on a CPU it is as it is."""
    compiled: list[Callable[..., Any]] = []

    @wraps(function)
    def call(*args: Any) -> Any:
        if not wanted(args[0]):
            return function(*args)
        if not compiled:
            torch._dynamo.config.recompile_limit = VERSIONS
            torch.fx.experimental._config.use_duck_shape = False  # sizes that happen to be equal are still two
            compiled.append(torch.compile(function, dynamic=True, fullgraph=True))
        return compiled[0](*args)

    return cast(F, call)


def times(A: Tensor, v: Tensor) -> Tensor:
    """A v of small matrices (..., m, n) and vectors (..., n), as sums that are fused."""
    return (A * v[..., None, :]).sum(-1)


def product(A: Tensor, B: Tensor) -> Tensor:
    """A B of small matrices (..., m, n) and (..., n, k), as sums that are fused."""
    return (A[..., :, :, None] * B[..., None, :, :]).sum(-2)


def outer(a: Tensor, b: Tensor) -> Tensor:
    """a b^T of vectors (..., m) and (..., n)."""
    return a[..., :, None] * b[..., None, :]
