"""Fronts of many matrices on a GPU, by Triton: a number of a front is read where it comes from, and written once.

Products are PyTorch's: cuBLAS takes less than half of the time of tl.dot for numbers of single precision, on an H100.
In plain operations these are multifrontal.assembled and multifrontal.eliminate. Imported only where there is a GPU.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import triton
import triton.language as tl
from torch import Tensor

from tacgen.tensor_engine.dense import invert_factor, squared, times_transposed

if TYPE_CHECKING:
    from tacgen.tensor_engine.fronts import Fronts, Panel

# no code of its own for each value of these
UNSPECIALIZED_FRONT_COUNTS = ("pairs", "size", "numbers", "apart", "t", "w", "m", "n")
UNSPECIALIZED_FRONTS = (*UNSPECIALIZED_FRONT_COUNTS, "length", "beyond", "slot", "row", "to_slot", "to_row")


@triton.jit(do_not_specialize=UNSPECIALIZED_FRONTS)
def _entries(ELEMENTS, PARTS, DIAGONAL, OUT, pairs, size, MANY: tl.constexpr):
    scene, pair = tl.program_id(1).to(tl.int64), tl.program_id(0) * MANY + tl.arange(0, MANY)
    n = tl.arange(0, 16)
    inside = (pair < pairs)[:, None] & (n < 9)[None, :]
    out = tl.zeros((MANY, 16), tl.float32)
    for k in range(8):
        part = tl.load(PARTS + 8 * pair + k, mask=pair < pairs, other=-1)[:, None]
        number = part + (24 * (n // 3) + n % 3)[None, :]
        out += tl.load(ELEMENTS + scene * size + number, mask=inside & (part >= 0), other=0.0)
    void = (tl.max(tl.abs(out), 1) == 0) & tl.load(DIAGONAL + pair, mask=pair < pairs, other=0).to(tl.int1)
    out = tl.where(void[:, None] & (n % 4 == 0)[None, :], 1.0, out)
    all_of_them = (pair <= pairs)[:, None] & (n < 9)[None, :]  # the last one is 0
    tl.store(OUT + scene * 9 * (pairs + 1) + 9 * pair[:, None] + n[None, :], out, mask=all_of_them)


@triton.jit
def _summed(BELOW, PLACES, FIRST, LENGTH, front, n, row, column, ARITY: tl.constexpr):
    """Numbers of fronts of n nodes at rows and columns, of which the later is read as the row: sums of the children's
    updates, and the unit matrix where nodes are padding."""
    i, j = tl.maximum(row[:, None], column[None, :]), tl.minimum(row[:, None], column[None, :])
    PLACES += front * n * (ARITY if ARITY else 1)
    padding = tl.load(PLACES + row // 3, mask=row < 3 * n, other=-1) == -2
    out = tl.where((i == j) & padding[:, None], 1.0, 0.0)
    for c in tl.static_range(ARITY):
        places = PLACES + c * n
        down = tl.load(places + row // 3, mask=row < 3 * n, other=-1)
        along = tl.load(places + column // 3, mask=column < 3 * n, other=-1)
        inside = (down >= 0)[:, None] & (along >= 0)[None, :]
        down, along = (3 * down + row % 3)[:, None], (3 * along + column % 3)[None, :]
        first, length = tl.load(FIRST + front * ARITY + c), tl.load(LENGTH + front * ARITY + c)
        at = first + tl.maximum(down, along) * length + tl.minimum(down, along)
        out += tl.load(BELOW + at, mask=inside, other=0.0)
    return out


@triton.jit(do_not_specialize=UNSPECIALIZED_FRONTS)
def _assembled(
    DATA, BELOW, PLACES, FIRST, LENGTH, MAP, OUT, numbers, size, apart, t, w, n,
    ARITY: tl.constexpr, ENTRIES: tl.constexpr, WHOLE: tl.constexpr, ROWS: tl.constexpr, COLUMNS: tl.constexpr,
):  # fmt: skip
    which = tl.program_id(0).to(tl.int64)
    scene, front = which // t, which % t
    row = tl.program_id(1) * ROWS + tl.arange(0, ROWS)
    column = tl.program_id(2) * COLUMNS + tl.arange(0, COLUMNS)
    if WHOLE or (tl.program_id(1) + 1) * ROWS > tl.program_id(2) * COLUMNS:
        sources = BELOW + scene * size, PLACES + scene * apart, FIRST, LENGTH
        out = _summed(*sources, front, n, row, column, ARITY)
        inside = (row < 3 * n)[:, None] & (column < 3 * w)[None, :]
        if ENTRIES:
            i, j = tl.maximum(row[:, None], column[None, :]), tl.minimum(row[:, None], column[None, :])
            number = tl.load(MAP + (front * n + i // 3) * w + j // 3, mask=inside & (j < 3 * w), other=-1)
            number = tl.where(number < 0, numbers, 9 * number + 3 * (i % 3) + j % 3)
            out += tl.load(DATA + scene * numbers + number, mask=number < numbers, other=0.0)
        tl.store(OUT + (which * 3 * n + row[:, None]) * 3 * w + column[None, :], out, mask=inside)


@triton.jit(do_not_specialize=UNSPECIALIZED_FRONTS)
def _kept(
    COLUMNS, L, SLOTS, INVERSE, BELOW, t, w, m, n, length, beyond, slot, row, to_slot, to_row,
    ROWS: tl.constexpr, COLS: tl.constexpr,
):  # fmt: skip
    """The factors to where they are kept: inverses (w, w) as (n, length), and the blocks below (m, w) as
    (beyond, length)."""
    which, tile = tl.program_id(0).to(tl.int64), tl.program_id(1)
    kept, front = tl.load(SLOTS + which // t), which % t
    column, first = tl.program_id(2) * COLS + tl.arange(0, COLS)[None, :], tl.cdiv(n, ROWS)
    if tile < first:
        i = tile * ROWS + tl.arange(0, ROWS)[:, None]
        inside = (i < w) & (column < w)
        out = tl.load(COLUMNS + which * (w + m) * w + i * w + column, mask=inside, other=0.0)
        at = INVERSE + kept * slot + front * n * row + i * row + column
        tl.store(at, out, mask=(i < n) & (column < length))
    else:
        i = (tile - first) * ROWS + tl.arange(0, ROWS)[:, None]
        out = tl.load(L + which * m * w + i * w + column, mask=(i < m) & (column < w), other=0.0)
        at = BELOW + kept * to_slot + front * beyond * to_row + i * to_row + column
        tl.store(at, out, mask=(i < beyond) & (column < length))


@triton.jit(do_not_specialize=UNSPECIALIZED_FRONTS)
def _left(
    BELOW, PLACES, FIRST, LENGTH, SQUARES, OUT, size, apart, t, w, m, n, length,
    ARITY: tl.constexpr, WHOLE: tl.constexpr, ROWS: tl.constexpr, COLS: tl.constexpr,
):  # fmt: skip
    """Updates (m, m) of the other rows: the children's sums less the squares (m, m)."""
    i, j = tl.program_id(1) * ROWS + tl.arange(0, ROWS), tl.program_id(2) * COLS + tl.arange(0, COLS)
    if tl.program_id(2) * COLS < (tl.program_id(1) + 1) * ROWS:
        which = tl.program_id(0).to(tl.int64)
        scene, front = which // t, which % t
        sources = BELOW + scene * size, PLACES + scene * apart, FIRST, LENGTH
        out = _summed(*sources, front, n, w + i, w + j, ARITY)
        lower = (i < m)[:, None] & (j[None, :] <= i[:, None])
        out -= tl.load(SQUARES + (which * m + i[:, None]) * m + j[None, :], mask=lower, other=0.0)
        to = OUT + scene * length + front * m * m
        tl.store(to + i[:, None] * m + j[None, :], out, mask=lower)
        if WHOLE:
            tl.store(to + i[:, None] + j[None, :] * m, out, mask=lower)


