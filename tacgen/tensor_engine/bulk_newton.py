"""Newton's method on the bulk of many scenes, with contact solved on the Schur complements.

Each kernel does for all scenes `s` of a batch what that of mechanics.bulk_newton does for one, and returns an outcome
for each. Quantities on which the next phase depends are read from the device once a call.
"""

from functools import partial

import numpy as np
import torch
from torch import Tensor

from tacgen.mechanics.bulk_newton import DAMPING_MAX, MIN_GAIN, ROUNDING, SHORTEST
from tacgen.mechanics.condensation import DAMPING_FACTOR, LEAST_DAMPING
from tacgen.mechanics.failures import SQUEEZED, Failure, NotConverged
from tacgen.mechanics.options import SolverOptions
from tacgen.mechanics.phases import Outcome
from tacgen.tensor_engine import contact_newton
from tacgen.tensor_engine.batch import Batch, Course
from tacgen.tensor_engine.condensation import condensed, more, reduced_to
from tacgen.tensor_engine.contact import Contacts
from tacgen.tensor_engine.contact_newton import CONVERGED, RUNNING, UNSTABLE, Iterates, at_nodes
from tacgen.tensor_engine.elements import determinant
from tacgen.tensor_engine.indices import listed
from tacgen.tensor_engine.load_step import cover, covers, take


def begin_step(b: Batch, s: Tensor) -> list[Outcome]:
    """Counts a step of the bulk; the nodes to condense to follow the contact."""
    outcomes, options, going = [], b.options, []
    for k, row in enumerate(listed(s)):
        course = b.courses[row]
        if course.newton_steps == options.max_newton:
            fail(b, row, b.t.x[row], course.newton_steps)
        elif course.effort + 1 > options.max_effort:
            course.effort += 1
            course.failure = NotConverged(Failure.effort, steps=options.max_effort)
        else:
            course.effort, course.newton_steps = course.effort + 1, course.newton_steps + 1
            going.append(k)
    if going:
        some = s[going]
        facets = touched(b, some)
        cover(b, some, facets, ~covers(b, some, facets))
    for k, row in enumerate(listed(s)):
        course = b.courses[row]
        course.new = course.new or not course.usable
        ready = Outcome.missing if course.new else Outcome.ready
        outcomes.append(ready if k in set(going) else Outcome.failure)
    return outcomes


def touched(b: Batch, s: Tensor) -> Tensor:
    """The facets (s, f) on which the indenter acts at the iterate; if none, those on which it acted last, or the
    nearest."""
    contact = b.face(s, b.t.offset[s])
    gap = contact.gap(contact.points(b.t.x[s]))
    now, last = (gap < contact.dhat[:, None, None]).any(-1), (b.t.h_N[s] > 0).any(-1)
    nearest = gap.amin(-1) <= gap.flatten(1).amin(1, keepdim=True)
    out = torch.where(last.any(1, keepdim=True), last, nearest)
    return torch.where(now.any(1, keepdim=True), now, out)


def factor(b: Batch, s: Tensor) -> list[Outcome]:
    """The tangents at the iterates, with the pressures predicted."""
    good = take(b, s, b.t.x[s], b.t.J[s] if b.options.mixed_pressure else None)
    for row, fine in zip(listed(s), good, strict=True):
        if not fine:
            fail(b, row, b.t.begins[row], 0)
    return [Outcome.ready if fine else Outcome.indefinite for fine in good]


def load(b: Batch, s: Tensor) -> list[Outcome]:
    """The unbalanced forces, condensed, and the contact before its first step."""
    t = b.t
    hexes, at, folding, _ = b.bulk(s, t.x[s])
    g = hexes.mixed_forces(at, t.J[s], t.taken[s])
    folding.add_forces(g)
    y, load = b.factors.forward(s, g)
    b.keep(s, load=load.to(g.dtype))
    t.put(s, g=g, y=y.to(g.dtype))
    _untouched(b, s)
    for row in listed(s):
        b.courses[row].inner_damping = b.courses[row].damping
    return [Outcome.ready] * len(s)


