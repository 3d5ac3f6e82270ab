"""Tangents of cells of hexes in one launch, by Triton; imported only where there is a GPU.

The formulas are those of elements.slopes and laws. A program takes one cell: its state in double precision, the sums
over its unknowns, 3 corner + direction, in single precision.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import triton
import triton.language as tl
from torch import Tensor

from tacgen.tensor_engine.gpu_elements import COUNTS, LEAST, MOST, cofactor, cross, law

if TYPE_CHECKING:
    from tacgen.tensor_engine.elements import Hexes


@triton.jit
def _of_row(i, a, b, c):
    """The number of each direction i."""
    return tl.where(i == 0, a, tl.where(i == 1, b, c))


@triton.jit
def _outer(u, v):
    return u[:, None] * v[None, :]


@triton.jit
def _slopes(at, inside):
    """dN/dX of each unknown's corner, in three directions."""
    return (
        tl.load(at, mask=inside, other=0.0), tl.load(at + 1, mask=inside, other=0.0),
        tl.load(at + 2, mask=inside, other=0.0),
    )  # fmt: skip


@triton.jit
def _gradient(x, i, g0, g1, g2):
    """F of one cell, by rows, of its corners' coordinates x (32,) in directions i and dN/dX at them."""
    a, b, c = tl.where(i == 0, x, 0.0), tl.where(i == 1, x, 0.0), tl.where(i == 2, x, 0.0)
    return (
        tl.sum(a * g0, 0), tl.sum(a * g1, 0), tl.sum(a * g2, 0), tl.sum(b * g0, 0), tl.sum(b * g1, 0),
        tl.sum(b * g2, 0), tl.sum(c * g0, 0), tl.sum(c * g1, 0), tl.sum(c * g2, 0),
    )  # fmt: skip


