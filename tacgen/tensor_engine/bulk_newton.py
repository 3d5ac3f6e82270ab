"""Newton's method on the bulk of many scenes, with contact solved on the Schur complements.

Each kernel does for scenes in slots `rows` of a batch what that of mechanics.bulk_newton does for one, and returns an
outcome for each. Quantities on which the next phase depends are read from the device once a call.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from tacgen.mechanics.bulk_newton import (
    ENERGY_ROUNDING,
    MAX_DAMPING,
    MIN_BULK_STEP,
    MIN_ENERGY_GAIN,
    in_folds,
    next_damping,
    settles,
    slow,
)
from tacgen.mechanics.condensation import more
from tacgen.mechanics.failures import MAX_REPORTED_J, Failure, NotConverged
from tacgen.mechanics.load_stepping import may_damp
from tacgen.mechanics.options import SolverOptions
from tacgen.mechanics.phases import Outcome
from tacgen.mechanics.solve_state import known
from tacgen.tensor_engine import contact_newton
from tacgen.tensor_engine.batch import Batch, Sizes
from tacgen.tensor_engine.condensation import acted, condensed, damping, reduce, reduction
from tacgen.tensor_engine.contact_newton import CONVERGED, RUNNING, SEARCHING, UNSTABLE, Iterates, at_nodes, shrunk
from tacgen.tensor_engine.course import Course, PartOfStep
from tacgen.tensor_engine.elements import determinant
from tacgen.tensor_engine.indices import gathered
from tacgen.tensor_engine.load_step import cover, covers, take
from tacgen.tensor_engine.replay import Write

STATUS_OUTCOMES = {RUNNING: Outcome.more, SEARCHING: Outcome.more, UNSTABLE: Outcome.unstable}


def begin_step(b: Batch, rows: list[int]) -> list[Outcome]:
    """Counts a step of the bulk; the nodes to condense to follow the contact."""
    outcomes, options, going = [], b.options, list[int]()
    for row in rows:
        course = b.courses[row]
        if course.newton_steps == options.max_newton:
            fail(b, row, b.t.x[row], course.newton_steps)
        elif course.effort + 1 > options.max_effort:
            course.effort += 1
            course.failure = NotConverged(Failure.effort, steps=options.max_effort)
        else:
            course.effort, course.newton_steps = course.effort + 1, course.newton_steps + 1
            going.append(row)
    if going:
        some = b.slots(going)
        facets = touched(b, some, b.t.x[some], b.t.offset[some])
        cover(b, some, facets, ~covers(b, some, facets))
    for row in rows:
        course = b.courses[row]
        course.new = course.new or not course.usable
        ready = Outcome.missing if course.new else Outcome.ready
        outcomes.append(ready if row in going else Outcome.failure)
    return outcomes


def touched(b: Batch, s: Tensor, x: Tensor, offset: Tensor) -> Tensor:
    """The facets (s, f) on which the indenter acts at x (s, n, 3); if none, those on which it acted last, or the
    nearest."""
    contact = b.face(s, offset)
    gap = contact.gap(x)
    now, last = (gap < contact.dhat[:, None, None]).any(-1), (b.t.h_N[s] > 0).any(-1)
    nearest = gap.amin(-1) <= gap.flatten(1).amin(1, keepdim=True)
    out = torch.where(last.any(1, keepdim=True), last, nearest)
    return torch.where(now.any(1, keepdim=True), now, out)


def factor(b: Batch, rows: list[int]) -> list[Outcome]:
    """The tangents at the iterates, with the pressures predicted."""
    good = take(b, rows, "x", b.options.mixed_pressure)
    for row, fine in zip(rows, good, strict=True):
        if not fine:
            fail(b, row, b.t.begins[row], 0)
    return [Outcome.ready if fine else Outcome.indefinite for fine in good]


def load(b: Batch, rows: list[int]) -> list[Outcome]:
    """The unbalanced forces, condensed, and the contact before its first step."""
    sizes = b.sizes(rows)
    b.replays(("load", sizes.nodes, b.hexes.laws.two_invariants), partial(_load, b, sizes), rows)
    for row in rows:
        b.courses[row].inner_damping = b.courses[row].damping
    return [Outcome.ready] * len(rows)


def _load(b: Batch, sizes: Sizes, s: Tensor) -> tuple[None, None]:
    t = b.t
    (x,) = gathered(s, t.x)
    g = b.hexes.rows(s).mixed_forces(x, t.J, t.taken)
    g = g + b.barriers(s).gradient(x)
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
    t.put(s, c_x=x, c_offset=t.offset[s], c_length=zero + torch.inf, c_drift=zero, c_gap=zero - 1, c_steps=zero.long())


def contact(b: Batch, rows: list[int]) -> list[Outcome]:
    """One step of the contact, or the next part of one."""
    courses, outcomes = {row: b.courses[row] for row in rows}, dict.fromkeys(rows, Outcome.more)
    at = {part: [row for row, course in courses.items() if course.part_of_step is part] for part in PartOfStep}
    if some := at[PartOfStep.REDUCE]:
        reduce(b, some)
        for row in some:
            courses[row].part_of_step = PartOfStep.COUPLED
    ready = {row: courses[row].reduced == courses[row].inner_damping for row in at[PartOfStep.COUPLED]}
    if some := [row for row in ready if not ready[row]]:
        _begun(b, some)
    for some, symmetric in (([row for row in ready if ready[row]], False), (at[PartOfStep.SYMMETRIC], True)):
        for row, status in zip(some, _stepped(b, some, symmetric) if some else (), strict=True):
            if status is not None:
                outcomes[row] = STATUS_OUTCOMES.get(status, Outcome.ended)
                courses[row].part_of_step = PartOfStep.SYMMETRIC if status == SEARCHING else PartOfStep.COUPLED
    return list(outcomes.values())


def _begun(b: Batch, rows: list[int]) -> None:
    """The bulk of scenes without a reduction will be reduced, to the unknowns on which contact acts."""
    sizes = b.sizes(rows)
    counts = b.replays(("acted", sizes.nodes), partial(_acted, b, sizes), rows, [0.0] * len(rows))
    for row, many in zip(rows, counts, strict=True):
        b.courses[row].part_of_step, b.courses[row].kept = PartOfStep.REDUCE, int(many)


def _stepped(b: Batch, rows: list[int], symmetric: bool) -> list[int | None]:
    """The contact after a coupled or a symmetric step; how each scene's stands. None: contact acts on other unknowns
    too, so that the coupled step is none, and the bulk will be reduced again."""
    sizes, damped, out = b.sizes(rows), damping(b, rows), list[int | None]()
    key, work = ("contact", sizes.nodes, sizes.kept, bool(damped), symmetric), partial(_contact, b, sizes, symmetric)
    for row, (status, stale, many) in zip(rows, b.replays(key, work, rows, *damped), strict=True):
        out.append(None if stale else int(status))
        if stale:
            b.courses[row].part_of_step, b.courses[row].kept = PartOfStep.REDUCE, int(many)
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
    after, N = contact_newton.step(bulk, now, reach, step_end(b, s), edge, b.options.max_contact, symmetric)
    none = torch.zeros_like(now.steps)
    stale, count = (none, none) if symmetric else acted(b, sizes, s, now.contact, N, torch.ones_like(reach))

    def write(which: Tensor | None) -> None:
        taken = stale == 0
        b.t.put(
            s, taken if which is None else taken & which, c_x=after.x, c_offset=after.contact.offset,
            c_steps=after.steps, c_length=after.length, c_drift=after.drift, c_gap=after.gap, c_status=after.status,
        )  # fmt: skip

    return torch.stack([after.status, stale.long(), count], 1), write


def damp(b: Batch, rows: list[int]) -> list[Outcome]:
    """No step lowers the energy: with kept tangents, new ones; with new ones, shorter load steps; in those that are
    short, more damping."""
    outcomes, again = [], []
    for row in rows:
        course = b.courses[row]
        if not course.new:
            course.damping, course.new = course.inner_damping, True
            outcomes.append(Outcome.missing)
        elif not may_damp(known(course.history), course.legs[0], b.options):
            course.failure = NotConverged(Failure.folds)
            outcomes.append(Outcome.failure)
        elif course.inner_damping > MAX_DAMPING:
            fail(b, row, b.t.x[row], course.newton_steps)
            outcomes.append(Outcome.failure)
        else:
            course.inner_damping = more(course.inner_damping)
            again.append(row)
            outcomes.append(Outcome.ready)
    if again:
        _untouched(b, b.sizes(again), b.slots(again))
    return outcomes


def search(b: Batch, rows: list[int]) -> list[Outcome]:
    """Line search: the first of the whole step, a half, a quarter... that lowers the energy, normal forces frozen."""
    part, left, laws = 1.0, rows, b.hexes.laws.two_invariants
    for row in rows:
        b.courses[row].part = 0.0
    while left and part >= MIN_BULK_STEP:  # nearly all take the whole step
        sizes, damped = b.sizes(left), damping(b, left)
        key, work = ("search", sizes.nodes, bool(damped), laws), partial(_search, b, sizes)
        found = dict(zip(left, b.replays(key, work, left, [part] * len(left), *damped), strict=True))
        for row in (row for row, fine in found.items() if fine):
            b.courses[row].part = part
        left, part = [row for row, fine in found.items() if not fine], part / 2
    return [Outcome.ready if b.courses[row].part > 0 else Outcome.higher for row in rows]


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
    # of the bulk g.p + p.Kp/2 = (g.p + p.(g + Kp))/2; g + Kp is 0 but for the condensed unknowns
    condensed_gradient = bulk.times(u) + bulk.load
    model = ((g * p).sum((1, 2)) + (u * condensed_gradient).sum(1)) / 2 + whole - before
    rounding = step_end(b, s) * least + ENERGY_ROUNDING * energy.abs()
    fraction = part[:, None, None]
    there = x + fraction * p
    value, left = b.energy(s, there), torch.where(fraction < 1, bulk.start + fraction * step, inner)
    total = value - energy + left_energy - before
    share = total / torch.minimum(part * model, -rounding)
    lower = torch.where(total.abs() <= rounding, 1.0, share) >= MIN_ENERGY_GAIN
    left = torch.where(lower[:, None, None], left, inner)
    return lower, lambda which: t.put(s, which, stepped=there, stepped_energy=value, c_x=left)


def step_end(b: Batch, s: Tensor) -> Tensor:
    """Motion of a node (s,) below which a step is small [mm]."""
    return b.options.step_tol * b.dhat[s]


def measure(b: Batch, rows: list[int]) -> list[Outcome]:
    """The residual after a step: whether it is small enough, and else the damping and the tangent of the next one."""
    sizes = b.sizes(rows)
    figures = b.replays(("measure", sizes.nodes, b.hexes.laws.two_invariants), partial(_measure, b, sizes), rows)
    return [_measured(b.options, b.courses[row], *each) for row, each in zip(rows, figures, strict=True)]


def _measure(b: Batch, sizes: Sizes, s: Tensor) -> tuple[Tensor, Write]:
    """The end of the step, and J there as the next one predicts it. Tells figures (s, 6) for `_measured`."""
    t, options = b.t, b.options
    x, there, offset, inner, status, steps, least = gathered(
        s, t.x, t.stepped, t.c_offset, t.c_x[:, : sizes.nodes], t.c_status, t.c_steps, t.h_least
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
    end = step_end(b, s)
    agrees = torch.where(forces.total > 0, (forces.mean_gap - offset).abs(), 0.0) <= end
    columns = residual, moved <= end, covered, status == CONVERGED, agrees, steps
    (energy,) = gathered(s, t.stepped_energy)
    told = torch.stack([part.to(residual.dtype) for part in columns], 1)
    return told, lambda which: t.put(s, which, x=there, energy=energy, J=J, offset=offset)


def _unbalanced(b: Batch, nodes: Tensor, s: Tensor, gradient: Tensor, push: Tensor) -> Tensor:
    """Forces (s, n, 3) at the free nodes, gradient less what contact exerts on `nodes`; 0 at the others."""
    at = nodes.clamp(min=0)[..., None].expand_as(push)
    r = gradient.scatter_add(1, at, torch.where(nodes[..., None] >= 0, -push, 0.0))
    return r * (b.free & b.used[s])[..., None]


def _measured(
    options: SolverOptions,
    course: Course,
    residual: float,
    still: float,
    covered: float,
    converged: float,
    agrees: float,
    steps: float,
) -> Outcome:  # fmt: skip
    """The outcome for one scene, and its next damping and tangent."""
    damping, before = course.inner_damping, course.residual
    course.residual, course.newton_folding = (
        residual,
        course.newton_folding + (damping > 0 or course.newton_folding > 0),
    )
    circling, whole = not converged and steps >= options.max_contact, course.part == 1
    rests, fell = circling and bool(agrees), residual < before
    folding = in_folds(course.newton_folding, course.state)
    if settles(options, residual, folding, damping, bool(still), bool(converged) and whole, rests) and covered:
        course.found = True
        return Outcome.ended
    if np.isfinite(before):  # a kept tangent reduces the residual about half as much as a new one
        course.rate = (2 if course.new else 1) * residual / before
    course.new = not options.keep_tangent or course.part < 1 or slow(options, residual, course.rate)
    course.damping = next_damping(damping, course.part, circling, fell)
    if course.damping > 0 and not may_damp(known(course.history), course.legs[0], options):
        course.failure = NotConverged(Failure.folds)
        return Outcome.failure
    return Outcome.more


def fail(b: Batch, row: int, x: Tensor, steps: int) -> None:
    """No equilibrium in so many steps, which ended at x (n, 3)."""
    s = b.slots([row])
    J = determinant(b.hexes.rows(s).deformation(x[None]))[b.hexes.weights[s] > 0]
    least = float(J.min())
    failure = Failure.squeezed if least < MAX_REPORTED_J else Failure.newton
    b.courses[row].failure = NotConverged(failure, steps=steps, least_J=least)
