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

from tacgen.physics import facets, steps
from tacgen.physics.decisions import MIN_COUPLED_FRACTION, MIN_LINE_SEARCH_FRACTION
from tacgen.physics.runtime import lanes, launch
from tacgen.tensor_engine.contact import Contacts, Forces
from tacgen.tensor_engine.indices import constant
from tacgen.tensor_engine.reduction import Reduction, with_points
from tacgen.tensor_engine.replay import recording

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
    last step, by how much the mean gap was off before it and the mean gap after it, nan without contact [mm] (s,),
    and its ContactStatus (s,)."""

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
    parts = torch.empty_like(gap), torch.empty_like(gap)
    launch(steps.shrunk, gap.shape, length, contact.dhat, gap, contact.offset, drift, *parts)
    return contact.shrunk(parts[0]), parts[1]


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
    if x.is_cuda or recording() or not bool(((figures[:, FULL_STEP_COLUMN] > 0) | (now.steps >= max_steps)).all()):
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
    x, *others, exists = trial
    flat = [part if part is None else part.flatten(1) for part in (x, *others)]
    fractions, figures, step = x.new_empty(len(x), len(halves)), x.new_empty(len(x), 6), lanes(x)
    launch(
        steps.tried, (len(x), step), *flat, exists, contact.conn, contact.N, gap, reach, halves, step, fractions,
        figures,
    )  # fmt: skip
    return fractions, figures


def downhill(fractions: Tensor, figures: Tensor, merits: Tensor, least: float) -> Tensor:
    """The first fraction (s,) that lowers the merit function by Armijo's rule; 0 if none down to `least` does, or there
    is no step, and 1 where it halves the residual. merits (s, t): the contact's energy at the fractions."""
    out = torch.empty_like(fractions[:, 0])
    launch(steps.downhill, out.shape, fractions, figures, merits, least, out)
    return out


def ended(
    now: Iterates, contact: Contacts, drift: Tensor, start: Tensor, there: Tensor, fraction: Tensor, figures: Tensor,
    felt: Forces, xtol: Tensor, radius: Tensor, max_steps: int, symmetric: bool,
) -> Iterates:  # fmt: skip
    """After fractions (s,) of steps from now.x to `there` (s, m, 3), where contact is `felt`; see `step`."""
    x, threads = now.x, lanes(now.x)
    out = [torch.empty_like(like) for like in (x, now.length, now.steps, now.length, drift, now.gap, now.status)]
    launch(
        steps.ended, (len(x), threads), *(part.flatten(1) for part in (x, there, start)), fraction, figures,
        felt.N.flatten(1), felt.gap.flatten(1), radius, xtol, now.contact.offset, contact.offset, now.length, now.drift,
        drift, now.gap, now.steps, max_steps, symmetric, threads, out[0].flatten(1), *out[1:],
    )  # fmt: skip
    x, offset, *rest = out
    return Iterates(x, contact.shrunk(offset), *rest)
