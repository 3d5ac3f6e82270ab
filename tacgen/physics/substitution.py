"""Products of matrices in slots and vectors, which may stand at nodes of a mesh, as Warp kernels.

Matrices are A (capacity, t, r, c), of which a scene has those at its slot; vectors (s, t, numbers), or (s, 1, 3 n) of
a mesh with `nodes` (t, numbers / 3): node n and later ones are padding, and 0. used: `down` and `across` (capacity,),
rows and columns beyond which A is 0.
"""

from typing import Any

import warp as wp

from tacgen.physics.elimination import told
from tacgen.physics.runtime import BLOCK_THREADS, WARP_THREADS
from tacgen.physics.types import Ints3, Longs, Longs2, in_precisions

SECTOR_NUMBERS = wp.constant(8)  # that a GPU's memory gives at once, of single precision
# products that a thread begins before it waits for one: along a row, which a warp reads at once, and down a column
UNROLLED_ALONG, UNROLLED_DOWN = 8, 16
SHORT_ROW = wp.constant(64)  # numbers of a row up to which several rows share a warp
LINE_NUMBERS = wp.constant(WARP_THREADS)  # columns that a warp reads at once, of which other warps read other rows


@wp.func
def no_node(nodes: Longs2, front: int, k: int):
    return 0


@wp.func
def row_number(x: wp.array3d(dtype=Any), s: int, front: int, node: int, k: int):
    """Number k of a front's vector, which has a row of its own."""
    return x[s, front, k] + x.dtype(0.0)


@wp.func
def node_of(nodes: Longs2, front: int, k: int):
    """The node at which number k of a front's vector stands."""
    return int(nodes[front, k / 3])


@wp.func
def node_number(x: wp.array3d(dtype=Any), s: int, front: int, node: int, k: int):
    """Number k of a front's vector, which stands at its nodes."""
    place = 3 * node + k % 3
    return wp.where(place < x.shape[2], x[s, 0, wp.min(place, x.shape[2] - 1)], x.dtype(0.0))


@wp.func
def number_at(x: wp.array3d(dtype=Any), nodes: Longs2, s: int, front: int, k: int):
    """Number k of a front's vector."""
    if nodes.shape[0] == 0:
        return row_number(x, s, front, 0, k)
    return node_number(x, s, front, node_of(nodes, front, k), k)


@wp.func
def set_at(out: wp.array3d(dtype=Any), nodes: Longs2, s: int, front: int, k: int, value: Any):
    if nodes.shape[0] == 0:
        out[s, front, k] = value
        return
    at = 3 * int(nodes[front, k / 3]) + k % 3
    if at < out.shape[2]:
        out[s, 0, at] = value


@wp.kernel(enable_backward=False, module="tacgen.batches")
def gathered(
    b: wp.array3d(dtype=Any), own: Longs2, below: wp.array3d(dtype=Any), places: Ints3, children: wp.array2d(dtype=int),
    out: wp.array3d(dtype=Any), to: Longs2,
):  # fmt: skip
    """Vectors of fronts: what b (s, 1, 3 n) has at their own nodes (t, w / 3) and the sum of the children's updates in
    below (s, 1, numbers), whose first rows are `children` (t, arity)."""
    s, front, k = wp.tid()
    total = out.dtype(0.0)
    if k / 3 < own.shape[1]:
        total = number_at(b, own, s, front, k)
    for c in range(children.shape[1]):
        place = places[front, c, k / 3]
        if place >= 0:
            total += below[s, 0, 3 * (children[front, c] + place) + k % 3]
    set_at(out, to, s, front, k, total)


@wp.func
def summed_along(value: Any, lane: int, count: int):
    """The sum over `count` threads of a warp that are next to each other; of the only thread on a core."""
    total, bit = value, count / 2
    while bit > 0:
        total += told(total, lane ^ bit)
        bit /= 2
    return total


