"""Newton's method on the bulk of many scenes, with contact solved on the Schur complements; see Numerics.

Quantities on which the next phase depends are read from the device once a call.
"""

from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from tacgen.mechanics import measures
from tacgen.mechanics.numerics import StepEnd
from tacgen.physics.decisions import ContactStatus
from tacgen.tensor_engine import contact_newton
from tacgen.tensor_engine.batch import Batch, Sizes
from tacgen.tensor_engine.condensation import acted, condensed, damping, reduce, reduction
from tacgen.tensor_engine.contact_newton import Iterates, at_nodes, shrunk
from tacgen.tensor_engine.elements import determinant
from tacgen.tensor_engine.indices import gathered
from tacgen.tensor_engine.load_step import cover, covers, take
from tacgen.tensor_engine.replay import Write
from tacgen.tensor_engine.slot import PartOfStep


def follow(b: Batch, rows: list[int]) -> list[bool]:
    """Condense to the nodes on which contact acts; which kept tangents serve there."""
    s = b.slots(rows)
    facets = touched(b, s, b.t.x[s], b.t.offset[s])
    cover(b, s, facets, ~covers(b, s, facets))
    return [b.scenes[row].usable for row in rows]


def touched(b: Batch, s: Tensor, x: Tensor, offset: Tensor) -> Tensor:
    """The facets (s, f) on which the indenter acts at x (s, n, 3), see measures.touched."""
    gap = b.face(s, offset).gap(x)
    return measures.touched(gap, b.dhat[s, None, None], gap.amin((1, 2))[:, None, None], b.t.h_N[s])


def factor(b: Batch, rows: list[int]) -> list[bool]:
    """Factorise the tangents at the iterates, with the pressures predicted; which are positive definite."""
    return take(b, rows, "x", b.options.mixed_pressure)


def load(b: Batch, rows: list[int]) -> None:
    """The unbalanced forces, condensed, and the contact before its first step."""
    sizes = b.sizes(rows)
    b.replays(("load", sizes.nodes, b.hexes.two_invariants), partial(_load, b, sizes), rows)


def _load(b: Batch, sizes: Sizes, s: Tensor) -> tuple[None, None]:
    t = b.t
    (x,) = gathered(s, t.x)
    g = b.hexes.rows(s).mixed_forces(x, t.J, t.taken)
    g = g + b.barriers(s).gradient(x)
    if (inertia := b.inertia(s)) is not None:
        g = g + inertia.gradient(x)
    y, load = b.factors.forward(s, g, sizes.nodes)
    b.keep(s, load=load.to(g.dtype))
    t.put(s, g=g, y=y.to(g.dtype))
    _untouched(b, sizes, s)
    return None, None


def _untouched(b: Batch, sizes: Sizes, s: Tensor) -> None:
    """The contact before its first step."""
    t = b.t
    x = torch.zeros_like(t.c_x[s])  # later calls may have more nodes
    x[:, : sizes.nodes] = b.at_condensed(s, t.x, sizes.nodes)
    zero = torch.zeros_like(t.c_drift[s])
    none, far = zero + torch.nan, zero + torch.inf
    t.put(s, c_x=x, c_offset=t.offset[s], c_length=far, c_drift=zero, c_gap=none, c_steps=zero.long())


def untouch(b: Batch, rows: list[int]) -> None:
    """The contact before its first step."""
    _untouched(b, b.sizes(rows), b.slots(rows))


def contact(b: Batch, rows: list[int]) -> list[ContactStatus]:
    """One step of the contact, or the next part of one."""
    scenes, now = {row: b.scenes[row] for row in rows}, dict.fromkeys(rows, ContactStatus.running)
    at = {part: [row for row, scene in scenes.items() if scene.part_of_step is part] for part in PartOfStep}
    if some := at[PartOfStep.REDUCE]:
        reduce(b, some)
        for row in some:
            scenes[row].part_of_step = PartOfStep.COUPLED
    ready = {row: scenes[row].reduced == b.courses[row].newton.inner_damping for row in at[PartOfStep.COUPLED]}
    if some := [row for row in ready if not ready[row]]:
        _begun(b, some)
    for some, symmetric in (([row for row in ready if ready[row]], False), (at[PartOfStep.SYMMETRIC], True)):
        if some:
            now.update(zip(some, _stepped(b, some, symmetric), strict=True))
    return list(now.values())


