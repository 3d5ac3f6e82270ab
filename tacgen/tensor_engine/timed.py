"""Gels whose forces depend on time: the potentials of their load steps, and what the next ones inherit; see
fem.viscoelasticity and fem.inertia. Of a batch all scenes have a Prony series, or none, and inertia, or none."""

import numpy as np
import torch
from torch import Tensor

from tacgen.fem.inertia import Inertia, lumped
from tacgen.fem.materials import stiffened
from tacgen.fem.projection import Projection
from tacgen.fem.viscoelasticity import Step
from tacgen.tensor_engine.batch import Batch
from tacgen.tensor_engine.elements import HEX_SHAPE_VALUES
from tacgen.tensor_engine.indices import constant

BYTES_PER_TERM, BYTES_PER_DAMPER = 8 * 9 * 8, 24 * 24 * 8  # bytes of an internal variable and of beta K/h, of a cell


def prepare(b: Batch, rows: list[int], s: Tensor) -> None:
    """The potentials of the load steps from the last equilibria."""
    if (memory := b.hexes.memory) is not None:
        step = _relaxation(b, rows, s)
        memory[s] = step.memory(b.t.h_internal[s], b.t.h_isochoric[s])
        b.hexes.laws[s] = stiffened(b.at_rest.laws[s], 1 + step.stiffening[..., 0, 0, 0])
    if b.inert:
        _accelerate(b, rows, s)


def keep(b: Batch, rows: list[int], s: Tensor) -> None:
    """Internal variables and velocities at the ends of the load steps, which are at x, from positions h_x."""
    t = b.t
    if b.hexes.memory is not None:
        end = b.at_rest.rows(s).isochoric_stress(t.x[s])
        after = _relaxation(b, rows, s).after(t.h_internal[s], t.h_isochoric[s], end)
        t.put(s, h_internal=after, h_isochoric=end)
    if b.inert:
        h = torch.tensor([_duration(b, row) for row in rows], dtype=t.x.dtype, device=s.device)
        t.put(s, h_velocity=(t.x[s] - t.h_x[s]) / h[:, None, None])


def add_tangents(b: Batch, s: Tensor, K: Tensor) -> None:
    """Add those of inertia and damping to the cells' tangents K (s, e, 24, 24)."""
    if b.inert:
        K += b.t.damper[s]
        K.diagonal(dim1=2, dim2=3).add_(b.t.corners[s].repeat_interleave(3, 2))


def _duration(b: Batch, row: int) -> float:
    return b.courses[row].legs[0].duration


def _relaxation(b: Batch, rows: list[int], s: Tensor) -> Step:
    """The load steps in hand, in time; a term that a layer has not is 0."""
    count = b.t.h_internal.shape[1]
    factors = np.zeros((len(rows), 3, count, max(len(b.problem(row).elastic) for row in rows)))
    for row, each in zip(rows, factors, strict=True):
        for layer, part in b.problem(row).viscous.items():
            each[:, : len(part.tau), layer] = part.factors(_duration(b, row))
    known = torch.as_tensor(factors, device=s.device)
    cells = known.gather(-1, b.t.layer[s][:, None, None].expand(-1, 3, count, -1))
    return Step(*cells[..., None, None, None].unbind(1))


def _accelerate(b: Batch, rows: list[int], s: Tensor) -> None:
    """Inertia and damping in the load steps."""
    t, all_dynamics = b.t, [b.problem(row).dynamics for row in rows]
    gels = [(_duration(b, row), d.density, d.alpha, d.beta) for row, d in zip(rows, all_dynamics, strict=True) if d]
    h, density, alpha, beta = torch.tensor(gels, dtype=t.x.dtype, device=s.device).T[..., None, None]
    mass, x = density * torch.nan_to_num(lumped(b.hexes.weights[s], constant(HEX_SHAPE_VALUES, b.X))), t.h_x[s]
    each = Inertia.of(x, t.h_velocity[s], mass, alpha, h)  # with the masses of cells' corners
    parts = (part[..., None].expand(-1, -1, -1, 3).contiguous() for part in (each.inertial, each.drag))
    inertial, drag = (b.topology.at_nodes(part) for part in parts)
    K = b.at_rest.rows(s).tangents(x, projection=Projection.FULL)[1]
    t.put(
        s, coasting=each.coasting, inertial=inertial[..., :1], drag=drag[..., :1], corners=each.inertial + each.drag,
        damper=(beta / h)[..., None] * K,
    )  # fmt: skip
