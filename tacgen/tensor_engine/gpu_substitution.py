"""Substitutions with the factors of fronts on a GPU, by Triton: what a product needs is read where it is.

In plain operations these are multifrontal.forward and backward. Imported only where there is a GPU.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import triton
import triton.language as tl
from torch import Tensor

if TYPE_CHECKING:
    from tacgen.tensor_engine.fronts import FrontGroup, Panel

RESULT_ROWS, SUM_LENGTH = 32, 64  # numbers of a result that a program computes, and of a sum that it adds at once
UNSPECIALIZED_SUBSTITUTION = ("t", "rows", "w", "m", "nodes", "size", "slot", "to", "length")


@triton.jit
def _at_nodes(X, NODES, number, there, nodes):
    """Numbers of vectors at nodes, 0 where padded."""
    node = tl.load(NODES + number // 3, mask=there, other=nodes)
    return tl.load(X + 3 * node + number % 3, mask=node < nodes, other=0.0)


@triton.jit
def _carried(BELOW, PLACES, CHILDREN, number, there, n, ARITY: tl.constexpr):
    """Sums at some numbers of a front, of the children's updates."""
    out = tl.zeros(number.shape, tl.float32)
    for c in tl.static_range(ARITY):
        place = tl.load(PLACES + c * n + number // 3, mask=there, other=-1)
        at = 3 * (tl.load(CHILDREN + c) + place) + number % 3
        out += tl.load(BELOW + at, mask=place >= 0, other=0.0)
    return out


@triton.jit(do_not_specialize=UNSPECIALIZED_SUBSTITUTION)
def _solved(
    B, BELOW, PLACES, CHILDREN, OWN, INVERSE, SLOTS, Y, t, w, m, nodes, size, slot,
    ARITY: tl.constexpr, SUM: tl.constexpr, ROWS: tl.constexpr, LONG: tl.constexpr,
):  # fmt: skip
    """L^-1 of what is asked for at the own nodes and what the children add, or that sum."""
    which = tl.program_id(0).to(tl.int64)
    scene, front, n = which // t, which % t, (w + m) // 3
    row, each = tl.program_id(1) * ROWS + tl.arange(0, ROWS), tl.arange(0, LONG)
    b, own, below = B + 3 * scene * (nodes + 1), OWN + front * (w // 3), BELOW + 3 * scene * size
    places, children = PLACES + front * ARITY * n, CHILDREN + front * ARITY
    if SUM:
        out = _at_nodes(b, own, row, row < w, nodes) + _carried(below, places, children, row, row < w, n, ARITY)
    else:
        first = INVERSE + tl.load(SLOTS + scene) * slot + front * w * w + row[:, None] * w
        out = tl.zeros((ROWS,), tl.float32)
        for k in tl.range(0, tl.minimum((tl.program_id(1) + 1) * ROWS, w), LONG):
            j = k + each
            M = tl.load(first + j[None, :], mask=(row < w)[:, None] & (j < w)[None, :], other=0.0)
            x = _at_nodes(b, own, j, j < w, nodes) + _carried(below, places, children, j, j < w, n, ARITY)
            out += tl.sum(M * x[None, :], 1)
    node = tl.load(own + row // 3, mask=row < w, other=nodes)
    tl.store(Y + 3 * (scene * (nodes + 1) + node) + row % 3, out, mask=node < nodes)


@triton.jit(do_not_specialize=UNSPECIALIZED_SUBSTITUTION)
def _left(
    BELOW, PLACES, CHILDREN, OWN, PANEL, SLOTS, Y, OUT, t, w, m, nodes, size, slot, to, length,
    ARITY: tl.constexpr, ROWS: tl.constexpr, LONG: tl.constexpr,
):  # fmt: skip
    """Updates of the other unknowns: the children's sums less L y of the own."""
    which = tl.program_id(0).to(tl.int64)
    scene, front, n = which // t, which % t, (w + m) // 3
    row, each = tl.program_id(1) * ROWS + tl.arange(0, ROWS), tl.arange(0, LONG)
    first = PANEL + tl.load(SLOTS + scene) * slot + front * m * w + row[:, None] * w
    out = tl.zeros((ROWS,), tl.float32)
    for k in tl.range(0, w, LONG):
        j = k + each
        M = tl.load(first + j[None, :], mask=(row < m)[:, None] & (j < w)[None, :], other=0.0)
        out += tl.sum(M * _at_nodes(Y + 3 * scene * (nodes + 1), OWN + front * (w // 3), j, j < w, nodes)[None, :], 1)
    carried = _carried(
        BELOW + 3 * scene * size, PLACES + front * ARITY * n, CHILDREN + front * ARITY, w + row, row < m, n, ARITY
    )
    tl.store(OUT + scene * length + to + front * m + row, carried - out, mask=row < m)


@triton.jit(do_not_specialize=UNSPECIALIZED_SUBSTITUTION)
def _turned(
    M, SLOTS, NODES, X, OWN, Y, OUT, t, rows, w, nodes, slot,
    LESS: tl.constexpr, ROWS: tl.constexpr, LONG: tl.constexpr,
):  # fmt: skip
    """At the own nodes of fronts, M^T of X at `rows` numbers of NODES, of Y less that if LESS."""
    which = tl.program_id(0).to(tl.int64)
    scene, front = which // t, which % t
    column, each = tl.program_id(1) * ROWS + tl.arange(0, ROWS), tl.arange(0, LONG)
    first = M + tl.load(SLOTS + scene) * slot + front * rows * w + column[None, :]
    out = tl.zeros((ROWS,), tl.float32)
    start = 0 if LESS else tl.program_id(1) * ROWS  # the inverses are lower triangles
    for k in tl.range(start, rows, LONG):
        j = k + each
        A = tl.load(first + j[:, None] * w, mask=(j < rows)[:, None] & (column < w)[None, :], other=0.0)
        out += tl.sum(
            A * _at_nodes(X + 3 * scene * (nodes + 1), NODES + front * (rows // 3), j, j < rows, nodes)[:, None], 0
        )
    node = tl.load(OWN + front * (w // 3) + column // 3, mask=column < w, other=nodes)
    at = 3 * (scene * (nodes + 1) + node) + column % 3
    if LESS:
        out = tl.load(Y + at, mask=node < nodes, other=0.0) - out
    tl.store(OUT + at, out, mask=node < nodes)


def forward(
    group: FrontGroup, panel: Panel | None, slots: Tensor, b: Tensor, below: Tensor, y: Tensor, updates: Tensor
) -> None:
    """multifrontal.forward."""
    (t, w, m), arity = group.fronts.sizes, group.rows.shape[1]
    sources, nodes = (below, group.fronts.places, group.rows, group.own), b.shape[1] - 1
    inverse = y if panel is None else panel.inverse
    _solved[(len(b) * t, triton.cdiv(w, RESULT_ROWS))](
        b, *sources, inverse, slots, y, t, w, m, nodes, below.shape[1], inverse.stride(0), ARITY=arity,
        SUM=panel is None, ROWS=RESULT_ROWS, LONG=SUM_LENGTH,
    )  # fmt: skip
    if panel is not None and m:
        _left[(len(b) * t, triton.cdiv(m, RESULT_ROWS))](
            *sources, panel.below, slots, y, updates, t, w, m, nodes, below.shape[1], panel.below.stride(0),
            3 * group.row, updates.stride(0), ARITY=arity, ROWS=RESULT_ROWS, LONG=SUM_LENGTH,
        )  # fmt: skip


def backward(group: FrontGroup, panel: Panel, slots: Tensor, y: Tensor, x: Tensor) -> None:
    """multifrontal.backward."""
    (t, w, m), nodes = group.fronts.sizes, y.shape[1] - 1
    grid, sizes = (len(y) * t, triton.cdiv(w, RESULT_ROWS)), {"ROWS": RESULT_ROWS, "LONG": SUM_LENGTH}
    _turned[grid](
        panel.below, slots, group.bound, x, group.own, y, y, t, m, w, nodes, panel.below.stride(0), LESS=True, **sizes
    )
    _turned[grid](
        panel.inverse,
        slots,
        group.own,
        y,
        group.own,
        y,
        x,
        t,
        w,
        w,
        nodes,
        panel.inverse.stride(0),
        LESS=False,
        **sizes,
    )
