"""Decisions of a step of the contact, scene by scene, as Warp kernels of batches.

Where there is a `step`, so many threads do one scene, and add what each has found: a block of threads on a GPU, one on
a core. Arrays have the scene first; nodes' vectors are rows (s, 3n).
"""

from typing import Any

import warp as wp

from tacgen.physics import decisions
from tacgen.physics.decisions import (
    ARMIJO_DECREASE,
    MAX_FULL_STEP_RESIDUAL_RATIO,
    MERIT_ROUNDING,
    MIN_LINE_SEARCH_FRACTION,
    ContactStatus,
)
from tacgen.physics.types import Flags, Ints3, Longs, Longs2, Reals, Reals2, Reals3, in_precisions, real

SMALLEST = wp.constant(real(1e-300))  # so that nothing is divided by 0
FULL, ROUNDING = wp.constant(real(MAX_FULL_STEP_RESIDUAL_RATIO)), wp.constant(real(MERIT_ROUNDING))
DECREASE, STALLED = wp.constant(real(ARMIJO_DECREASE)), wp.constant(real(MIN_LINE_SEARCH_FRACTION))
shrinks, free_part = wp.func(decisions.shrinks), wp.func(decisions.free_part)
armijo, after_step = wp.func(decisions.armijo), wp.func(decisions.after_step)


@wp.func
def summed(part: real) -> real:
    """The sum over the threads of a scene, in a fixed order."""
    return wp.tile_extract(wp.tile_sum(wp.tile(part)), 0)


@wp.func
def largest(part: real) -> real:
    return wp.tile_extract(wp.tile_max(wp.tile(part)), 0)


@wp.kernel(enable_backward=False, module="tacgen.batches")
def shrunk(length: Reals, dhat: Reals, gap: Reals, offset: Reals, drift: Reals, offsets: Reals, off: Reals):
    """Offsets (s,) of indenters that are shrunk by the mean gap or stay, and by how much it was off."""
    s = wp.tid()
    now = shrinks(length[s], dhat[s], gap[s])
    offsets[s] = wp.where(now, gap[s], offset[s])
    off[s] = wp.where(now, gap[s] - offset[s], drift[s])


@wp.kernel(enable_backward=False, module="tacgen.batches")
def picked(b: wp.array2d(dtype=Any), at: Longs2, less: wp.array2d(dtype=Any), out: wp.array2d(dtype=Any)):
    """b (s, k) at the unknowns (s, a), 0 where -1, less what is given (s, a), if it has rows."""
    s, k = wp.tid()
    value = b.dtype(0.0)
    if at[s, k] >= wp.int64(0):
        value = b[s, int(at[s, k])] + b.dtype(0.0)
    if less.shape[0] > 0:
        value = value - less[s, k]
    out[s, k] = value


@wp.func
def placed(G: wp.array2d(dtype=Any), X: wp.array2d(dtype=Any), some: wp.array2d(dtype=Any), s: int, place: int) -> real:
    """The solution at an unknown of this place."""
    if place >= 0:
        return real(some[s, place])
    if -1 - place < G.shape[1]:
        return real(G[s, -1 - place] - X[s, -1 - place])
    return real(0.0)


@wp.kernel(enable_backward=False, module="tacgen.batches")
def joined(
    G: wp.array2d(dtype=Any), X: wp.array2d(dtype=Any), some: wp.array2d(dtype=Any), place: Longs2, good: Flags,
    step: int, out: Reals2, exists: Flags,
):  # fmt: skip
    """At each unknown with its place (s, k) of `some` (s, a), or what of G - X (s, e) belongs to it, see
    tensor_engine.reduction.Reduction; 0 where not good (s,) or not finite, and which are good."""
    s, lane = wp.tid()
    bad = real(0.0)
    k = int(lane)
    while k < out.shape[1]:
        if not wp.isfinite(placed(G, X, some, s, int(place[s, k]))):
            bad = real(1.0)
        k += step
    fine = largest(bad) == real(0.0) and good[s]
    if lane == 0:
        exists[s] = fine
    k = int(lane)
    while k < out.shape[1]:
        value = real(0.0)
        if fine:
            value = placed(G, X, some, s, int(place[s, k]))
        out[s, k] = value
        k += step


@wp.kernel(enable_backward=False, module="tacgen.batches")
def exact(b: wp.array2d(dtype=Any), product: wp.array2d(dtype=Any), limit: real, step: int, good: Flags):
    """Whether b (s, a) and a product differ by at most `limit` times the largest of b (s,)."""
    s, lane = wp.tid()
    most, off = real(0.0), real(0.0)
    k = int(lane)
    while k < b.shape[1]:
        less = wp.abs(real(b[s, k]) - real(product[s, k]))
        most = wp.max(most, wp.abs(real(b[s, k])))
        if not wp.isfinite(less):  # nor is it small if it is no number
            less = real(wp.inf)
        off = wp.max(off, less)
        k += step
    most, off = largest(most), largest(off)
    if lane == 0:
        good[s] = off <= limit * most and off < real(wp.inf)


