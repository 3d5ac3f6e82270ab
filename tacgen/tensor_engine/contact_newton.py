"""Newton's method for contact with friction on the condensed bulk of many scenes: one step of each at a time.

Each scene takes the step that mechanics.contact_newton would take: the coupled step in full if it halves the residual;
else along it, or along the symmetric one, by Armijo's rule.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from tacgen.mechanics.contact_newton import FULL_STEP, MIN_COUPLED, ROUNDING, SHORTEST
from tacgen.mechanics.line_search import ARMIJO
from tacgen.tensor_engine.contact import Contacts, Forces
from tacgen.tensor_engine.reduction import Reduction, with_points
from tacgen.tensor_engine.replay import recording

RUNNING, CONVERGED, STOPPED, UNSTABLE, SEARCHING = range(5)  # see mechanics.contact_newton.ContactStatus


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

    def energy(self, x: Tensor, gradient: Tensor) -> Tensor:
        """Energy (s,) at positions x (s, m, 3) with a gradient."""
        return ((x - self.start).flatten(1) * (gradient.flatten(1) + self.load)).sum(1) / 2

    def solve(self, contact: Contacts, D: Tensor, g: Tensor, symmetric: bool) -> tuple[Tensor, Tensor]:
        """The steps (s, m, 3) that balance g with tangents D (s, f, q, 3, 3) of the contact, and which exist (s,)."""
        assert self.reduction is not None
        part, facets = self.reduction, (contact.conn, contact.ends, contact.N)
        K = with_points(part.K, part.slots, part.kept, part.place, *facets, D)
        p, good = part.solve(K, -g.flatten(1), symmetric)
        return p.view_as(g), good


def at_nodes(contact: Contacts, forces: Tensor, nodes: int) -> Tensor:
    """Nodal forces (s, n, c) of forces (s, f, q, c) at points; corner by corner, since on a grid a node is a certain
    corner of one facet only: so the order of summation is always the same."""
    if contact.ends is not None:
        from tacgen.tensor_engine import gpu_facets

        return gpu_facets.at_nodes(contact.ends, contact.N, forces)
    parts = contact.N.T @ forces
    out = forces.new_zeros(len(forces), nodes, forces.shape[-1])
    for corner in range(4):
        at = contact.conn[..., corner, None].expand(parts.shape[:2] + parts.shape[3:])
        out.scatter_add_(1, at, parts[:, :, corner])
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
    near = (now.length <= now.contact.dhat) & (now.gap >= 0)  # far from the solution the mean gap is meaningless
    drift = torch.where(near, now.gap - now.contact.offset, now.drift)
    return now.contact.shrunk(torch.where(near, now.gap, now.contact.offset)), drift


def step(
    bulk: Quadratics, now: Iterates, reach: Tensor, xtol: Tensor, radius: Tensor, max_steps: int, symmetric: bool
) -> Iterates:
    """One step of each scene towards the equilibrium of bulk, barrier and friction, with indenters shrunk by the mean
    gap; see mechanics.contact_newton.contact_step.

    bulk: reduced to what contact acts on; reach, xtol, radius (s,) [mm]. symmetric: whether these are scenes that take
    a part of the symmetric step. Otherwise those of whose coupled step no part is good enough, which are few, stay as
    they are, but SEARCHING.
    """
    x, length, (contact, drift) = now.x, now.length, shrunk(now)
    forces = contact.evaluate(x)
    gradient = bulk.gradient(x)
    g = gradient - at_nodes(contact, forces.force, x.shape[1])
    going = now.steps < max_steps
    p, exists = bulk.solve(contact, forces.definite if symmetric else forces.tangent, g, symmetric)
    first, bent = contact.max_step(forces.gap, p, reach), bulk.times(p.flatten(1)).view_as(x)
    full = torch.zeros_like(going)
    if not symmetric:
        whole = gradient + bent - at_nodes(contact, contact.evaluate(x + p).force, x.shape[1])
        full = exists & (first >= 1) & (_norm(whole) <= FULL_STEP * _norm(g))
    fraction = torch.ones_like(length)
    if recording() or not bool((full | ~going).all()):
        least = SHORTEST if symmetric else MIN_COUPLED
        along = bulk.energy(x, gradient), (gradient * p).sum((1, 2)), (p * bent).sum((1, 2))
        fraction = torch.where(full, fraction, _downhill(along, contact, forces, x, g, p, exists, first, least))
    there = x + fraction[:, None, None] * p
    felt = contact.evaluate(there)
    waits = going & (fraction == 0) & (not symmetric)
    longest = p.abs().flatten(1).amax(1)
    stuck = fraction == 0
    gone = (there - bulk.start).abs().flatten(1).amax(1) > radius
    there = torch.where(gone[:, None, None], x + _to_radius(x - bulk.start, there - x, radius) * (there - x), there)
    gap = torch.where(felt.total > 0, felt.mean_gap, -1.0)
    off = torch.where(gap >= 0, gap - contact.offset, 0.0)
    small = longest <= xtol
    done = (fraction == 1) & small & (torch.maximum(drift.abs(), off.abs()) <= xtol)
    stalled = ~done & (fraction * longest < SHORTEST * xtol)
    status = torch.where(done | (stalled & small), CONVERGED, torch.where(stalled, STOPPED, RUNNING))
    status = torch.where(going, torch.where(stuck | gone, UNSTABLE, status), STOPPED)
    moved, old = going & ~stuck & ~waits, now.contact.offset
    return Iterates(
        torch.where(moved[:, None, None], there, x), contact.shrunk(torch.where(waits, old, contact.offset)),
        now.steps + (going & ~waits), torch.where(moved & ~gone, longest, length),
        torch.where(waits, now.drift, drift), torch.where(waits, now.gap, gap), torch.where(waits, SEARCHING, status),
    )  # fmt: skip


def _norm(g: Tensor) -> Tensor:
    return torch.linalg.norm(g.flatten(1), dim=1)


def _to_radius(gone: Tensor, step: Tensor, radius: Tensor) -> Tensor:
    """Fractions (s, 1, 1) of steps (s, m, 3) at which the first entry reaches the radius."""
    far = radius[:, None, None] - torch.sign(step) * gone
    away = torch.where(step != 0, far / step.abs().clamp(min=1e-300), torch.inf)
    return away.flatten(1).amin(1).clamp(min=0.0)[:, None, None]


def _downhill(
    bulk: tuple[Tensor, Tensor, Tensor],
    contact: Contacts,
    forces: Forces,
    x: Tensor,
    g: Tensor,
    p: Tensor,
    exists: Tensor,
    first: Tensor,
    least: float,
) -> Tensor:
    """The first of the fractions (s,) `first`, first/2, ... of steps p that lowers the merit function by Armijo's rule;
    0 if none down to `least` does, or there is no step. bulk: its energy at x and the derivatives along p (s,)."""
    energy, linear, square = bulk
    here = energy + contact.merit_at(forces, forces)
    slope = (g * p).sum((1, 2))
    fractions = halves(first, least)
    merit = energy[:, None] + fractions * linear[:, None] + fractions**2 * square[:, None] / 2
    merit = merit + contact.merits(x, p, fractions, forces)
    most = (here + ROUNDING * here.abs())[:, None] + ARMIJO * fractions * slope[:, None]
    return first_of(fractions, (merit <= most) & (exists & (slope <= 0))[:, None] & (fractions >= least))


def halves(first: Tensor, shortest: float) -> Tensor:
    """The fractions (s, t) first, first/2, ..., as many as are longer than `shortest` where first is 1: a line search
    tries all at once, since a GPU hardly takes longer for many."""
    return first[:, None] * 0.5 ** torch.arange(int(-np.log2(shortest)) + 1, device=first.device)


def first_of(fractions: Tensor, accepted: Tensor) -> Tensor:
    """The first fraction (s,) of each row that is accepted (s, t), 0 if none is."""
    first = accepted.to(torch.int8).argmax(1, keepdim=True)
    return torch.where(accepted.any(1), fractions.gather(1, first).squeeze(1), 0.0)