def _begun(b: Batch, rows: list[int]) -> None:
    """The bulk of scenes without a reduction will be reduced, to the unknowns on which contact acts."""
    sizes = b.sizes(rows)
    counts = b.replays(("acted", sizes.nodes), partial(_acted, b, sizes), rows, [0.0] * len(rows))
    for row, many in zip(rows, counts, strict=True):
        b.scenes[row].part_of_step, b.scenes[row].kept = PartOfStep.REDUCE, int(many)


def _stepped(b: Batch, rows: list[int], symmetric: bool) -> list[ContactStatus]:
    """The contact after a coupled or a symmetric step; how each scene's stands. Where contact acts on other unknowns
    too, the coupled step is none, and the bulk will be reduced again."""
    sizes, damped, out = b.sizes(rows), damping(b, rows), list[ContactStatus]()
    key, work = ("contact", sizes.nodes, sizes.kept, bool(damped), symmetric), partial(_contact, b, sizes, symmetric)
    for row, (status, stale, many) in zip(rows, b.replays(key, work, rows, *damped), strict=True):
        scene, now = b.scenes[row], ContactStatus.running if stale else ContactStatus(int(status))
        scene.part_of_step = PartOfStep.SYMMETRIC if now is ContactStatus.searching else PartOfStep.COUPLED
        if stale:
            scene.part_of_step, scene.kept = PartOfStep.REDUCE, int(many)
        out.append(now)
    return out


def _iterates(b: Batch, sizes: Sizes, s: Tensor) -> Iterates:
    t = b.t
    each = t.c_x[:, : sizes.nodes], t.c_offset, t.c_steps, t.c_length, t.c_drift, t.c_gap, t.c_status
    x, offset, *rest = gathered(s, *each)
    return Iterates(x, b.near(s, offset, sizes.nodes), *rest)


def _acted(b: Batch, sizes: Sizes, s: Tensor, valid: Tensor) -> tuple[Tensor, None]:
    """condensation.acted for the forces at the iterates. Tells on how many unknowns contact acts (s,)."""
    now = _iterates(b, sizes, s)
    return acted(b, sizes, s, now.contact, shrunk(now)[0].evaluate(now.x).N, valid)[1], None


def _contact(b: Batch, sizes: Sizes, symmetric: bool, s: Tensor, *damping: Tensor) -> tuple[Tensor, Write]:
    """A step of the contact. Tells of each scene (s, 3) how it stands, and what condensation.acted says of a coupled
    step, which is none where it says that the reduction is stale."""
    bulk = replace(condensed(b, sizes, s, *damping), reduction=reduction(b, sizes, s))
    now, (reach, edge) = _iterates(b, sizes, s), gathered(s, b.reach, b.edge)
    after, N = contact_newton.step(bulk, now, reach, b.end(s), edge, b.options.max_contact, symmetric)
    none = torch.zeros_like(now.steps)
    stale, count = (none, none) if symmetric else acted(b, sizes, s, now.contact, N, torch.ones_like(reach))

    def write(which: Tensor | None) -> None:
        taken = stale == 0
        b.t.put(
            s, taken if which is None else taken & which, c_x=after.x, c_offset=after.contact.offset,
            c_steps=after.steps, c_length=after.length, c_drift=after.drift, c_gap=after.gap, c_status=after.status,
        )  # fmt: skip

    return torch.stack([after.status, stale.long(), count], 1), write


def lower(b: Batch, rows: list[int], part: float) -> list[bool]:
    """Take a part of the step of all nodes where it lowers the energy, normal forces frozen; where it does."""
    sizes, damped = b.sizes(rows), damping(b, rows)
    key, work = ("search", sizes.nodes, bool(damped), b.hexes.two_invariants), partial(_search, b, sizes)
    return [bool(fine) for fine in b.replays(key, work, rows, [part] * len(rows), *damped)]


