"""Cells of hexes in one launch, by Triton: energy, J and forces at all points; imported only where there is a GPU.

The formulas are those of elements.Hexes, laws and inversion, in double precision. A program takes cells of one scene,
with a row of eight corners for each, and reads dN/dX from the scene's slot, so that nothing is copied.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import triton
import triton.language as tl
from torch import Tensor

from tacgen.fem.elasticity import PREDICTED, SMALLEST_J
from tacgen.fem.elements import grid_points
from tacgen.fem.folding_barrier import J0, STIFFNESS
from tacgen.tensor_engine.indices import constant

if TYPE_CHECKING:
    from tacgen.tensor_engine.elements import Hexes, Topology
    from tacgen.tensor_engine.inversion import FoldingBarriers

CELLS = 32  # of a program, which has one warp: more would compute numbers of a cell again each
DENSE = grid_points(8)[1]
LEAST, MOST, FOLDED, STIFF = (tl.constexpr(x) for x in (SMALLEST_J, PREDICTED, J0, STIFFNESS))
COUNTS = ("cells", "nodes", "capacity")  # no code of its own for each value that they may have


@triton.jit
def cross(a, b, c, d, e, f):
    return b * f - c * e, c * d - a * f, a * e - b * d


@triton.jit
def _corners(X, CONN, scene, cell, nodes, inside):
    """Positions of the corners of cells, each (CELLS, 8)."""
    corner = tl.arange(0, 8)[None, :]
    node = tl.load(CONN + cell[:, None] * 8 + corner, mask=inside[:, None], other=0)
    at = X + 3 * (scene.to(tl.int64) * nodes + node)
    return tl.load(at), tl.load(at + 1), tl.load(at + 2)


@triton.jit
def _slopes(B, first, k, inside):
    """dN/dX (CELLS, 8) of point k: B has numbers (8, 8, 3) of corner, point and direction for each cell, the first of
    which is number `first`."""
    at = B + 192 * first[:, None] + 24 * tl.arange(0, 8)[None, :] + 3 * k
    real = inside[:, None]
    return (
        tl.load(at, mask=real, other=0.0),
        tl.load(at + 1, mask=real, other=0.0),
        tl.load(at + 2, mask=real, other=0.0),
    )


@triton.jit
def _row(x, bx, by, bz):
    """A row of F (3 of (CELLS,)): the sum over corners of a coordinate and dN/dX."""
    return tl.sum(x * bx, 1), tl.sum(x * by, 1), tl.sum(x * bz, 1)


@triton.jit
def _determinant(x, y, z, bx, by, bz):
    a, b, c = _row(x, bx, by, bz)
    d, e, f = _row(y, bx, by, bz)
    g, h, i = _row(z, bx, by, bz)
    p, q, r = cross(d, e, f, g, h, i)
    return a * p + b * q + c * r


@triton.jit
def _turned(T, p, q, r, bx, by, bz):
    """The sum over directions of a row (3 of (CELLS,)) and dN/dX: (CELLS, 8) added to T."""
    return T + p[:, None] * bx + q[:, None] * by + r[:, None] * bz


@triton.jit
def cofactor(a, b, c, d, f, g, h, i, j):
    """The cofactor of matrices whose entries are given row by row, and returned so."""
    ca, cb, cc = cross(d, f, g, h, i, j)
    cd, cf, cg = cross(h, i, j, a, b, c)
    ch, ci, cj = cross(a, b, c, d, f, g)
    return ca, cb, cc, cd, cf, cg, ch, ci, cj


@triton.jit
def law(LAWS, at, count, inside):
    """The eight numbers of laws.NUMBERS of cells `at`, of which there are so many."""
    return (
        tl.load(LAWS + at, mask=inside, other=0.0), tl.load(LAWS + count + at, mask=inside, other=0.0),
        tl.load(LAWS + 2 * count + at, mask=inside, other=0.0), tl.load(LAWS + 3 * count + at, mask=inside, other=0.0),
        tl.load(LAWS + 4 * count + at, mask=inside, other=0.0), tl.load(LAWS + 5 * count + at, mask=inside, other=0.0),
        tl.load(LAWS + 6 * count + at, mask=inside, other=0.0), tl.load(LAWS + 7 * count + at, mask=inside, other=0.0),
    )  # fmt: skip


@triton.jit
def _matrix(T, inside):
    """The nine entries of matrices that begin at T."""
    return (
        tl.load(T, mask=inside), tl.load(T + 1, mask=inside), tl.load(T + 2, mask=inside),
        tl.load(T + 3, mask=inside), tl.load(T + 4, mask=inside), tl.load(T + 5, mask=inside),
        tl.load(T + 6, mask=inside), tl.load(T + 7, mask=inside), tl.load(T + 8, mask=inside),
    )  # fmt: skip


@triton.jit
def _log1p(e):
    """log(1 + e) exact to rounding, by the rounded sum (Kahan)."""
    u = 1 + e
    return tl.where(u == 1, e, tl.log(u) * e / tl.where(u == 1, 1.0, u - 1))


@triton.jit(do_not_specialize=COUNTS)
def _states(
    X, CONN, B, WEIGHTS, LAWS, SLOTS, AHEAD, TAKEN, ENERGY, OUT, FORCES, cells, nodes, capacity,
    WANT: tl.constexpr, MIXED: tl.constexpr, SIZE: tl.constexpr,
):  # fmt: skip
    scene = tl.program_id(0)
    cell = tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    inside = cell < cells
    first = tl.load(SLOTS + scene).to(tl.int64) * cells + cell
    own = scene.to(tl.int64) * cells + cell
    x, y, z = _corners(X, CONN, scene, cell, nodes, inside)
    total = tl.zeros((SIZE,), tl.float64)
    mean, ahead = total, total
    wrong = total > 0
    for k in range(8):  # the means of J, true and predicted
        w = tl.load(WEIGHTS + 8 * first + k, mask=inside, other=0.0)
        bx, by, bz = _slopes(B, first, k, inside)
        J = _determinant(x, y, z, bx, by, bz)
        good = J > LEAST
        wrong = wrong | ((w != 0) & ~good)
        J = tl.where(good, J, 1.0)
        total, mean = total + w, mean + w * J
        if MIXED:
            P = tl.load(AHEAD + 8 * first + k, mask=inside, other=1.0)
            ahead += w * tl.minimum(tl.maximum(P, J / MOST), MOST * J)
    void = total <= 0
    volume = tl.where(void, 1.0, total)
    mean = tl.where(void, 1.0, mean / volume)
    c10, c01, c20, c30, raw, kappa, lam, slope = law(LAWS, first, capacity.to(tl.int64) * cells, inside)
    e = mean - 1
    energy = total * (kappa / 2 * (e + e * e / 2 - _log1p(e)) + lam / 2 * e * e - slope * e)
    pressure = kappa / 2 * (mean - 1 / mean) + lam * e - slope
    change = 0 * mean  # of the pressure, from the true mean J to the predicted one
    if MIXED:
        ahead = tl.where(void, 1.0, ahead / volume)
        change = kappa / 2 * (ahead - 1 / ahead) + lam * (ahead - 1) - slope - pressure
    fx = tl.zeros((SIZE, 8), tl.float64)
    fy, fz = fx, fx
    for k in range(8):
        w = tl.load(WEIGHTS + 8 * first + k, mask=inside, other=0.0)
        bx, by, bz = _slopes(B, first, k, inside)
        a, b, c = _row(x, bx, by, bz)
        d, f, g = _row(y, bx, by, bz)
        h, i, j = _row(z, bx, by, bz)
        ca, cb, cc, cd, cf, cg, ch, ci, cj = cofactor(a, b, c, d, f, g, h, i, j)
        J = a * ca + b * cb + c * cc
        J = tl.where(J > LEAST, J, 1.0)
        I1 = a * a + b * b + c * c + d * d + f * f + g * g + h * h + i * i + j * j
        I2 = ca * ca + cb * cb + cc * cc + cd * cd + cf * cf + cg * cg + ch * ch + ci * ci + cj * cj
        p = tl.exp(-2 / 3 * tl.log(J))
        s, t = p * I1 - 3, p * p
        dw = (3 * c30 * s + 2 * c20) * s + c10
        energy += w * (((c30 * s + c20) * s + c10) * s + c01 * (t * I2 - 3) + raw * (I1 - 3))
        if WANT:
            tl.store(OUT + 8 * own + k, J, mask=inside)
            w1, w2 = dw * p + raw, c01 * t
            w3 = -2 / 3 * p / J * I1 * dw - 4 / 3 * c01 * t * I2 / J + pressure + change
            u, v = 2 * w * (w1 + w2 * I1), w * w3
            # F^T F, symmetric: xx, xy, xz, yy, yz, zz
            xx, xy, xz = a * a + d * d + h * h, a * b + d * f + h * i, a * c + d * g + h * j
            yy, yz, zz = b * b + f * f + i * i, b * c + f * g + i * j, c * c + g * g + j * j
            m = -2 * w * w2
            ka, kb, kc = ca, cb, cc
            kd, kf, kg = cd, cf, cg
            kh, ki, kj = ch, ci, cj
            r = 0 * w
            if MIXED:  # the pressure that the prediction lacks acts on the cofactor of the last tangent
                r = -w * change
                ta, tb, tc, td, tf, tg, th, ti, tj = _matrix(TAKEN + 9 * (8 * first + k), inside)
                ka, kb, kc, kd, kf, kg, kh, ki, kj = cofactor(ta, tb, tc, td, tf, tg, th, ti, tj)
            fx = _turned(fx, u * a + v * ca + r * ka + m * (a * xx + b * xy + c * xz),
                         u * b + v * cb + r * kb + m * (a * xy + b * yy + c * yz),
                         u * c + v * cc + r * kc + m * (a * xz + b * yz + c * zz), bx, by, bz)  # fmt: skip
            fy = _turned(fy, u * d + v * cd + r * kd + m * (d * xx + f * xy + g * xz),
                         u * f + v * cf + r * kf + m * (d * xy + f * yy + g * yz),
                         u * g + v * cg + r * kg + m * (d * xz + f * yz + g * zz), bx, by, bz)  # fmt: skip
            fz = _turned(fz, u * h + v * ch + r * kh + m * (h * xx + i * xy + j * xz),
                         u * i + v * ci + r * ki + m * (h * xy + i * yy + j * yz),
                         u * j + v * cj + r * kj + m * (h * xz + i * yz + j * zz), bx, by, bz)  # fmt: skip
    tl.store(ENERGY + own, tl.where(wrong, float("inf"), energy), mask=inside)
    if WANT:
        at = FORCES + 24 * own[:, None] + 3 * tl.arange(0, 8)[None, :]
        tl.store(at, fx, mask=inside[:, None])
        tl.store(at + 1, fy, mask=inside[:, None])
        tl.store(at + 2, fz, mask=inside[:, None])


@triton.jit(do_not_specialize=COUNTS)
def _predictions(X, TO, CONN, B, SLOTS, TAKEN, OUT, cells, nodes, capacity, SIZE: tl.constexpr):
    scene = tl.program_id(0)
    cell = tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    inside = cell < cells
    first = tl.load(SLOTS + scene).to(tl.int64) * cells + cell
    own = scene.to(tl.int64) * cells + cell
    x, y, z = _corners(X, CONN, scene, cell, nodes, inside)
    px, py, pz = _corners(TO, CONN, scene, cell, nodes, inside)
    for k in range(8):
        bx, by, bz = _slopes(B, first, k, inside)
        a, b, c, d, f, g, h, i, j = _matrix(TAKEN + 9 * (8 * first + k), inside)
        ca, cb, cc, cd, cf, cg, ch, ci, cj = cofactor(a, b, c, d, f, g, h, i, j)
        p, q, r = _row(px - x, bx, by, bz)
        u, v, w = _row(py - y, bx, by, bz)
        l0, l1, l2 = _row(pz - z, bx, by, bz)
        out = _determinant(x, y, z, bx, by, bz) + ca * p + cb * q + cc * r
        out += cd * u + cf * v + cg * w + ch * l0 + ci * l1 + cj * l2
        tl.store(OUT + 8 * own + k, out, mask=inside)


@triton.jit
def _least(x, y, z, SLOPES, rest, inside, POINTS: tl.constexpr):
    """The lowest of det(dx/dxi) of cells over that at rest, from `rest` on, at the dense points."""
    least, corner = tl.sum(x * 0, 1) + float("inf"), tl.arange(0, 8)[None, :]
    for k in range(POINTS):
        at = SLOPES + 24 * k + 3 * corner
        J = _determinant(x, y, z, tl.load(at), tl.load(at + 1), tl.load(at + 2))
        least = tl.minimum(least, J / tl.load(rest + k, mask=inside, other=1.0))
    return least


@triton.jit(do_not_specialize=COUNTS)
def _lowest(X, CONN, SLOPES, REST, OUT, cells, nodes, capacity, POINTS: tl.constexpr, SIZE: tl.constexpr):
    scene = tl.program_id(0)
    cell = tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    inside = cell < cells
    own = scene.to(tl.int64) * cells + cell
    x, y, z = _corners(X, CONN, scene, cell, nodes, inside)
    tl.store(OUT + own, _least(x, y, z, SLOPES, REST + POINTS * own, inside, POINTS), mask=inside)


@triton.jit(do_not_specialize=COUNTS)
def _folds(
    X, CONN, SLOPES, REST, VOLUME, MU, TIMES, SLOTS, ENERGY, FORCES, cells, nodes,
    POINTS: tl.constexpr, WANT: tl.constexpr, SIZE: tl.constexpr,
):  # fmt: skip
    scene = tl.program_id(0)
    cell = tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    inside = cell < cells
    slot, own = tl.load(SLOTS + scene).to(tl.int64), scene.to(tl.int64) * cells + cell
    first = slot * cells + cell
    volume = tl.load(VOLUME + first, mask=inside, other=0.0)
    x, y, z = _corners(X, CONN, scene, cell, nodes, inside)
    corner = tl.arange(0, 8)[None, :]
    least = _least(x, y, z, SLOPES, REST + POINTS * first, inside, POINTS)
    least = tl.where(volume > 0, least, 1.0)
    energy, wrong = tl.zeros((SIZE,), tl.float64), volume < 0
    fx = tl.zeros((SIZE, 8), tl.float64)
    fy, fz = fx, fx
    if tl.min(least, 0) < FOLDED:
        for k in range(POINTS):
            at = SLOPES + 24 * k + 3 * corner
            bx, by, bz = tl.load(at), tl.load(at + 1), tl.load(at + 2)
            a, b, c = _row(x, bx, by, bz)
            d, f, g = _row(y, bx, by, bz)
            h, i, j = _row(z, bx, by, bz)
            ca, cb, cc, cd, cf, cg, ch, ci, cj = cofactor(a, b, c, d, f, g, h, i, j)
            rest = tl.load(REST + POINTS * first + k, mask=inside, other=1.0)
            J = (a * ca + b * cb + c * cc) / rest
            wrong = wrong | ~(J > LEAST)
            s = tl.minimum(tl.where(J > LEAST, J, 1.0) / FOLDED, 1.0)
            ln, r = tl.log(s), 1 - s
            energy -= r * r * ln
            if WANT:
                u = (2 * r * ln - r * r / s) / rest  # of the derivatives of det(dx/dxi)
                fx = _turned(fx, u * ca, u * cb, u * cc, bx, by, bz)
                fy = _turned(fy, u * cd, u * cf, u * cg, bx, by, bz)
                fz = _turned(fz, u * ch, u * ci, u * cj, bx, by, bz)
    folded = least < FOLDED
    scale = tl.load(MU + first, mask=inside, other=0.0) * tl.load(TIMES + slot) * STIFF * volume / POINTS
    energy = tl.where(wrong, float("inf"), scale * energy)
    tl.store(ENERGY + own, tl.where(folded, energy, 0.0), mask=inside)
    if WANT:
        at, scale = FORCES + 24 * own[:, None] + 3 * corner, tl.where(folded, scale / FOLDED, 0.0)[:, None]
        tl.store(at, scale * fx, mask=inside[:, None])
        tl.store(at + 1, scale * fy, mask=inside[:, None])
        tl.store(at + 2, scale * fz, mask=inside[:, None])


@triton.jit(do_not_specialize=COUNTS)
def _at_nodes(AROUND, PARTS, OUT, cells, nodes, SIZE: tl.constexpr):
    scene, k = tl.program_id(0).to(tl.int64), tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    inside, total = k < 3 * nodes, tl.zeros((SIZE,), tl.float64)
    for j in tl.static_range(8):
        at = tl.load(AROUND + k // 3 * 8 + j, mask=inside, other=0)
        there = inside & (at < 8 * cells)
        total += tl.load(PARTS + 3 * (8 * scene * cells + at) + k % 3, mask=there, other=0.0)
    tl.store(OUT + 3 * nodes * scene + k, total, mask=inside)


def states(
    hexes: Hexes, x: Tensor, want: bool, ahead: Tensor | None = None, taken: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Energies (s, e) of cells at x (s, n, 3), inf where one is inverted; if wanted J (s, e, 8) at their points and
    forces (s, e, 8, 3) on their corners. With J `ahead` and F `taken`, as elements.Hexes.mixed_forces: its forces."""
    s, (e, _), mixed = len(x), hexes.topology.conn.shape, ahead is not None
    energy, J = x.new_empty(s, e), x.new_empty((s, e, 8) if want else 0)
    forces = x.new_empty((s, e, 8, 3) if want else 0)
    given = (x, x) if ahead is None or taken is None else (ahead.contiguous(), taken.contiguous())
    _states[_grid(s, e)](
        x.contiguous(), hexes.topology.conn, hexes.B, hexes.weights, hexes.laws.values, hexes.numbers, *given, energy,
        J, forces, e, x.shape[1], len(hexes.B), WANT=want, MIXED=mixed, SIZE=CELLS, num_warps=1,
    )  # fmt: skip
    return energy, J, forces