SUMMED_DOWN = """
#if defined(__CUDA_ARCH__)
    __shared__ decltype(value) numbers[PARTS][LINE];
    __syncthreads();
    numbers[thread / LINE][thread % LINE] = value;
    __syncthreads();
    if (thread < LINE) for (int part = 1; part < PARTS; ++part) value += numbers[part][thread];
#endif
    return value;
""".replace("PARTS", str(BLOCK_THREADS // WARP_THREADS)).replace("LINE", str(WARP_THREADS))


@wp.func_native(SUMMED_DOWN)
def summed_down(value: wp.float32, thread: int) -> wp.float32:
    """The sum over the warps of a block, in its first; of the only thread on a core."""
    ...


@wp.func_native(SUMMED_DOWN)
def summed_down(value: wp.float64, thread: int) -> wp.float64: ...  # noqa: F811  (Warp chooses by types)


def _products(node: Any, number: Any, key: str) -> tuple[dict[Any, wp.Kernel], ...]:
    """Kernels whose vectors x have numbers at nodes or not: all loads of a step stand before what waits for one, since
    a GPU's compiler leaves them in their order."""

    def times(
        A: wp.array4d(dtype=Any), slots: Longs, down: Longs, across: Longs, lower: bool, x: wp.array3d(dtype=Any),
        at: Longs2, start: wp.array3d(dtype=Any), step: int, out: wp.array3d(dtype=Any), to: Longs2,
    ):  # fmt: skip
        """A x, or start - A x if there is a start; `lower`: of lower triangles A. `step` threads have a row, or of
        short rows as many as they are SECTOR_NUMBERS."""
        which, group, lane = wp.tid()
        s, front = which / A.shape[1], which % A.shape[1]
        slot, rows, columns = slots[s], A.shape[2], A.shape[3]
        M = A[slot, front]
        wide = step
        if columns <= SHORT_ROW:
            wide = wp.min(SECTOR_NUMBERS, step)
        row, k = group * (step / wide) + lane / wide, lane % wide
        if down.shape[0] > 0:
            rows, columns = wp.min(int(down[slot]), rows), wp.min(int(across[slot]), columns)
        if lower:
            columns = wp.min(row + 1, columns)
        total = out.dtype(0.0)
        if row < rows:
            while k < columns:
                nodes = wp.vector(length=UNROLLED_ALONG, dtype=int)
                factors = wp.vector(length=UNROLLED_ALONG, dtype=A.dtype)
                numbers = wp.vector(length=UNROLLED_ALONG, dtype=out.dtype)
                for i in range(UNROLLED_ALONG):
                    column = wp.min(k + wp.static(i) * wide, columns - 1)
                    nodes[wp.static(i)] = node(at, front, column)
                    factors[wp.static(i)] = M[row, column]
                for i in range(UNROLLED_ALONG):
                    column = wp.min(k + wp.static(i) * wide, columns - 1)
                    numbers[wp.static(i)] = number(x, s, front, nodes[wp.static(i)], column)
                for i in range(UNROLLED_ALONG):
                    product = out.dtype(factors[wp.static(i)]) * numbers[wp.static(i)]
                    total += wp.where(k + wp.static(i) * wide < columns, product, out.dtype(0.0))
                k += UNROLLED_ALONG * wide
        total = summed_along(total, lane, wide)
        if lane % wide == 0 and row < A.shape[2]:
            if start.shape[0] > 0:
                total = start[s, front, row] - total
            set_at(out, to, s, front, row, total)

    def transposed_times(
        A: wp.array4d(dtype=Any), slots: Longs, down: Longs, across: Longs, lower: bool, x: wp.array3d(dtype=Any),
        at: Longs2, start: wp.array3d(dtype=Any), step: int, out: wp.array3d(dtype=Any), to: Longs2,
    ):  # fmt: skip
        """A^T x, or start - A^T x if there is a start, which stands where `out` does; `lower`: of lower triangles A.
        `step` threads have LINE_NUMBERS columns, or one thread has one."""
        which, group, thread = wp.tid()
        s, front = which / A.shape[1], which % A.shape[1]
        slot, rows, columns = slots[s], A.shape[2], A.shape[3]
        M = A[slot, front]
        wide = wp.min(LINE_NUMBERS, step)
        column, k, parts = group * wide + thread % wide, thread / wide, step / wide
        if down.shape[0] > 0:
            rows, columns = wp.min(int(down[slot]), rows), wp.min(int(across[slot]), columns)
        if lower:
            k += group * wide
        total = out.dtype(0.0)
        if column < columns:
            while k < rows:
                nodes = wp.vector(length=UNROLLED_DOWN, dtype=int)
                factors = wp.vector(length=UNROLLED_DOWN, dtype=A.dtype)
                numbers = wp.vector(length=UNROLLED_DOWN, dtype=out.dtype)
                for i in range(UNROLLED_DOWN):
                    row = wp.min(k + wp.static(i) * parts, rows - 1)
                    nodes[wp.static(i)] = node(at, front, row)
                    factors[wp.static(i)] = M[row, column]
                for i in range(UNROLLED_DOWN):
                    row = wp.min(k + wp.static(i) * parts, rows - 1)
                    numbers[wp.static(i)] = number(x, s, front, nodes[wp.static(i)], row)
                for i in range(UNROLLED_DOWN):
                    product = out.dtype(factors[wp.static(i)]) * numbers[wp.static(i)]
                    total += wp.where(k + wp.static(i) * parts < rows, product, out.dtype(0.0))
                k += UNROLLED_DOWN * parts
        total = summed_down(total, thread)
        if thread < wide and column < A.shape[3]:
            if start.shape[0] > 0:
                total = number_at(start, to, s, front, column) - total
            set_at(out, to, s, front, column, total)

    module, options = wp.get_module("tacgen.batches"), {"enable_backward": False}
    made = (wp.Kernel(f, key=f"{f.__name__}_{key}", module=module, options=options) for f in (times, transposed_times))
    return tuple(in_precisions(kernel, ("A",), ("x", "start", "out")) for kernel in made)


PRODUCTS = _products(no_node, row_number, "rows"), _products(node_of, node_number, "nodes")  # A x and A^T x
GATHERED = in_precisions(gathered, ("b", "below", "out"))
