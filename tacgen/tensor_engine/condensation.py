"""The condensed bulk of the scenes of a batch: Schur complements with damping, reduced to what contact acts on."""

import torch
from torch import Tensor

from tacgen.mechanics.bulk_newton import DAMPING_MAX
from tacgen.mechanics.condensation import DAMPING_FACTOR, LEAST_DAMPING
from tacgen.tensor_engine.batch import Batch
from tacgen.tensor_engine.contact_newton import Quadratics
from tacgen.tensor_engine.indices import listed
from tacgen.tensor_engine.reduction import Reduction, reduced


def more(damping: float) -> float:
    """The next larger damping."""
    return max(DAMPING_FACTOR * damping, LEAST_DAMPING)


def damped(b: Batch, s: Tensor) -> Tensor:
    """Schur complements (s, k, k) with each scene's damping times that at rest."""
    t, k = b.t, 3 * b.width(s)
    S = b.read("S", s, k, k)
    each = [b.courses[row].inner_damping for row in listed(s)]
    if not any(each):
        return S
    damping = torch.tensor(each, dtype=S.dtype, device=S.device)
    needed = damping > 0
    if len(new := s[needed & ~t.rested[s]]):
        hexes, at, _, _ = b.bulk(new, b.X[new])
        rest = b.factors.schur(hexes.tangents(at, dtype=b.factors.dtype), t.nodes[new, : b.width(new)])[1]
        b.keep(new, S_0=rest)
        t.rested[new] = True
    return torch.where(needed[:, None, None], S + damping[:, None, None] * b.read("S_0", s, k, k), S)


def condensed(b: Batch, s: Tensor) -> Quadratics:
    """The condensed bulk of each scene, not reduced."""
    S = damped(b, s).to(b.t.x.dtype)
    return Quadratics(b.at_condensed(s, b.t.x[s]), S, b.read("load", s, S.shape[1]))


def reduced_to(b: Batch, s: Tensor, conn: Tensor, facets: Tensor) -> Quadratics:
    """The condensed bulk of each scene, reduced to all unknowns on which contact has acted since its tangent or its
    damping was last changed, and those of marked facets (s, f) of conn (s, f, 4).

    What is eliminated must be positive definite: a scene's damping is increased until it is.
    """
    courses, k = [b.courses[row] for row in listed(s)], 3 * b.width(s)
    own = torch.zeros(len(s), k // 3 + 1, dtype=torch.bool, device=s.device)
    own.scatter_(1, torch.where(facets[..., None], conn, k // 3).flatten(1), True)
    new = own[:, :-1].repeat_interleave(3, 1)
    kept = torch.tensor([course.reduced == course.inner_damping for course in courses], device=s.device)
    active = b.read("active", s, k)
    wanted = new | (active & kept[:, None])
    stale = torch.nonzero(~kept | (new & ~active).any(1)).squeeze(1)
    while len(stale):
        some, unknowns = s[stale], wanted[stale]
        S = damped(b, some)
        part, definite = reduced(S, unknowns[:, : S.shape[1]])
        none = {"kept": torch.where(part.kept == S.shape[1], -1, part.kept)}
        none["place"] = torch.where(part.place == part.kept.shape[1], -1, part.place)
        b.keep(some, G=part.G, X=part.X, K=part.K, active=unknowns, **none)
        again = []
        for row, fine in zip(stale.tolist(), definite.tolist(), strict=True):
            courses[row].reduced, courses[row].kept = courses[row].inner_damping, part.kept.shape[1]
            if not fine and courses[row].inner_damping <= DAMPING_MAX:
                courses[row].inner_damping = more(courses[row].inner_damping)
                again.append(row)
        stale = b.slots(again)
    bulk = condensed(b, s)
    return Quadratics(bulk.start, bulk.S, bulk.load, _reduction(b, s, k))


def _reduction(b: Batch, s: Tensor, k: int) -> Reduction:
    """The reductions that are kept, in the widths of these scenes."""
    a = max(b.courses[row].kept for row in listed(s))
    kept, place = b.read("kept", s, a), b.read("place", s, k)
    parts = b.read("G", s, k, k), b.read("X", s, k, a), b.read("K", s, a, a)
    return Reduction(torch.where(kept < 0, k, kept), torch.where(place < 0, a, place), *parts)
