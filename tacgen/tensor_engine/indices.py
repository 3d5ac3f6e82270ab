"""Indices and constants on the host and on the device: to copy them again each time would wait for the device."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from tacgen.tensor_engine import device as devices

_HELD: dict[tuple[int, torch.dtype, torch.device], Tensor] = {}


def constant(array: np.ndarray, like: Tensor) -> Tensor:
    """An array that lives as long as its module, as a tensor of the type and on the device of another one."""
    key = id(array), like.dtype, like.device
    if key not in _HELD:
        _HELD[key] = torch.as_tensor(array, dtype=like.dtype, device=like.device)
    return _HELD[key]


def index_of(rows: Sequence[int], device: torch.device) -> Tensor:
    """Numbers as an index tensor."""
    return torch.tensor(rows, dtype=torch.long, device=device)


def gathered(slots: Tensor, *parts: Tensor) -> tuple[Tensor, ...]:
    """Rows at slots (s,) of tensors (capacity, ...), each of whose rows is contiguous: on a GPU in one launch."""
    if devices.by_kernels(slots):
        from tacgen.tensor_engine import gpu_facets

        return gpu_facets.rows(slots, parts)
    return tuple(part[slots] for part in parts)


def put(slots: Tensor, tensors: tuple[Tensor, ...], values: tuple[Tensor, ...], which: Tensor | None = None) -> None:
    """Write values (s, n, ...) to the first n of the rows at slots (s,) of tensors, where they are marked in `which`
    (s,) or everywhere: the reverse of `gathered`."""
    if devices.by_kernels(slots):
        from tacgen.tensor_engine import gpu_facets

        return gpu_facets.put(slots, tensors, values, which)
    for rows, value in zip(tensors, values, strict=True):
        some = (slots,) if value.dim() == 1 else (slots, slice(value.shape[1]))
        new = value.to(rows.dtype)
        rows[some] = new if which is None else torch.where(which.view(-1, *[1] * (new.dim() - 1)), new, rows[some])
    return None