def _untouched(b: Batch, s: Tensor) -> None:
    """The contact before its first step."""
    t = b.t
    x = torch.zeros_like(t.c_x[s])
    x[:, : b.width(s)] = b.at_condensed(s, t.x[s])
    zero = torch.zeros_like(t.c_drift[s])
    t.put(s, c_x=x, c_offset=t.offset[s], c_length=zero + torch.inf, c_drift=zero, c_gap=zero - 1, c_steps=zero.long())


def contact(b: Batch, s: Tensor) -> list[Outcome]:
    """One step of the contact."""
    t, m, near = b.t, b.width(s), b.near(s, b.t.c_offset[s])
    now = Iterates(t.c_x[s, :m], near, t.c_steps[s], t.c_length[s], t.c_drift[s], t.c_gap[s], t.c_status[s])
    after = contact_newton.step(
        partial(reduced_to, b, s, near.conn), now, b.reach[s], step_end(b, s), b.edge[s], b.options.max_contact
    )
    x = t.c_x[s]
    x[:, :m] = after.x
    t.put(
        s, c_x=x, c_offset=after.contact.offset, c_steps=after.steps, c_length=after.length, c_drift=after.drift,
        c_gap=after.gap, c_status=after.status,
    )  # fmt: skip
    ends = {RUNNING: Outcome.more, UNSTABLE: Outcome.unstable}
    return [ends.get(status, Outcome.ended) for status in after.status.tolist()]


def damp(b: Batch, s: Tensor) -> list[Outcome]:
    """No step lowers the energy: with kept tangents, new ones; with new ones, more damping."""
    outcomes, again = [], []
    for row in listed(s):
        course = b.courses[row]
        if not course.new:
            course.damping, course.new = course.inner_damping, True
            outcomes.append(Outcome.missing)
        elif course.inner_damping > DAMPING_MAX:
            fail(b, row, b.t.x[row], course.newton_steps)
            outcomes.append(Outcome.failure)
        else:
            course.inner_damping = more(course.inner_damping)
            again.append(row)
            outcomes.append(Outcome.ready)
    if again:
        _untouched(b, b.slots(again))
    return outcomes


def search(b: Batch, s: Tensor) -> list[Outcome]:
    """Line search: the first of the whole step, a half, a quarter... that lowers the energy, normal forces frozen."""
    t, bulk, near = b.t, condensed(b, s), b.near(s, b.t.c_offset[s])
    m, x = bulk.start.shape[1], t.x[s]
    inner = t.c_x[s, :m]
    u = (inner - bulk.start).flatten(1)
    p = b.factors.expand(s, u, t.y[s]).to(x.dtype)
    forces = near.evaluate(inner)
    before = near.merit(bulk.start, forces)
    change = near.merit_at(forces, forces) - before
    # of the bulk g.p + p.Kp/2 = (g.p + p.(g + Kp))/2; g + Kp is 0 but for the condensed unknowns
    condensed_gradient = (bulk.S @ u[..., None]).squeeze(-1) + bulk.load
    model = ((t.g[s] * p).sum((1, 2)) + (u * condensed_gradient).sum(1)) / 2 + change
    energy = t.energy[s]
    rounding = step_end(b, s) * t.h_least[s] + ROUNDING * energy.abs()
    part, there = torch.zeros_like(energy), energy.clone()
    open_, fraction = torch.arange(len(s), device=s.device), 1.0
    while len(open_) and fraction >= SHORTEST:
        at = x[open_] + fraction * p[open_]
        value = b.bulk(s[open_], at)[3]
        of_contact = change[open_]
        if fraction < 1:
            touch = bulk.start[open_] + fraction * (inner - bulk.start)[open_]
            of_contact = near.rows(open_).merit(touch, forces.rows(open_)) - before[open_]
        total = value - energy[open_] + of_contact
        share = total / torch.minimum(fraction * model[open_], -rounding[open_])
        share = torch.where(total.abs() <= rounding[open_], 1.0, share)
        good = share >= MIN_GAIN
        done = open_[good]
        part[done], there[done] = fraction, value[good]
        open_, fraction = open_[~good], fraction / 2
    t.put(s, stepped=x + part[:, None, None] * p, stepped_energy=there, c_x=_partly(b, s, bulk.start, inner, part))
    taken = part.tolist()
    for row, fraction in zip(listed(s), taken, strict=True):
        b.courses[row].part = fraction
    return [Outcome.ready if fraction > 0 else Outcome.higher for fraction in taken]


