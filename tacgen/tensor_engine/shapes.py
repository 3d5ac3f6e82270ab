"""Signed distances of the indenters of many scenes: on a GPU by kernels, elsewhere by each shape's own function."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.sdf_grid import Field
from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine.scope import SHAPE_NUMBERS, SUPPORTED_SHAPES

Distances = tuple[Tensor, Tensor, Tensor]


@dataclass(frozen=True)
class Shapes:
    """An indenter for each scene: its number (s,) among `all`, those of the whole batch, and in SUPPORTED_SHAPES; a
    table (s, 8) of numbers: of analytic shapes those of SHAPE_NUMBERS, of fields where its coefficients begin, its
    nodes, origin and cell; and the coefficients of all fields one after the other."""

    numbers: Tensor
    kinds: Tensor
    table: Tensor
    values: Tensor
    all: tuple[Shape, ...]

    @classmethod
    def of(cls, shapes: Sequence[Shape], dtype: torch.dtype, device: str) -> "Shapes":
        """An indenter for each scene, all `known`; scenes with one field share it."""
        fields = {id(shape): shape for shape in shapes if isinstance(shape, Field)}
        parts, starts, count = [torch.zeros(0, dtype=dtype, device=device)], dict[int, int](), 0
        for key, field in fields.items():
            parts.append(_coefficients(field, dtype, device))
            starts[key], count = count, count + parts[-1].numel()
        rows = [_row(shape, starts.get(id(shape), 0)) for shape in shapes]
        kinds = torch.tensor([SUPPORTED_SHAPES.index(type(shape)) for shape in shapes], device=device)
        table, numbers = torch.tensor(rows, dtype=dtype, device=device), torch.arange(len(shapes), device=device)
        return cls(numbers, kinds, table, torch.cat(parts), tuple(shapes))

    @property
    def rows(self) -> Distances:
        """Parts that have a row for each scene."""
        return self.numbers, self.kinds, self.table

    def only(self, numbers: Tensor, kinds: Tensor, table: Tensor) -> "Shapes":
        """Only some scenes, with their rows."""
        return replace(self, numbers=numbers, kinds=kinds, table=table)

    def replaced(self, slot: int, shape: Shape) -> "Shapes":
        """With another indenter of one scene of a whole batch; fields that no scene has any more are dropped."""
        shapes = (*self.all[:slot], shape, *self.all[slot + 1 :])
        return Shapes.of(shapes, self.values.dtype, str(self.values.device))

    def each(self) -> list[Shape]:
        """The indenters (s,)."""
        return [self.all[k] for k in self.numbers.tolist()]

    def values_at(self, p: Tensor) -> Tensor:
        """Signed distance [mm] (s, k) alone."""
        return self.distance(p)[0]

    def distance(self, p: Tensor) -> Distances:
        """Signed distance [mm] (s, k), its gradient (s, k, 3) and Hessian [1/mm] (s, k, 3, 3) at points p (s, k, 3) in
        each indenter's own frame."""
        if devices.by_kernels(p):
            from tacgen.tensor_engine import gpu_distance

            return gpu_distance.distances(p, self.kinds, self.table, self.values)
        found = [shape.distance(at) for shape, at in zip(self.each(), p.double().numpy(), strict=True)]
        d, g, H = (torch.stack([torch.from_numpy(one[k]) for one in found]).to(p.dtype) for k in range(3))
        return d, g, H


def _row(shape: Shape, first: int) -> list[float]:
    """A row of Shapes.table; first: where a field's coefficients begin."""
    if isinstance(shape, Field):
        return [first, *shape.coefficients.shape, *(float(x) for x in shape.origin), shape.cell]
    numbers = [getattr(shape, name) for name in SHAPE_NUMBERS[type(shape)]]
    return numbers + [0.0] * (8 - len(numbers))


@cache
def _kept(dtype: torch.dtype, device: str) -> WeakKeyDictionary[Field, Tensor]:
    """Coefficients of the fields that are in use."""
    return WeakKeyDictionary()


def _coefficients(field: Field, dtype: torch.dtype, device: str) -> Tensor:
    """The coefficients of a field on a device, copied there once while the field is in use."""
    kept = _kept(dtype, device)
    if field not in kept:
        kept[field] = torch.as_tensor(field.coefficients, dtype=dtype).flatten().to(device)
    return kept[field]
