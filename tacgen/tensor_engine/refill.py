"""A scene in the place of one that has ended: its rows in all tables of a batch."""

from dataclasses import replace

import torch

from tacgen.mechanics.problem import Problem
from tacgen.tensor_engine.batch import WIDE_ARRAYS, Batch
from tacgen.tensor_engine.grids import Place

PROBLEM_ROWS = ("X", "exists", "used", "areas", "dhat", "eps", "edge", "reach", "friction")
HEX_ROWS = ("B", "weights", "laws")
FOLDING_ROWS = ("rest", "most", "stiffness")


def fill(b: Batch, slot: int, problem: Problem, place: Place) -> None:
    """Put a scene, before its first load step, into a slot of a batch.

    Raises ValueError: its facets have another number of contact points than those of the batch.
    """
    if problem.contact.faces.areas.shape[1] != b.areas.shape[2]:
        raise ValueError("scenes of one batch have equally many contact points in a facet")
    patch = torch.nonzero(b.patch).squeeze(1).cpu().numpy()
    one = type(b).of([problem], [place], b.topology, b.factors, patch, str(b.X.device))
    for name in PROBLEM_ROWS:
        getattr(b, name)[slot] = getattr(one, name)[0]
    b.free &= one.free  # bonded nodes that no scene before has had
    for mine, new, names in ((b.at_rest, one.at_rest, HEX_ROWS), (b.folding, one.folding, FOLDING_ROWS)):
        for name in names:
            getattr(mine, name)[slot] = getattr(new, name)[0]
    if one.hexes.two_invariants and not b.hexes.two_invariants:
        b.hexes, b.at_rest = (replace(part, two_invariants=True) for part in (b.hexes, b.at_rest))
    b.scenes[slot] = one.scenes[0]
    for name, rows in vars(b.t).items():
        rows[slot] = b._blank(name, 1, rows.shape[1:])[0] if name in WIDE_ARRAYS else getattr(one.t, name)[0]
    b.indent(slot, one.shapes.all[0])
