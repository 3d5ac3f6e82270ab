"""The indenters of many scenes, and their signed distances."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from tacgen.geometry.analytic_sdf import Record, Shape
from tacgen.physics import distances
from tacgen.physics.cores import ShapeNumber
from tacgen.physics.edges import FIRST_LIST, FIRST_VALUE, ROW_NUMBERS
from tacgen.physics.runtime import launch


@dataclass(frozen=True)
class Shapes:
    """An indenter for each scene: its row in `table` (s, k), and the values and lists of all; see physics.distances.
    Scenes with one field share it."""

    table: Tensor
    values: Tensor
    lists: Tensor
    all: tuple[Shape, ...]

    @classmethod
    def of(cls, shapes: Sequence[Shape], dtype: torch.dtype, device: str) -> "Shapes":
        """An indenter for each scene."""
        known = {id(shape): shape.record for shape in shapes}
        starts, values, lists = dict[int, tuple[int, int]](), 0, 0
        for key, record in known.items():
            starts[key], values, lists = (values, lists), values + record.values.size, lists + record.lists.size
        rows = np.concatenate([_row(known[id(shape)], *starts[id(shape)]) for shape in shapes])
        parts = (np.concatenate([record[k] for record in known.values()]) for k in (1, 2))
        table, whole, listed = (torch.as_tensor(part, device=device) for part in (rows, *parts))
        return cls(table.to(dtype), whole.to(dtype), listed, tuple(shapes))

    def replaced(self, slot: int, shape: Shape) -> "Shapes":
        """With another indenter of one scene of a whole batch; fields that no scene has any more are dropped."""
        shapes = (*self.all[:slot], shape, *self.all[slot + 1 :])
        return Shapes.of(shapes, self.values.dtype, str(self.values.device))

    @property
    def record(self) -> tuple[Tensor, Tensor, Tensor]:
        """The indenters as kernels take them."""
        return self.table, self.values, self.lists

    def values_at(self, p: Tensor) -> Tensor:
        """Signed distance [mm] (s, k) at points p (s, k, 3) in each indenter's own frame."""
        d = p.new_empty(p.shape[:2])
        launch(distances.distances, d.shape, p.contiguous(), *self.record, d, None, None)
        return d


def _row(record: Record, value: int, number: int) -> np.ndarray:
    """A row of Shapes.table, of an indenter whose values and lists begin there."""
    row = record.numbers.copy()
    if int(row[0, 0]) == ShapeNumber.field:
        row[0, list(FIRST_VALUE)] += value
        row[0, list(FIRST_LIST)] += number
    assert row.shape == (1, ROW_NUMBERS)
    return row