@wp.kernel(enable_backward=False, module="tacgen.batches")
def tried(
    x: Reals2, start: Reals2, load: Reals2, gradient: Reals2, g: Reals2, p: Reals2, bent: Reals2, whole: Reals2,
    exists: Flags, conn: Ints3, N: Reals2, gap: Reals3, reach: Reals, halves: Reals, step: int, fractions: Reals2,
    figures: Reals2,
):  # fmt: skip
    """See tensor_engine.contact_newton.tried; `whole` without rows: it does not matter."""
    s, lane = wp.tid()
    energy, linear, square, slope = real(0.0), real(0.0), real(0.0), real(0.0)
    longest, before, after, first = real(0.0), real(0.0), real(0.0), real(1.0)
    k = int(lane)
    while k < x.shape[1]:
        energy += (x[s, k] - start[s, k]) * (gradient[s, k] + load[s, k])
        linear += gradient[s, k] * p[s, k]
        square += p[s, k] * bent[s, k]
        slope += g[s, k] * p[s, k]
        longest = wp.max(longest, wp.abs(p[s, k]))
        if whole.shape[0] > 0:
            before += g[s, k] * g[s, k]
            after += whole[s, k] * whole[s, k]
        k += step
    k = int(lane)
    while k < gap.shape[1] * gap.shape[2]:
        f, q = k / gap.shape[2], k % gap.shape[2]
        way = wp.vec3d()
        for a in range(conn.shape[2]):
            node = 3 * conn[s, f, a]
            way += N[q, a] * wp.vec3d(p[s, node], p[s, node + 1], p[s, node + 2])
        first = wp.min(first, free_part(gap[s, f, q], reach[s], wp.length(way), SMALLEST))
        k += step
    energy, linear, square, slope = summed(energy), summed(linear), summed(square), summed(slope)
    longest, before, after, first = largest(longest), summed(before), summed(after), -largest(-first)
    full = exists[s] and first >= real(1.0) and whole.shape[0] > 0 and wp.sqrt(after) <= FULL * wp.sqrt(before)
    if lane == 0:
        figures[s, 0] = energy / real(2.0)
        figures[s, 1] = linear
        figures[s, 2] = square
        figures[s, 3] = wp.where(exists[s], slope, real(wp.inf))
        figures[s, 4] = longest
        figures[s, 5] = wp.where(full, real(1.0), real(0.0))
        for j in range(halves.shape[0]):
            fractions[s, j] = first * halves[j]


@wp.kernel(enable_backward=False, module="tacgen.batches")
def downhill(fractions: Reals2, figures: Reals2, merits: Reals2, least: real, out: Reals):
    """See tensor_engine.contact_newton.downhill."""
    s = wp.tid()
    linear, square, slope = figures[s, 1], figures[s, 2], figures[s, 3]
    here, found = figures[s, 0] + merits[s, 0], real(0.0)  # the first fraction is 0
    for j in range(fractions.shape[1]):
        fraction = fractions[s, j]
        merit = figures[s, 0] + fraction * linear + fraction * fraction * square / real(2.0) + merits[s, j]
        low = slope <= real(0.0) and armijo(merit, here, fraction * slope, ROUNDING, DECREASE)
        if found == real(0.0) and fraction >= least and low:
            found = fraction
    out[s] = wp.where(figures[s, 5] > real(0.0), real(1.0), found)


@wp.kernel(enable_backward=False, module="tacgen.batches")
def ended(
    x: Reals2, there: Reals2, start: Reals2, fraction: Reals, figures: Reals2, N: Reals2, gaps: Reals2, radius: Reals,
    xtol: Reals, before: Reals, offset: Reals, length: Reals, old_drift: Reals, drift: Reals, old_gap: Reals,
    steps: Longs, most: int, symmetric: bool, step: int, out: Reals2, offsets: Reals, counted: Longs, lengths: Reals,
    drifts: Reals, mean: Reals, status: Longs,
):  # fmt: skip
    """See tensor_engine.contact_newton.ended."""
    s, lane = wp.tid()
    force, weighted, farthest, part = real(0.0), real(0.0), real(0.0), real(wp.inf)
    k = int(lane)
    while k < N.shape[1]:
        force += N[s, k]
        weighted += N[s, k] * gaps[s, k]
        k += step
    k = int(lane)
    while k < x.shape[1]:
        away, way = x[s, k] - start[s, k], there[s, k] - x[s, k]
        farthest = wp.max(farthest, wp.abs(there[s, k] - start[s, k]))
        if way != real(0.0):  # to where the first entry reaches the radius
            part = wp.min(part, (radius[s] - wp.sign(way) * away) / wp.max(wp.abs(way), SMALLEST))
        k += step
    force, weighted, farthest, part = summed(force), summed(weighted), largest(farthest), -largest(-part)
    gone = farthest > radius[s]
    part = wp.where(part < real(wp.inf), wp.max(part, real(0.0)), real(0.0))  # nothing moves
    longest, going, stuck = figures[s, 4], steps[s] < wp.int64(most), fraction[s] == real(0.0)
    waits, moves, gap = going and stuck and not symmetric, going and not stuck, weighted / force
    how = after_step(
        fraction[s] == real(1.0), fraction[s], longest, drift[s], wp.abs(gap - offset[s]), xtol[s], STALLED
    )
    if stuck or gone:
        how = ContactStatus.unstable
    if not going:
        how = ContactStatus.circling
    if waits:
        how = ContactStatus.searching
    if lane == 0:
        offsets[s] = wp.where(waits, before[s], offset[s])
        counted[s] = wp.where(going and not waits, steps[s] + wp.int64(1), steps[s] + wp.int64(0))
        lengths[s] = wp.where(moves and not gone, longest, length[s])
        drifts[s] = wp.where(waits, old_drift[s], drift[s])
        mean[s] = wp.where(waits, old_gap[s], gap)
        status[s] = wp.int64(how)
    k = int(lane)
    while k < x.shape[1]:
        value = x[s, k] + real(0.0)
        if moves:
            value = wp.where(gone, x[s, k] + part * (there[s, k] - x[s, k]), there[s, k])
        out[s, k] = value
        k += step


PICKED = in_precisions(picked, ("b", "less", "out"))
JOINED = in_precisions(joined, ("G", "X", "some"))
EXACT = in_precisions(exact, ("b", "product"))
