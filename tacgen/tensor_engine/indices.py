"""Indices and constants on the host and on the device: to copy them again each time would wait for the device."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from tacgen.physics import facets
from tacgen.physics.runtime import launch

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
    """Rows at slots (s,) of tensors (capacity, ...), each of whose rows is contiguous, in one launch."""
    out = tuple(part.new_empty(len(slots), *part.shape[1:]) for part in parts)
    _move(slots, parts, out, False)
    return out


def put(slots: Tensor, tensors: tuple[Tensor, ...], values: tuple[Tensor, ...], which: Tensor | None = None) -> None:
    """Write values (s, n, ...) to the first n of the rows at slots (s,) of tensors, where they are marked in `which`
    (s,) or everywhere: the reverse of `gathered`."""
    pairs = zip(tensors, values, strict=True)
    _move(slots, tensors, tuple(value.to(rows.dtype).contiguous() for rows, value in pairs), True, which)


def _move(
    slots: Tensor, rows: tuple[Tensor, ...], values: tuple[Tensor, ...], into: bool, which: Tensor | None = None
) -> None:
    most = int(facets.MAX_MOVED_ARRAYS)
    for at in range(0, len(rows), most):
        kept, close = rows[at : at + most], values[at : at + most]
        widths, sizes = [part.shape[1:].numel() for part in close], [part.element_size() for part in kept]
        apart = [part.stride(0) * size for part, size in zip(kept, sizes, strict=True)]
        addresses = [[part.data_ptr() for part in parts] for parts in (kept, close)]
        table = np.zeros((5, most), np.uint64)
        table[:, : len(kept)] = *addresses, apart, widths, sizes
        numbers = map(facets.Numbers.from_buffer_copy, table)
        launch(facets.moved, (len(slots), sum(widths)), slots, which, into, *numbers)