def _partly(b: Batch, s: Tensor, start: Tensor, inner: Tensor, part: Tensor) -> Tensor:
    """Condensed positions (s, most, 3) after a part of the step."""
    x = b.t.c_x[s]
    x[:, : start.shape[1]] = torch.where(
        (part < 1)[:, None, None], start + part[:, None, None] * (inner - start), inner
    )
    return x


def step_end(b: Batch, s: Tensor) -> Tensor:
    """Motion of a node (s,) below which a step is small [mm]."""
    return b.options.step_tol * b.dhat[s]


def measure(b: Batch, s: Tensor) -> list[Outcome]:
    """The residual after a step: whether it is small enough, and else the damping and the tangent of the next one."""
    t, options = b.t, b.options
    x, there = t.x[s], t.stepped[s]
    moved = (there - x).abs().flatten(1).amax(1)
    hexes, after, folding, _ = b.bulk(s, there)
    J = after.J
    if options.mixed_pressure:
        F = hexes.deformation(x)
        J = hexes.predicted(F, determinant(F), after.F, t.taken[s])
    gradient = hexes.forces(after)
    folding.add_forces(gradient)
    near = b.near(s, t.c_offset[s])
    forces = near.evaluate(t.c_x[s, : b.width(s)])
    residual = torch.linalg.norm(_unbalanced(b, s, gradient, near, forces.force).flatten(1), dim=1)
    residual = residual / torch.maximum(forces.total, t.h_least[s])
    t.put(s, x=there, energy=t.stepped_energy[s], J=J, offset=t.c_offset[s])
    covered = covers(b, s, touched(b, s))
    still = moved <= step_end(b, s)
    columns = (residual, still, covered, t.c_status[s] == CONVERGED, t.c_steps[s])
    figures = torch.stack([part.to(residual.dtype) for part in columns], 1).tolist()
    return [_measured(options, b.courses[row], *each) for row, each in zip(listed(s), figures, strict=True)]


def _unbalanced(b: Batch, s: Tensor, gradient: Tensor, near: Contacts, force: Tensor) -> Tensor:
    """Forces (s, n, 3) at the free nodes, gradient less what contact (near, at its points) exerts; 0 at the others."""
    nodes = b.t.nodes[s, : b.width(s)]
    push = at_nodes(near, force, nodes.shape[1])
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
    steps: float,
) -> Outcome:  # fmt: skip
    """The outcome for one scene, and its next damping and tangent."""
    damping, before, ended = course.inner_damping, course.residual, bool(converged) and course.part == 1
    if damping > 0 and not options.through_folds:
        course.failure = NotConverged(Failure.folds)
        return Outcome.failure
    course.residual, course.newton_damped = residual, course.newton_damped + (damping > 0)
    small = bool(still) and residual <= options.residual_max / 2 and damping == 0
    if ended and (residual <= options.residual_tol or small) and covered:
        course.found = True
        return Outcome.ended
    if np.isfinite(before):  # a kept tangent reduces the residual about half as much as a new one
        course.rate = (2 if course.new else 1) * residual / before
    slow = course.rate >= 1 or np.log(options.residual_tol / residual) < options.patience * np.log(course.rate)
    course.new = not options.keep_tangent or course.part < 1 or bool(slow)
    if not ended and steps >= options.max_contact:
        course.damping = damping if residual < before else more(damping)
    elif course.part < 1:
        course.damping = damping
    else:
        course.damping = 0.0 if damping <= LEAST_DAMPING else damping / DAMPING_FACTOR
    return Outcome.more


def fail(b: Batch, row: int, x: Tensor, steps: int) -> None:
    """No equilibrium in so many steps, which ended at x (n, 3)."""
    s = b.slots([row])
    hexes = b.hexes.rows(s)
    J = hexes.evaluate(x[None]).J[hexes.weights > 0]
    least = float(J.min())
    failure = Failure.squeezed if least < SQUEEZED else Failure.newton
    b.courses[row].failure = NotConverged(failure, steps=steps, least_J=least)
