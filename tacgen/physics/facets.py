"""Rows of many scenes in slots, the facets of scenes in their own numbers of nodes, and sums over the facets of a node.

As Warp kernels of batches. slots (s,) are the rows of the scenes of a call in arrays (capacity, ...). `ends` (s, n, 4):
the facet of which a node is a certain corner, -1 if none; on a grid there is one at most, so that sums repeat.
"""

from typing import Any

import warp as wp

from tacgen.physics.types import (
    Flags,
    Flags2,
    Ints3,
    Longs,
    Longs2,
    Reals,
    Reals2,
    Reals3,
    Reals4,
    Vectors2,
    Vectors3,
    in_precisions,
    real,
)

MAX_MOVED_ARRAYS = wp.constant(12)  # in one launch
Numbers = wp.types.vector(length=MAX_MOVED_ARRAYS, dtype=wp.uint64)  # of each array


@wp.kernel(enable_backward=False, module="tacgen.batches")
def moved(
    slots: Longs, which: Flags, into: bool, rows: Numbers, values: Numbers, apart: Numbers, widths: Numbers,
    sizes: Numbers,
):  # fmt: skip
    """Copy the rows at slots to values or, `into` them, the values where they are marked in `which` (s,) or everywhere.

    rows, values: the addresses of arrays; of each, `apart`: bytes from one row to the next, and how many numbers a row
    of values has, 0 where there is no array, and of how many bytes each. A thread for each number of all arrays.
    """
    s, k = wp.tid()
    slot, marked = wp.uint64(slots[s]), bool(True)
    if which.shape[0] > 0:
        marked = which[s]
    before, number = int(0), int(-1)
    here, there, size = wp.uint64(0), wp.uint64(0), wp.uint64(0)
    for i in range(MAX_MOVED_ARRAYS):  # of constant length, so that a GPU holds addresses in registers
        after = before + int(widths[i])
        own = k >= before and k < after
        number, size = wp.where(own, k - before, number), wp.where(own, sizes[i], size)
        here = wp.where(own, rows[i] + slot * apart[i], here)
        there = wp.where(own, values[i] + wp.uint64(s) * widths[i] * sizes[i], there)
        before = after
    if not marked:
        return
    if into:
        here, there = there, here
    at = wp.uint64(number) * size
    if size == wp.uint64(8):
        long = wp.array(ptr=there + at, shape=(1,), dtype=wp.int64)
        long[0] = wp.array(ptr=here + at, shape=(1,), dtype=wp.int64)[0]
    elif size == wp.uint64(4):
        short = wp.array(ptr=there + at, shape=(1,), dtype=wp.int32)
        short[0] = wp.array(ptr=here + at, shape=(1,), dtype=wp.int32)[0]
    else:
        byte = wp.array(ptr=there + at, shape=(1,), dtype=wp.int8)
        byte[0] = wp.array(ptr=here + at, shape=(1,), dtype=wp.int8)[0]


@wp.kernel(enable_backward=False, module="tacgen.batches")
def near(
    slots: Longs, faces: Longs2, local: Longs2, facets: Longs2, areas: Reals3, anchor: Vectors3, conn: Ints3,
    area: Reals3, anchors: Vectors3, ends: Ints3,
):  # fmt: skip
    """For the facets that are numbered in faces (capacity, m), -1 where there is none: conn (s, f, 4) in the numbers
    local (capacity, n) of the nodes of facets (F, 4); areas (s, f, q) of those (capacity, F, q), 0 where there is none;
    anchors (s, f, q); and `ends`, which is -1 before."""
    s, f, k = wp.tid()
    slot = slots[s]
    facet = faces[slot, f]
    if k < 4:
        node = wp.int64(0)
        if facet >= wp.int64(0):
            node = local[slot, facets[facet, k]]
            ends[s, node, k] = f
        conn[s, f, k] = wp.int32(node)
    if k < areas.shape[2]:
        size, at = real(0.0), wp.vec3d()
        if facet >= wp.int64(0):
            size = areas[slot, facet, k]
            at = anchor[slot, facet, k]
        area[s, f, k] = size
        anchors[s, f, k] = at


@wp.kernel(enable_backward=False, module="tacgen.batches")
def at_condensed(slots: Longs, x: Vectors2, numbers: Longs2, out: Vectors2):
    """Rows (s, m) of x (capacity, n) at the first nodes in numbers (capacity, m), 0 where these are -1."""
    s, m = wp.tid()
    slot, value = slots[s], wp.vec3d()
    if numbers[slot, m] >= wp.int64(0):
        value = x[slot, numbers[slot, m]]
    out[s, m] = value


@wp.kernel(enable_backward=False, module="tacgen.batches")
def at_nodes(ends: Ints3, N: Reals2, forces: Vectors3, out: Vectors2):
    """Sums (s, n) of forces (s, f, q) at points with shape functions N (q, 4)."""
    s, n = wp.tid()
    total = wp.vec3d()
    for corner in range(4):
        facet = ends[s, n, corner]
        if facet >= 0:
            for q in range(N.shape[0]):
                total += N[q, corner] * forces[s, facet, q]
    out[s, n] = total


@wp.kernel(enable_backward=False, module="tacgen.batches")
def acted(
    slots: Longs, ends: Ints3, N: Reals3, active: Flags2, kept: Reals, wanted: Flags2, step: int, stale: Flags,
    count: Longs,
):  # fmt: skip
    """See tensor_engine.condensation.acted; `step` threads a scene."""
    s, lane = wp.tid()
    slot, reduced = slots[s], kept[s] > real(0.0)
    found, more = int(0), int(0)
    k = int(lane)
    while k < wanted.shape[1]:
        new, old = bool(False), bool(False)
        if k < 3 * ends.shape[1]:
            for corner in range(4):
                facet = ends[s, k / 3, corner]
                if facet >= 0:
                    for q in range(N.shape[2]):
                        new = new or N[s, facet, q] > real(0.0)
            old = active[slot, k]
        if new and not old:
            more = 1
        wants = new or (old and reduced)
        if wants:
            found += 1
        wanted[slot, k] = wants
        k += step
    total = wp.tile_extract(wp.tile_sum(wp.tile(found)), 0)
    grown = wp.tile_extract(wp.tile_max(wp.tile(more)), 0)
    if lane == 0:
        stale[s] = grown > 0 or not reduced
        count[s] = wp.int64(total)


@wp.kernel(enable_backward=False, module="tacgen.batches")
def with_points(
    K: wp.array3d(dtype=Any), slots: Longs, kept: Longs2, place: Longs2, conn: Ints3, ends: Ints3, N: Reals2, D: Reals4,
    step: int, out: wp.array3d(dtype=Any),
):  # fmt: skip
    """See tensor_engine.reduction.with_points; D (s, f, q, 9). `step` threads a row, each of some columns."""
    s, r, lane = wp.tid()
    slot = slots[s]
    j = int(lane)
    while j < out.shape[2]:
        out[s, r, j] = K[slot, r, j]
        j += step
    own = int(kept[s, r])
    if own < 0:
        return
    for corner in range(4):
        facet = ends[s, own / 3, corner]
        if facet >= 0:
            for other in range(4):
                for i in range(3):
                    column = int(place[s, 3 * conn[s, facet, other] + i])
                    if column >= 0 and column % step == lane:
                        total = real(0.0)
                        for q in range(N.shape[0]):
                            total += N[q, corner] * N[q, other] * D[s, facet, q, 3 * (own % 3) + i]
                        out[s, r, column] = out[s, r, column] + out.dtype(total)


WITH_POINTS = in_precisions(with_points, ("K", "out"))  # by the bytes of a number of K