def entries(elements: Tensor, parts: Tensor, diagonal: Tensor) -> Tensor:
    """Multifrontal.assembled of contiguous element tangents, with the parts (pairs, 8) of each entry."""
    pairs, many = len(parts), 32
    out = elements.new_empty(len(elements), pairs + 1, 9)
    _entries[(triton.cdiv(pairs + 1, many), len(elements))](
        elements.contiguous(), parts, diagonal, out, pairs, elements[0].numel(), MANY=many
    )
    return out


def _sources(fronts: Fronts, below: Tensor) -> tuple[tuple[Tensor, ...], int]:
    """Maps and numbers that `_summed` reads, and how far apart the places of two matrices are."""
    places = fronts.places
    return (below, places, fronts.first, fronts.length), 0 if len(places) == 1 else places.stride(0)


def assembled(fronts: Fronts, data: Tensor, below: Tensor) -> Tensor:
    """multifrontal.assembled."""
    (t, w, m), n, arity = fronts.sizes, fronts.places.shape[3], fronts.first.shape[1]
    batch, ((at, *sources), apart) = len(data), _sources(fronts, below)
    out, whole = data.new_empty(batch, t, w + m, w), not m
    grid = batch * t, triton.cdiv(w + m, 32), triton.cdiv(w, 64)
    _assembled[grid](
        data, at, *sources, fronts.entries, out, data.shape[1], below.shape[1], apart, t, fronts.w, n, ARITY=arity,
        ENTRIES=fronts.entries is not None, WHOLE=whole, ROWS=32, COLUMNS=64,
    )  # fmt: skip
    return out


def eliminate(
    fronts: Fronts, data: Tensor, below: Tensor, panel: Panel, slots: Tensor, updates: Tensor, whole: bool
) -> Tensor:
    """multifrontal.eliminate."""
    (t, w, m), n, arity = fronts.sizes, fronts.places.shape[3], fronts.first.shape[1]
    batch, columns = len(slots), assembled(fronts, data, below).flatten(0, 1)
    info = invert_factor(columns[:, :w])
    kept, X, beyond = times_transposed(columns[:, w:], columns[:, :w]), panel.inverse, panel.below
    tiles = triton.cdiv(X.shape[2], 32) + triton.cdiv(beyond.shape[2], 32)
    _kept[(batch * t, tiles, triton.cdiv(X.shape[3], 64))](
        columns, kept, slots, X, beyond, t, w, m, X.shape[2], X.shape[3], beyond.shape[2], X.stride(0), X.stride(2),
        beyond.stride(0), beyond.stride(2), ROWS=32, COLS=64,
    )  # fmt: skip
    if m:
        sources, apart = _sources(fronts, below)
        _left[(batch * t, triton.cdiv(m, 32), triton.cdiv(m, 64))](
            *sources, squared(kept), updates, below.shape[1], apart, t, w, m, n, updates.stride(0), ARITY=arity,
            WHOLE=whole, ROWS=32, COLS=64,
        )  # fmt: skip
    return info.view(batch, t)
