"""Newton's method for contact with friction on the condensed bulk of many scenes: one step of each at a time.

Each scene takes the step that mechanics.contact_newton would take: the coupled step in full if it halves the residual;
else along it, or along the symmetric one, by Armijo's rule.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tacgen.mechanics.contact_newton import (
    MAX_FULL_STEP_RESIDUAL_RATIO,
    MERIT_ROUNDING,
    MIN_COUPLED_FRACTION,
    MIN_LINE_SEARCH_FRACTION,
)
from tacgen.mechanics.line_search import ARMIJO_DECREASE
from tacgen.physics import facets
from tacgen.physics.runtime import launch
from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine.contact import Contacts
from tacgen.tensor_engine.indices import constant
from tacgen.tensor_engine.records import Forces
from tacgen.tensor_engine.reduction import Reduction, with_points
from tacgen.tensor_engine.replay import recording

RUNNING, CONVERGED, STOPPED, UNSTABLE, SEARCHING = range(5)  # see mechanics.contact_newton.ContactStatus
# of the first fraction of a step
STEP_HALVINGS = np.concatenate([[0.0], 0.5 ** np.arange(int(-np.log2(MIN_LINE_SEARCH_FRACTION)) + 1)])
LONGEST_COLUMN, FULL_STEP_COLUMN = 4, 5  # columns of figures, see `tried`


@dataclass(frozen=True)
class Quadratics:
    """The condensed bulk of each scene: u . load + u . S u / 2 of displacements u (s, k) from `start` (s, m, 3), with
    the product `times` of S (s, k, k) [N/mm] and u, and load (s, k) [N]; k = 3 m, padded with a unit matrix.
    reduction: of S to what contact acts on.
    """

    start: Tensor
    times: Callable[[Tensor], Tensor]
    load: Tensor
    reduction: Reduction | None = None

    def gradient(self, x: Tensor) -> Tensor:
        """Gradient (s, m, 3) at positions x (s, m, 3)."""
        return (self.times((x - self.start).flatten(1)) + self.load).view_as(x)

    def solve(self, contact: Contacts, D: Tensor, g: Tensor, symmetric: bool) -> tuple[Tensor, Tensor]:
        """The steps (s, m, 3) that balance g with tangents D (s, f, q, 3, 3) of the contact, and which exist (s,)."""
        assert self.reduction is not None
        part, facets = self.reduction, (contact.conn, contact.ends, contact.N)
        K = with_points(part.K, part.slots, part.kept, part.place, *facets, D)
        p, good = part.solve(K, -g.flatten(1), symmetric)
        return p.view_as(g), good


def at_nodes(contact: Contacts, forces: Tensor, nodes: int) -> Tensor:
    """Nodal forces (s, n, 3) of forces (s, f, q, 3) at points."""
    out = forces.new_empty(len(forces), nodes, 3)
    launch(facets.at_nodes, out.shape[:2], contact.ends, contact.N, forces, out)
    return out


@dataclass(frozen=True)
class Iterates:
    """Positions x (s, m, 3), contacts with their offsets there, steps so far (s,), the longest motion of a node in the
    last step, by how much the mean gap was off before it and the mean gap after it, negative without contact [mm] (s,),
    and how it stands (s,)."""

    x: Tensor
    contact: Contacts
    steps: Tensor
    length: Tensor
    drift: Tensor
    gap: Tensor
    status: Tensor


def shrunk(now: Iterates) -> tuple[Contacts, Tensor]:
    """Contacts whose indenters are shrunk by the mean gap, and by how much it was off."""
    contact, (length, gap, drift) = now.contact, (now.length, now.gap, now.drift)
    if devices.by_kernels(gap):
        from tacgen.tensor_engine import gpu_steps

        offset, drift = gpu_steps.shrunk(length, contact.dhat, gap, contact.offset, drift)
        return contact.shrunk(offset), drift
    near = (length <= contact.dhat) & (gap >= 0)  # far from the solution the mean gap is meaningless
    drift = torch.where(near, gap - contact.offset, drift)
    return contact.shrunk(torch.where(near, gap, contact.offset)), drift


def step(
    bulk: Quadratics, now: Iterates, reach: Tensor, xtol: Tensor, radius: Tensor, max_steps: int, symmetric: bool
) -> tuple[Iterates, Tensor]:
    """One step of each scene towards the equilibrium of bulk, barrier and friction, with indenters shrunk by the mean
    gap; see mechanics.contact_newton.contact_step. And the normal forces (s, f, q) [N] before it.

    bulk: reduced to what contact acts on; reach, xtol, radius (s,) [mm]. symmetric: whether these are scenes that take
    a part of the symmetric step. Otherwise those of whose coupled step no part is good enough, which are few, stay as
    they are, but SEARCHING.
    """
    x, (contact, drift), least = now.x, shrunk(now), MIN_LINE_SEARCH_FRACTION if symmetric else MIN_COUPLED_FRACTION
    forces, gradient = contact.evaluate(x), bulk.gradient(x)
    g = gradient - at_nodes(contact, forces.force, x.shape[1])
    p, exists = bulk.solve(contact, forces.definite if symmetric else forces.tangent, g, symmetric)
    bent, whole = bulk.times(p.flatten(1)).view_as(x), None
    if not symmetric:
        whole = gradient + bent - at_nodes(contact, contact.evaluate(x + p).force, x.shape[1])
    trial = TriedStep(x, bulk.start, bulk.load, gradient, g, p, bent, whole, exists)
    fractions, figures = tried(trial, contact, forces.gap, reach, least)
    if (
        devices.by_kernels(x)
        or recording()
        or not bool(((figures[:, FULL_STEP_COLUMN] > 0) | (now.steps >= max_steps)).all())
    ):
        fraction = downhill(fractions, figures, contact.merits(x, p, fractions, forces), least)
    else:
        fraction = torch.ones_like(reach)
    there = x + fraction[:, None, None] * p
    felt = contact.evaluate(there)
    parts = contact, drift, bulk.start, there, fraction, figures, felt, xtol, radius, max_steps, symmetric
    return ended(now, *parts), forces.N


class TriedStep(NamedTuple):
    """A step p (s, m, 3) from x, the bulk's start and load, its gradient and the whole one g at x, and by how much the
    bulk's changes along p (s, m, 3) or (s, 3m); the whole one at x + p, None if it does not matter; and which steps
    exist (s,)."""

    x: Tensor
    start: Tensor
    load: Tensor
    gradient: Tensor
    g: Tensor
    p: Tensor
    bent: Tensor
    whole: Tensor | None
    exists: Tensor


def tried(trial: TriedStep, contact: Contacts, gap: Tensor, reach: Tensor, least: float) -> tuple[Tensor, Tensor]:
    """Fractions (s, t) of steps: 0, the first without tunnelling, a half of it and so on, as many as are longer than
    `least` where the first is 1: a line search tries all at once, since a GPU hardly takes longer for many.

    And figures (s, 6): the bulk's energy at x and its first and second derivative along p, the slope of all energy, inf
    where there is no step, the longest motion of a node [mm], and whether the step halves the residual, 1, or not, 0.
    """
    halves = constant(STEP_HALVINGS, reach)[: int(-np.log2(least)) + 2]
    if devices.by_kernels(reach):
        from tacgen.tensor_engine import gpu_steps

        return gpu_steps.tried(*trial, contact, gap, reach, halves)
    x, start, load, gradient, g, p, bent, whole, exists = trial
    first = contact.max_step(gap, p, reach)
    full = torch.zeros_like(exists)
    if whole is not None:
        full = exists & (first >= 1) & (_norm(whole) <= MAX_FULL_STEP_RESIDUAL_RATIO * _norm(g))
    energy = ((x - start).flatten(1) * (gradient.flatten(1) + load)).sum(1) / 2
    linear, square, slope = ((one * other).sum((1, 2)) for one, other in ((gradient, p), (p, bent), (g, p)))
    columns = energy, linear, square, torch.where(exists, slope, torch.inf), p.abs().flatten(1).amax(1), full.to(p)
    return first[:, None] * halves, torch.stack(columns, 1)


def _norm(g: Tensor) -> Tensor:
    return torch.linalg.norm(g.flatten(1), dim=1)


def downhill(fractions: Tensor, figures: Tensor, merits: Tensor, least: float) -> Tensor:
    """The first fraction (s,) that lowers the merit function by Armijo's rule; 0 if none down to `least` does, or there
    is no step, and 1 where it halves the residual. merits (s, t): the contact's energy at the fractions."""
    if devices.by_kernels(merits):
        from tacgen.tensor_engine import gpu_steps

        return gpu_steps.downhill(fractions, figures, merits, least)
    energy, linear, square, slope, _, full = figures[..., None].unbind(1)
    merit = energy + fractions * linear + fractions**2 * square / 2 + merits
    here = merit[:, :1]
    most = here + MERIT_ROUNDING * here.abs() + ARMIJO_DECREASE * fractions * slope
    lower = (merit <= most) & (slope <= 0) & (fractions >= least)
    first = lower.to(torch.int8).argmax(1, keepdim=True)
    return torch.where(full > 0, 1.0, torch.where(lower.any(1, keepdim=True), fractions.gather(1, first), 0.0))[:, 0]


