"""A scene in the place of one that has ended: its rows in all tables of a batch."""

import torch

from tacgen.geometry.sdf_grid import Field
from tacgen.mechanics.problem import Problem
from tacgen.tensor_engine.batch import WIDE, Batch, Place
from tacgen.tensor_engine.grids import Array
from tacgen.tensor_engine.shapes import Shapes

ROWS = ("X", "exists", "used", "areas", "dhat", "eps", "edge", "reach", "friction")


def fill(b: Batch, slot: int, problem: Problem, place: Place, X: Array) -> None:
    """Put a scene, before its first load step, into a slot of a batch; X (n, 3): the nodes at rest [mm].

    Raises ValueError: its facets have another number of contact points than those of the batch.
    """
    if problem.contact.faces.areas.shape[1] != b.areas.shape[2]:
        raise ValueError("scenes of one batch have equally many contact points in a facet")
    patch = torch.nonzero(b.patch).squeeze(1).cpu().numpy()
    one = Batch.of([problem], [place], b.topology, X[None], b.factors, patch, str(b.X.device))
    for name in ROWS:
        getattr(b, name)[slot] = getattr(one, name)[0]
    b.free &= one.free  # bonded nodes that no scene before has had
    for mine, new in ((b.hexes, one.hexes), (b.folding, one.folding)):
        for name, part in vars(mine).items():
            if isinstance(part, torch.Tensor):
                part[slot] = getattr(new, name)[0]
    b.hexes.laws.values[:, slot] = one.hexes.laws.values[:, 0]
    b.courses[slot] = one.courses[0]
    for name, rows in vars(b.t).items():
        rows[slot] = b._blank(name, 1, rows.shape[1:])[0] if name in WIDE else getattr(one.t, name)[0]
    _replace_shape(b, slot, one.shapes)


def _replace_shape(b: Batch, slot: int, new: Shapes) -> None:
    """The indenter of a slot; fields that no slot has any more are dropped."""
    shapes = list(b.shapes.shapes)
    before, shapes[slot] = shapes[slot], new.shapes[0]
    if isinstance(before, Field) or isinstance(shapes[slot], Field):
        b.shapes = Shapes.of(shapes, b.X.dtype, str(b.X.device))
    else:
        b.shapes = Shapes(shapes, b.shapes.values, b.shapes.first)