def _search(b: Batch, sizes: Sizes, s: Tensor, part: Tensor, *damping: Tensor) -> tuple[Tensor, Write]:
    """Nodes and energies after a part (s,) of the step, and condensed positions after it where they are lower. Tells
    where (s,)."""
    t, bulk = b.t, condensed(b, sizes, s, *damping)
    x, c_x, offset, y, g, energy, least = gathered(s, t.x, t.c_x, t.c_offset, t.y, t.g, t.energy, t.h_least)
    near, inner = b.near(s, offset, sizes.nodes), c_x[:, : sizes.nodes]
    step = inner - bulk.start
    u = step.flatten(1)
    p = b.factors.expand(s, u, y).to(x.dtype)
    fractions = torch.stack([torch.zeros_like(part), part, torch.ones_like(part)], 1)
    before, left_energy, whole = near.merits(bulk.start, step, fractions, near.evaluate(inner)).unbind(1)
    model = measures.predicted_change(g, p, u, bulk.times(u) + bulk.load) + whole - before
    fraction = part[:, None, None]
    there = x + fraction * p
    value, left = b.energy(s, there), torch.where(fraction < 1, bulk.start + fraction * step, inner)
    lower = measures.lowers(value - energy + left_energy - before, part * model, energy, b.end(s), least)
    left = torch.where(lower[:, None, None], left, inner)
    return lower, lambda which: t.put(s, which, stepped=there, stepped_energy=value, c_x=left)


def measure(b: Batch, rows: list[int]) -> list[StepEnd]:
    """The end of the step that was taken, which is the next iterate."""
    sizes = b.sizes(rows)
    told = b.replays(("measure", sizes.nodes, b.hexes.two_invariants), partial(_measure, b, sizes), rows)
    return [StepEnd(residual, *map(bool, flags)) for residual, *flags in told]


def _measure(b: Batch, sizes: Sizes, s: Tensor) -> tuple[Tensor, Write]:
    """The end of the step, and J there as the next one predicts it. Tells what StepEnd has (s, 6)."""
    t, options = b.t, b.options
    x, there, offset, inner, status, least = gathered(
        s, t.x, t.stepped, t.c_offset, t.c_x[:, : sizes.nodes], t.c_status, t.h_least
    )
    moved = (there - x).abs().flatten(1).amax(1)
    J, gradient = b.gradient(s, there)
    if options.mixed_pressure:
        J = b.hexes.rows(s).predicted(x, there, t.taken)
    near = b.near(s, offset, sizes.nodes)
    forces = near.evaluate(inner)
    unbalanced = _unbalanced(b, t.nodes[s, : sizes.nodes], s, gradient, at_nodes(near, forces.force, sizes.nodes))
    residual = torch.linalg.norm(unbalanced.flatten(1), dim=1) / torch.maximum(forces.total, least)
    covered = covers(b, s, touched(b, s, there, offset))
    end = b.end(s)
    agrees = ~((forces.mean_gap - offset).abs() > end)
    converged, circling = status == ContactStatus.converged, status == ContactStatus.circling
    columns = residual, moved <= end, covered, converged, circling, agrees
    (energy,) = gathered(s, t.stepped_energy)
    told = torch.stack([part.to(residual.dtype) for part in columns], 1)
    return told, lambda which: t.put(s, which, x=there, energy=energy, J=J, offset=offset)


def _unbalanced(b: Batch, nodes: Tensor, s: Tensor, gradient: Tensor, push: Tensor) -> Tensor:
    """Forces (s, n, 3) at the free nodes, gradient less what contact exerts on `nodes`; 0 at the others."""
    at = nodes.clamp(min=0)[..., None].expand_as(push)
    r = gradient.scatter_add(1, at, torch.where(nodes[..., None] >= 0, -push, 0.0))
    return r * (b.free & b.used[s])[..., None]


def least_J(b: Batch, row: int, start: bool) -> float:
    """Smallest J at the iterate, or where Newton's method began."""
    s, x = b.slots([row]), b.t.begins if start else b.t.x
    return float(determinant(b.hexes.rows(s).deformation(x[s]))[b.hexes.weights[s] > 0].min())
