"""The condensed bulk of the scenes of a batch: Schur complements with damping, reduced to what contact acts on."""

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from tacgen.mechanics.bulk_newton import MAX_DAMPING
from tacgen.mechanics.condensation import more
from tacgen.physics import facets
from tacgen.physics.runtime import lanes, launch
from tacgen.tensor_engine.batch import Batch, Sizes
from tacgen.tensor_engine.contact import Contacts
from tacgen.tensor_engine.contact_newton import Quadratics
from tacgen.tensor_engine.indices import gathered
from tacgen.tensor_engine.products import slot_times
from tacgen.tensor_engine.reduction import Reduction, reduced

Damping = tuple[list[float], ...]  # of each scene of a call; empty if no scene is damped


def damping(b: Batch, rows: Sequence[int]) -> Damping:
    """The damping of each scene, for which there is the Schur complement at rest afterwards."""
    each = [b.courses[row].newton.inner_damping for row in rows]
    new = [row for row, damped in zip(rows, each, strict=True) if damped > 0 and not b.scenes[row].rested]
    if new:
        some, sizes = b.slots(new), b.sizes(new)
        K = b.at_rest.rows(some).tangents(b.X[some], dtype=b.factors.dtype)[1]
        b.keep(some, S_0=b.factors.schur(K, b.t.nodes[some, : sizes.nodes], sizes.fewest)[1])
        for row in new:
            b.scenes[row].rested = True
    return (each,) if any(each) else ()


def condensed(b: Batch, sizes: Sizes, s: Tensor, *damping: Tensor) -> Quadratics:
    """The condensed bulk of each scene with its damping (s,), if one is damped; not reduced."""
    k = sizes.unknowns
    S, at_rest, used = b.wide("S", k, k), b.wide("S_0", k, k), (b.t.own, b.t.own)

    def times(u: Tensor) -> Tensor:
        out = slot_times(S, s, u, used=used)
        for factor in damping:
            more = factor[:, None] * slot_times(at_rest, s, u, used=used)
            out = torch.where(factor[:, None] > 0, out + more, out)
        return out

    return Quadratics(b.at_condensed(s, b.t.x, sizes.nodes), times, b.read("load", s, k))


def _damped(b: Batch, sizes: Sizes, s: Tensor, *damping: Tensor) -> Tensor:
    """Schur complements (s, k, k) with each scene's damping times that at rest."""
    k = sizes.unknowns
    S = b.read("S", s, k, k)
    if not damping:
        return S
    factor = damping[0].to(S.dtype)[:, None, None]
    return torch.where(factor > 0, S + factor * b.read("S_0", s, k, k), S)


def reduce(b: Batch, rows: Sequence[int]) -> None:
    """Reduce the condensed bulk of each scene to its `wanted` unknowns, of which it has `kept`.

    What is eliminated must be positive definite: a scene's damping is increased until it is.
    """
    while rows:
        damped, sizes, again = damping(b, rows), b.sizes(rows, reducing=True), []
        key, work = ("reduce", sizes.nodes, sizes.kept, sizes.lost, bool(damped)), partial(_reduce, b, sizes)
        for row, fine in zip(rows, b.replays(key, work, rows, *damped), strict=True):
            newton = b.courses[row].newton
            b.scenes[row].reduced = newton.inner_damping
            if not fine and newton.inner_damping <= MAX_DAMPING:
                newton.inner_damping = more(newton.inner_damping)
                again.append(row)
        rows = again


def _reduce(b: Batch, sizes: Sizes, s: Tensor, *damping: Tensor) -> tuple[Tensor, None]:
    """Keeps what `reduction.reduced` gives. Tells where what is eliminated is positive definite (s,)."""
    wanted = b.read("wanted", s, sizes.unknowns)
    exists = (b.t.nodes[s, : sizes.nodes] >= 0).repeat_interleave(3, 1)
    part, definite = reduced(_damped(b, sizes, s, *damping), wanted, exists, sizes.kept, sizes.lost)
    b.t.put(s, lost_count=part.used[0], kept_count=part.used[1])
    b.keep(s, G=part.G, X=part.X, K=part.K, kept=part.kept, lost=part.lost, place=part.place, active=wanted)
    return definite, None


def reduction(b: Batch, sizes: Sizes, s: Tensor) -> Reduction:
    """The reductions that are kept, in the sizes of a call but for what is eliminated, for which there is no other
    size: its products are cheap, and recordings of work few."""
    k, a, e = sizes.unknowns, sizes.kept, b.t.G.shape[1]
    kept, place, lost = gathered(s, b.wide("kept", a), b.wide("place", k), b.t.lost)
    used = b.t.lost_count, b.t.kept_count
    return Reduction(kept, lost, place, b.t.G, b.wide("X", e, a), b.wide("K", a, a), s, used)


def acted(b: Batch, sizes: Sizes, s: Tensor, contact: Contacts, N: Tensor, kept: Tensor) -> tuple[Tensor, ...]:
    """Marks as `wanted` the unknowns on which contact has acted since the last tangent or change of damping, if those
    of the reduction are `kept` (s,), and those of facets at a point of which it acts with N > 0 (s, f, q).

    Returns where they are more than those to which the bulk is reduced (s,) bool, and how many they are (s,).
    """
    stale, count, step = kept.new_empty(len(s), dtype=torch.bool), torch.empty_like(s), lanes(s)
    launch(
        facets.acted, (len(s), step), s, contact.ends, N, b.t.active, kept, b.t.wanted, step, stale, count
    )  # fmt: skip
    return stale, count