def ended(
    now: Iterates, contact: Contacts, drift: Tensor, start: Tensor, there: Tensor, fraction: Tensor, figures: Tensor,
    felt: Forces, xtol: Tensor, radius: Tensor, max_steps: int, symmetric: bool,
) -> Iterates:  # fmt: skip
    """After fractions (s,) of steps from now.x to `there` (s, m, 3), where contact is `felt`; see `step`."""
    x, before, length = now.x, now.contact.offset, now.length
    if devices.by_kernels(x):
        from tacgen.tensor_engine import gpu_steps

        x, offset, *rest = gpu_steps.ended(
            x, there, start, fraction, figures, felt.N, felt.gap, radius, xtol, before, contact.offset, length,
            now.drift, drift, now.gap, now.steps, max_steps, symmetric,
        )  # fmt: skip
        return Iterates(x, contact.shrunk(offset), *rest)
    going, stuck, longest = now.steps < max_steps, fraction == 0, figures[:, LONGEST_COLUMN]
    waits = going & stuck & (not symmetric)
    gone = (there - start).abs().flatten(1).amax(1) > radius
    there = torch.where(gone[:, None, None], x + _to_radius(x - start, there - x, radius) * (there - x), there)
    gap = torch.where(felt.total > 0, felt.mean_gap, -1.0)
    off = torch.where(gap >= 0, gap - contact.offset, 0.0)
    small = longest <= xtol
    done = (fraction == 1) & small & (torch.maximum(drift.abs(), off.abs()) <= xtol)
    stalled = ~done & (fraction * longest < MIN_LINE_SEARCH_FRACTION * xtol)
    status = torch.where(done | (stalled & small), CONVERGED, torch.where(stalled, STOPPED, RUNNING))
    status = torch.where(going, torch.where(stuck | gone, UNSTABLE, status), STOPPED)
    moved = going & ~stuck
    return Iterates(
        torch.where(moved[:, None, None], there, x), contact.shrunk(torch.where(waits, before, contact.offset)),
        now.steps + (going & ~waits), torch.where(moved & ~gone, longest, length),
        torch.where(waits, now.drift, drift), torch.where(waits, now.gap, gap), torch.where(waits, SEARCHING, status),
    )  # fmt: skip


def _to_radius(gone: Tensor, step: Tensor, radius: Tensor) -> Tensor:
    """Fractions (s, 1, 1) of steps (s, m, 3) at which the first entry reaches the radius."""
    far = radius[:, None, None] - torch.sign(step) * gone
    away = torch.where(step != 0, far / step.abs().clamp(min=1e-300), torch.inf)
    return away.flatten(1).amin(1).clamp(min=0.0)[:, None, None]