def predictions(hexes: Hexes, x: Tensor, to: Tensor, taken: Tensor) -> Tensor:
    """J (s, e, 8) at positions `to` (s, n, 3) to first order from x, linearised at F `taken` (capacity, e, 8, 3, 3)."""
    s, (e, _) = len(x), hexes.topology.conn.shape
    out = x.new_empty(s, e, 8)
    _predictions[_grid(s, e)](
        x.contiguous(), to.contiguous(), hexes.topology.conn, hexes.B, hexes.numbers, taken.contiguous(), out,
        e, x.shape[1], len(hexes.B), SIZE=CELLS, num_warps=1,
    )  # fmt: skip
    return out


def lowest(topology: Topology, x: Tensor, rest: Tensor) -> Tensor:
    """The lowest det(dx/dxi) of each cell (s, e) over that at rest (s, e, q), at the dense points of inversion."""
    s, (e, _) = len(x), topology.conn.shape
    out = x.new_empty(s, e)
    _lowest[_grid(s, e)](
        x.contiguous(), topology.conn, constant(DENSE, x), rest.contiguous(), out, e, x.shape[1], 0,
        POINTS=len(DENSE), SIZE=CELLS, num_warps=1,
    )  # fmt: skip
    return out


def folds(barriers: FoldingBarriers, x: Tensor, times: Tensor, want: bool) -> tuple[Tensor, Tensor]:
    """Energies (s, e) of the barrier against inversion in cells at x (s, n, 3), inf where one is inverted, and, if
    wanted, forces (s, e, 8, 3) on their corners; times (capacity,): factors of the stiffness."""
    s, e = len(x), len(barriers.topology.conn)
    energy, forces = x.new_empty(s, e), x.new_empty((s, e, 8, 3) if want else 0)
    _folds[_grid(s, e)](
        x.contiguous(), barriers.topology.conn, constant(DENSE, x), barriers.rest, barriers.volume, barriers.mu, times,
        barriers.numbers, energy, forces, e, x.shape[1], POINTS=len(DENSE), WANT=want, SIZE=CELLS, num_warps=1,
    )  # fmt: skip
    return energy, forces


def at_nodes(topology: Topology, parts: Tensor) -> Tensor:
    """elements.Topology.at_nodes of parts (s, e, 8, 3)."""
    s, e, n = len(parts), len(topology.conn), topology.nodes
    out = parts.new_empty(s, n, 3)
    _at_nodes[(s, triton.cdiv(3 * n, 128))](topology.around, parts.contiguous(), out, e, n, SIZE=128)
    return out


def _grid(s: int, e: int) -> tuple[int, int]:
    return s, triton.cdiv(e, CELLS)
