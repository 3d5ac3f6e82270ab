"""Rows of many tensors in one launch, the facets of scenes in their own numbers of nodes, and sums over the facets of
each node, by Triton; imported only where there is a GPU.

In plain operations these are indices.gathered, batch.Batch.near and at_condensed, contact_newton.at_nodes, and
reduction.with_points.
"""

import triton
import triton.language as tl
from torch import Tensor

FACET_LANES = 128  # of a program
MATRIX_ROWS_PER_PROGRAM = 16  # of a matrix, of a program
UNSPECIALIZED_FACETS = ("nodes", "facets", "face", "every", "all", "q", "width", "unknowns", "kept", "slot", "row", "k")


def _odd(numbers: list[int]) -> tuple[int, ...]:
    """Numbers for a tuple of a kernel's: Triton has code of its own for 1 and for multiples of 16 there."""
    return tuple(16 * k + 8 for k in numbers)


@triton.jit
def _moved(
    SLOTS, WHICH, sources, results, widths, strides, INTO: tl.constexpr, SOME: tl.constexpr, SIZE: tl.constexpr
):  # fmt: skip
    """Rows of sources at slots to results, or rows of sources INTO results at slots; of SOME slots, which are marked,
    or of all."""
    scene, end = tl.program_id(0).to(tl.int64), 1
    if SOME:
        end = tl.load(WHICH + scene).to(tl.int32)
    slot, k = tl.load(SLOTS + scene), tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    for i in tl.static_range(len(sources)):
        width = widths[i] // 16
        apart, close = slot * (strides[i] // 16) + k, scene * width + k
        inside = k < width * end
        if INTO:
            tl.store(results[i] + apart, tl.load(sources[i] + close, mask=inside), mask=inside)
        else:
            tl.store(results[i] + close, tl.load(sources[i] + apart, mask=inside), mask=inside)


def rows(slots: Tensor, parts: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """Rows at slots (s,) of tensors (capacity, ...), each of whose rows is contiguous."""
    out = tuple(part.new_empty(len(slots), *part.shape[1:]) for part in parts)
    _move(slots, parts, out, False)
    return out


def put(slots: Tensor, results: tuple[Tensor, ...], values: tuple[Tensor, ...], which: Tensor | None = None) -> None:
    """Write values (s, n, ...) to the first n of rows at slots (s,) of tensors (capacity, ...), each of whose rows is
    contiguous, where `which` (s,) is marked or everywhere."""
    _move(slots, tuple(value.contiguous() for value in values), results, True, which)


def _move(
    slots: Tensor, sources: tuple[Tensor, ...], results: tuple[Tensor, ...], into: bool, which: Tensor | None = None
) -> None:
    kept, close = (results, sources) if into else (sources, results)
    widths, strides = [part.shape[1:].numel() for part in close], [part.stride(0) for part in kept]
    if max(widths):
        grid, marked = (len(slots), triton.cdiv(max(widths), FACET_LANES)), slots if which is None else which
        _moved[grid](
            slots, marked, sources, results, _odd(widths), _odd(strides), INTO=into, SOME=which is not None,
            SIZE=FACET_LANES
        )  # fmt: skip


@triton.jit(do_not_specialize=UNSPECIALIZED_FACETS)
def _near(
    SLOTS, FACES, LOCAL, FACETS, AREAS, ANCHOR, CONN, AREA, ANCHORS, ENDS, nodes, facets, face, every, all, q,
    SIZE: tl.constexpr,
):  # fmt: skip
    scene = tl.program_id(0).to(tl.int64)
    slot, k = tl.load(SLOTS + scene), tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    number, inside = k // 4, k < 4 * facets
    facet = tl.load(FACES + slot * face + number, mask=inside, other=-1)
    there = facet >= 0
    node = tl.load(FACETS + 4 * facet + k % 4, mask=there, other=0)
    node = tl.load(LOCAL + slot * all + node, mask=there, other=0)
    tl.store(CONN + 4 * facets * scene + k, node, mask=inside)
    tl.store(ENDS + 4 * (nodes * scene + node) + k % 4, number.to(tl.int64), mask=there)
    inside = k < q * facets
    facet = tl.load(FACES + slot * face + k // q, mask=inside, other=-1)
    there, at, to = facet >= 0, (slot * every + facet) * q + k % q, q * facets * scene + k
    tl.store(AREA + to, tl.load(AREAS + at, mask=there, other=0.0), mask=inside)
    for i in tl.static_range(3):
        tl.store(ANCHORS + 3 * to + i, tl.load(ANCHOR + 3 * at + i, mask=there, other=0.0), mask=inside)


def near(
    slots: Tensor, nodes: int, faces: Tensor, local: Tensor, facets: Tensor, areas: Tensor, anchor: Tensor
) -> tuple[Tensor, ...]:
    """The first facets (s, nodes), as many as nodes at most, of those that are numbered in faces (capacity, m), -1
    where there is none: conn (s, f, 4) in the numbers local (capacity, n) of the nodes of facets (F, 4), areas
    (s, f, q) of those (capacity, F, q), 0 where there is none, and anchors (s, f, q, 3) of those (capacity, F, q, 3);
    and of each node (s, nodes, 4) the facet of which it is a certain corner, -1 if none."""
    s, (every, q), f = len(slots), areas.shape[1:], min(nodes, faces.shape[1])
    conn, ends = local.new_empty(s, f, 4), local.new_full((s, nodes, 4), -1)
    area, anchors = areas.new_empty(s, f, q), areas.new_empty(s, f, q, 3)
    sizes = nodes, f, faces.shape[1], every, local.shape[1], q
    _near[(s, triton.cdiv(f * max(q, 4), FACET_LANES))](
        slots, faces, local, facets, areas, anchor, conn, area, anchors, ends, *sizes, SIZE=FACET_LANES
    )
    return conn, area, anchors, ends


@triton.jit(do_not_specialize=UNSPECIALIZED_FACETS)
def _at_condensed(SLOTS, NODES, X, OUT, nodes, every, all, SIZE: tl.constexpr):
    scene = tl.program_id(0).to(tl.int64)
    slot, k = tl.load(SLOTS + scene), tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    inside = k < 3 * nodes
    node = tl.load(NODES + slot * every + k // 3, mask=inside, other=-1)
    value = tl.load(X + 3 * (slot * all + node) + k % 3, mask=node >= 0, other=0.0)
    tl.store(OUT + 3 * nodes * scene + k, value, mask=inside)


def at_condensed(slots: Tensor, x: Tensor, numbers: Tensor, nodes: int) -> Tensor:
    """Rows (s, nodes, 3) of x (capacity, n, 3) at the nodes in numbers (capacity, m), 0 where these are -1."""
    out = x.new_empty(len(slots), nodes, 3)
    sizes = nodes, numbers.shape[1], x.shape[1]
    _at_condensed[(len(slots), triton.cdiv(3 * nodes, FACET_LANES))](slots, numbers, x, out, *sizes, SIZE=FACET_LANES)
    return out


@triton.jit(do_not_specialize=UNSPECIALIZED_FACETS)
def _at_nodes(ENDS, N, FORCE, OUT, nodes, facets, width, Q: tl.constexpr, SIZE: tl.constexpr):
    scene = tl.program_id(0).to(tl.int64)
    k = tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    inside = k < width * nodes
    total = tl.zeros((SIZE,), OUT.dtype.element_ty)
    for corner in tl.static_range(4):
        facet = tl.load(ENDS + 4 * (nodes * scene + k // width) + corner, mask=inside, other=-1)
        for point in tl.static_range(Q):
            at = ((scene * facets + facet) * Q + point) * width + k % width
            total += tl.load(N + 4 * point + corner) * tl.load(FORCE + at, mask=facet >= 0, other=0.0)
    tl.store(OUT + width * nodes * scene + k, total, mask=inside)


def at_nodes(ends: Tensor, N: Tensor, force: Tensor) -> Tensor:
    """Sums (s, m, c) of forces (s, f, q, c) at points with shape functions N (q, 4); ends (s, m, 4): the facet of which
    a node is a certain corner, -1 if none."""
    (s, nodes, _), (_, f, q, c) = ends.shape, force.shape
    out = force.new_empty(s, nodes, c)
    grid = s, triton.cdiv(c * nodes, FACET_LANES)
    _at_nodes[grid](ends, N, force.contiguous(), out, nodes, f, c, Q=q, SIZE=FACET_LANES)
    return out


@triton.jit(do_not_specialize=UNSPECIALIZED_FACETS)
def _acted(
    SLOTS, ENDS, N, ACTIVE, KEPT, WANTED, STALE, COUNT, nodes, facets, row, Q: tl.constexpr, SIZE: tl.constexpr
):  # fmt: skip
    scene, lane = tl.program_id(0).to(tl.int64), tl.arange(0, SIZE)
    slot, none = tl.load(SLOTS + scene), tl.load(KEPT + scene) == 0
    count, more, i = tl.zeros((SIZE,), tl.int32), tl.zeros((SIZE,), tl.int32), 0
    while i < row:
        k = i + lane
        inside, new = k < 3 * nodes, k < 0
        for corner in tl.static_range(4):
            facet = tl.load(ENDS + 4 * (nodes * scene + k // 3) + corner, mask=inside, other=-1)
            for point in tl.static_range(Q):
                at = (scene * facets + facet) * Q + point
                new = new | (tl.load(N + at, mask=facet >= 0, other=0.0) > 0)
        active = tl.load(ACTIVE + slot * row + k, mask=inside, other=0) != 0
        more = tl.where(new & ~active, 1, more)
        wanted = new | (active & (tl.load(KEPT + scene + 0 * lane) > 0))
        count += tl.where(wanted, 1, 0)
        tl.store(WANTED + slot * row + k, wanted, mask=k < row)
        i += SIZE
    tl.store(STALE + scene, none | (tl.max(more, 0) > 0))
    tl.store(COUNT + scene, tl.sum(count, 0))


def acted(
    slots: Tensor, ends: Tensor, N: Tensor, active: Tensor, kept: Tensor, wanted: Tensor
) -> tuple[Tensor, Tensor]:
    """condensation.acted, for forces N (s, f, q) at the points of facets; active and wanted (capacity, k): all rows."""
    (s, nodes, _), (_, f, q) = ends.shape, N.shape
    stale, count = wanted.new_empty(s), ends.new_empty(s)
    sizes = nodes, f, active.shape[1]
    _acted[(s,)](slots, ends, N, active, kept, wanted, stale, count, *sizes, Q=q, SIZE=4 * FACET_LANES, num_warps=16)
    return stale, count


@triton.jit
def _stiffness(c, own, beside, scene, PLACE, CONN, ENDS, N, D, OUT, unknowns, facets, Q: tl.constexpr):
    """For rows of unknowns `own` the columns and what is added there by facets of which their nodes are corner c; and
    whether anything is."""
    node, own_direction, corner, direction = own // 3, own % 3, beside // 4, beside % 4
    facet = tl.load(ENDS + 4 * (unknowns // 3 * scene + node) + c, mask=own >= 0, other=-1)
    there = (facet >= 0) & (direction < 3)
    other = tl.load(CONN + 4 * (scene * facets + facet) + corner, mask=there, other=0)
    column = tl.load(PLACE + scene * unknowns + 3 * other + direction, mask=there, other=-1)
    acts = there & (column >= 0)
    part = (0 * column).to(OUT.dtype.element_ty)
    for point in tl.static_range(Q):
        share = tl.load(N + 4 * point + c).to(part.dtype) * tl.load(N + 4 * point + corner).to(part.dtype)
        at = D + 9 * ((scene * facets + facet) * Q + point) + 3 * own_direction + direction
        part += share * tl.load(at, mask=acts, other=0.0).to(part.dtype)
    return column, part, acts


@triton.jit
def _add(out, column, part, acts):
    tl.debug_barrier()  # rows are written and read by all threads of a program
    tl.store(out + column, tl.load(out + column, mask=acts, other=0.0) + part, mask=acts)


@triton.jit(do_not_specialize=UNSPECIALIZED_FACETS)
def _with_points(
    SLOTS, KEPT, PLACE, CONN, ENDS, N, D, K, OUT, kept, unknowns, facets, slot, row,
    Q: tl.constexpr, HIGH: tl.constexpr, SIZE: tl.constexpr,
):  # fmt: skip
    scene = tl.program_id(0).to(tl.int64)
    r = (tl.program_id(1) * HIGH + tl.arange(0, HIGH))[:, None]
    inside, out = r < kept, OUT + (scene * kept + r) * kept
    source = K + tl.load(SLOTS + scene) * slot + r.to(tl.int64) * row
    own = tl.load(KEPT + scene * kept + r, mask=inside, other=-1)
    beside = tl.arange(0, 16)[None, :]  # 4 corner + direction of a column
    i0, a0, there0 = _stiffness(0, own, beside, scene, PLACE, CONN, ENDS, N, D, OUT, unknowns, facets, Q)
    i1, a1, there1 = _stiffness(1, own, beside, scene, PLACE, CONN, ENDS, N, D, OUT, unknowns, facets, Q)
    i2, a2, there2 = _stiffness(2, own, beside, scene, PLACE, CONN, ENDS, N, D, OUT, unknowns, facets, Q)
    i3, a3, there3 = _stiffness(3, own, beside, scene, PLACE, CONN, ENDS, N, D, OUT, unknowns, facets, Q)
    k = 0
    while k < kept:
        j = (k + tl.arange(0, SIZE))[None, :]
        tl.store(out + j, tl.load(source + j, mask=inside & (j < kept), other=0.0), mask=inside & (j < kept))
        k += SIZE
    _add(out, i0, a0, there0)
    _add(out, i1, a1, there1)
    _add(out, i2, a2, there2)
    _add(out, i3, a3, there3)


def with_points(
    K: Tensor, slots: Tensor, kept: Tensor, place: Tensor, conn: Tensor, ends: Tensor, N: Tensor, D: Tensor
) -> Tensor:
    """reduction.with_points; the columns of K are next to each other."""
    (s, f, q), a = D.shape[:3], kept.shape[1]
    out = K.new_empty(s, a, a)
    parts = slots, kept.contiguous(), place.contiguous(), conn, ends, N, D.contiguous(), K, out
    if a:
        sizes = a, place.shape[1], f, K.stride(0), K.stride(1)
        _with_points[(s, triton.cdiv(a, MATRIX_ROWS_PER_PROGRAM))](
            *parts, *sizes, Q=q, HIGH=MATRIX_ROWS_PER_PROGRAM, SIZE=FACET_LANES
        )
    return out
