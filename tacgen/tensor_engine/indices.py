"""Indices of slots that also know their numbers on the host: to read them from a GPU would wait for it."""

from collections.abc import Sequence

import torch
from torch import Tensor


def index_of(rows: Sequence[int], device: torch.device) -> Tensor:
    """Numbers as an index tensor."""
    out = torch.tensor(rows, dtype=torch.long, device=device)
    out.rows = list(rows)
    return out


def listed(index: Tensor) -> list[int]:
    """The numbers of an index, from the host where it was made of a list by `index_of`."""
    rows: list[int] | None = getattr(index, "rows", None)
    return index.tolist() if rows is None else rows