@triton.jit(do_not_specialize=COUNTS)
def _tangents(
    X, CONN, B, WEIGHTS, LAWS, SLOTS, AHEAD, K, OUT, cells, nodes, capacity, MIXED: tl.constexpr, TWO: tl.constexpr
):
    scene, cell = tl.program_id(0), tl.program_id(1)
    first = tl.load(SLOTS + scene).to(tl.int64) * cells + cell
    own = scene.to(tl.int64) * cells + cell
    n = tl.arange(0, 32)  # unknowns, 3 corner + direction
    i, inside = n % 3, n < 24
    node = tl.load(CONN + cell * 8 + n // 3, mask=inside, other=0)
    x = tl.load(X + 3 * (scene.to(tl.int64) * nodes + node) + i, mask=inside, other=0.0)
    at = B + 192 * first + 24 * (n // 3)
    total = 0.0 * tl.load(WEIGHTS + 8 * first)
    mean, ahead = total, total
    for k in range(8):
        w = tl.load(WEIGHTS + 8 * first + k)
        g0, g1, g2 = _slopes(at + 3 * k, inside)
        a, b, c, d, f, g, h, u, j = _gradient(x, i, g0, g1, g2)
        p, q, r = cross(d, f, g, h, u, j)
        J = a * p + b * q + c * r
        J = tl.where(J > LEAST, J, 1.0)
        total, mean = total + w, mean + w * J
        if MIXED:
            ahead += w * tl.minimum(tl.maximum(tl.load(AHEAD + 8 * own + k), J / MOST), MOST * J)
    void = total <= 0
    volume = tl.where(void, 1.0, total)
    mean = tl.where(void, 1.0, mean / volume)
    c10, c01, c20, c30, raw, kappa, lam, slope = law(LAWS, first, capacity.to(tl.int64) * cells, True)
    dilatation = tl.where(void, 0.0, (kappa / 2 * (1 + 1 / (mean * mean)) + lam) / volume)
    if MIXED:
        mean = tl.where(void, 1.0, ahead / volume)
    pressure = kappa / 2 * (mean - 1 / mean) + lam * (mean - 1) - slope
    out = tl.zeros((32, 32), tl.float32)
    swept = tl.zeros((32,), tl.float32)  # the slope of the cell's volume
    turn = (i[None, :] - i[:, None] + 3) % 3  # 1: directions follow each other, 2: the other way, 0: the same
    third = 3 - i[:, None] - i[None, :]
    for k in range(8):
        w = tl.load(WEIGHTS + 8 * first + k)
        g0, g1, g2 = _slopes(at + 3 * k, inside)
        a, b, c, d, f, g, h, u, j = _gradient(x, i, g0, g1, g2)
        ca, cb, cc, cd, cf, cg, ch, cl, cj = cofactor(a, b, c, d, f, g, h, u, j)
        J = a * ca + b * cb + c * cc
        F = OUT + 9 * (8 * own + k)
        tl.store(F, a)
        tl.store(F + 1, b)
        tl.store(F + 2, c)
        tl.store(F + 3, d)
        tl.store(F + 4, f)
        tl.store(F + 5, g)
        tl.store(F + 6, h)
        tl.store(F + 7, u)
        tl.store(F + 8, j)
        J = tl.where(J > LEAST, J, 1.0)
        I1 = a * a + b * b + c * c + d * d + f * f + g * g + h * h + u * u + j * j
        I2 = ca * ca + cb * cb + cc * cc + cd * cd + cf * cf + cg * cg + ch * ch + cl * cl + cj * cj
        m = tl.exp(-2 / 3 * tl.log(J))
        s, t = m * I1 - 3, m * m
        dw, ddw = (3 * c30 * s + 2 * c20) * s + c10, 6 * c30 * s + 2 * c20
        y3, y13 = -2 / 3 * m / J * I1, -2 / 3 * m / J
        w1, w2 = dw * m + raw, c01 * t
        w3 = dw * y3 - 4 / 3 * c01 * t * I2 / J + pressure
        s11, s13, s23 = ddw * m * m, ddw * m * y3 + dw * y13, -4 / 3 * c01 * t / J
        s33 = ddw * y3 * y3 + dw * 10 / 9 * m / (J * J) * I1 + 28 / 9 * c01 * t * I2 / (J * J)
        # the row of F and of its cofactor of each unknown, and slopes of I1 / 2 and J
        r0, r1, r2 = _of_row(i, a, d, h), _of_row(i, b, f, u), _of_row(i, c, g, j)
        p = (r0 * g0 + r1 * g1 + r2 * g2).to(tl.float32)
        q = _of_row(i, ca, cd, ch) * g0 + _of_row(i, cb, cf, cl) * g1 + _of_row(i, cc, cg, cj) * g2
        q = q.to(tl.float32)
        g0, g1, g2 = g0.to(tl.float32), g1.to(tl.float32), g2.to(tl.float32)
        r0, r1, r2 = r0.to(tl.float32), r1.to(tl.float32), r2.to(tl.float32)
        w = w.to(tl.float32)
        swept += w * q
        first_p = (4 * s11 + 4 * w2).to(tl.float32) * p + (2 * s13).to(tl.float32) * q
        first_q = (2 * s13).to(tl.float32) * p + s33.to(tl.float32) * q
        point = _outer(p, first_p) + _outer(q, first_q)
        both = _outer(g0, g0) + _outer(g1, g1) + _outer(g2, g2)
        point += tl.where(turn == 0, (2 * (w1 + w2 * I1)).to(tl.float32) * both, 0.0)
        along = _of_row(third, a.to(tl.float32), d.to(tl.float32), h.to(tl.float32)) * (_outer(g1, g2) - _outer(g2, g1))
        along += _of_row(third, b.to(tl.float32), f.to(tl.float32), u.to(tl.float32)) * (
            _outer(g2, g0) - _outer(g0, g2)
        )
        along += _of_row(third, c.to(tl.float32), g.to(tl.float32), j.to(tl.float32)) * (
            _outer(g0, g1) - _outer(g1, g0)
        )
        point += w3.to(tl.float32) * tl.where(turn == 0, 0.0, tl.where(turn == 1, along, -along))
        if TWO:
            xx, xy, xz = a * a + d * d + h * h, a * b + d * f + h * u, a * c + d * g + h * j
            yy, yz, zz = b * b + f * f + u * u, b * c + f * g + u * j, c * c + g * g + j * j
            xx, xy, xz = xx.to(tl.float32), xy.to(tl.float32), xz.to(tl.float32)
            yy, yz, zz = yy.to(tl.float32), yz.to(tl.float32), zz.to(tl.float32)
            e0, e1, e2 = xx * g0 + xy * g1 + xz * g2, xy * g0 + yy * g1 + yz * g2, xz * g0 + yz * g1 + zz * g2
            v = 2 * (I1.to(tl.float32) * p - (r0 * e0 + r1 * e1 + r2 * e2))  # the slope of I2
            point += s23.to(tl.float32) * (_outer(v, q) + _outer(q, v))
            less = tl.where(turn == 0, _outer(g0, e0) + _outer(g1, e1) + _outer(g2, e2), 0.0)
            less += (_outer(r0, r0) + _outer(r1, r1) + _outer(r2, r2)) * both
            less += (_outer(r0, g0) + _outer(r1, g1) + _outer(r2, g2)) * (
                _outer(g0, r0) + _outer(g1, r1) + _outer(g2, r2)
            )
            point -= (2 * w2).to(tl.float32) * less
        out += w * point
    out += dilatation.to(tl.float32) * _outer(swept, swept)
    tl.store(K + 576 * own + 24 * n[:, None] + n[None, :], out, mask=inside[:, None] & inside[None, :])


def tangents(hexes: Hexes, x: Tensor, ahead: Tensor | None) -> tuple[Tensor, Tensor]:
    """F (s, e, 8, 3, 3) and the tangents (s, e, 24, 24), in single precision, of elements.Hexes.tangents."""
    s, (e, _) = len(x), hexes.topology.conn.shape
    F, K = x.new_empty(s, e, 8, 3, 3), x.new_empty(s, e, 24, 24, dtype=torch.float32)
    _tangents[(s, e)](
        x.contiguous(), hexes.topology.conn, hexes.B, hexes.weights, hexes.laws.values, hexes.numbers,
        x if ahead is None else ahead.contiguous(), K, F, e, x.shape[1], len(hexes.B), MIXED=ahead is not None,
        TWO=hexes.laws.two_invariants, num_warps=1,  # more would compute the state of the cell again each
    )  # fmt: skip
    return F, K
