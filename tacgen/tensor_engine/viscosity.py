"""Viscoelastic gels of many scenes: the potentials of their load steps, and their internal variables; see
fem.viscoelasticity. Of a batch all scenes have a Prony series, or none."""

import numpy as np
import torch
from torch import Tensor

from tacgen.fem.materials import stiffened
from tacgen.fem.viscoelasticity import Step
from tacgen.tensor_engine.batch import Batch

BYTES_PER_TERM = 8 * 9 * 8  # bytes of an internal variable of a cell


def prepare(b: Batch, rows: list[int], s: Tensor) -> None:
    """Laws and memory of the load steps from the last equilibria."""
    if (memory := b.hexes.memory) is None:
        return
    step = _steps(b, rows, s)
    memory[s] = step.memory(b.t.h_internal[s], b.t.h_isochoric[s])
    b.hexes.laws[s] = stiffened(b.at_rest.laws[s], 1 + step.stiffening[..., 0, 0, 0])


def relax(b: Batch, rows: list[int], s: Tensor) -> None:
    """Internal variables at the ends of the load steps, which are at x."""
    if b.hexes.memory is None:
        return
    end = b.at_rest.rows(s).isochoric_stress(b.t.x[s])
    after = _steps(b, rows, s).after(b.t.h_internal[s], b.t.h_isochoric[s], end)
    b.t.put(s, h_internal=after, h_isochoric=end)


def _steps(b: Batch, rows: list[int], s: Tensor) -> Step:
    """The load steps in hand, in time; a term that a layer has not is 0."""
    count = b.t.h_internal.shape[1]
    gels = [b.problem(row).viscous for row in rows]
    factors = np.zeros((len(rows), 3, count, max(len(b.problem(row).elastic) for row in rows)))
    for row, gel, each in zip(rows, gels, factors, strict=True):
        for layer, part in gel.items():
            each[:, : len(part.tau), layer] = part.factors(b.courses[row].legs[0].duration)
    known = torch.as_tensor(factors, device=s.device)
    cells = known.gather(-1, b.layer[s][:, None, None].expand(-1, 3, count, -1))
    return Step(*cells[..., None, None, None].unbind(1))
