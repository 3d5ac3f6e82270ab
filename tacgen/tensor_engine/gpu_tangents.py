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
def _slopes(at, inside):
    """dN/dX of corners, in three directions."""
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


@triton.jit
def _single(a, b, c, d, f, g, h, u, j):
    return (
        a.to(tl.float32), b.to(tl.float32), c.to(tl.float32), d.to(tl.float32), f.to(tl.float32), g.to(tl.float32),
        h.to(tl.float32), u.to(tl.float32), j.to(tl.float32),
    )  # fmt: skip


@triton.jit
def _times(a, b, c, d, f, g, h, u, j, v0, v1, v2):
    """A matrix, by rows, times vectors."""
    return a * v0 + b * v1 + c * v2, d * v0 + f * v1 + g * v2, h * v0 + u * v1 + j * v2


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
    at = B + 192 * first
    total = 0.0 * tl.load(WEIGHTS + 8 * first)
    mean, ahead = total, total
    for k in range(8):
        w = tl.load(WEIGHTS + 8 * first + k)
        g0, g1, g2 = _slopes(at + 24 * (n // 3) + 3 * k, inside)
        a, b, c, d, f, g, h, u, j = _gradient(x, i, g0, g1, g2)
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
        p, q, r = cross(d, f, g, h, u, j)
        J = a * p + b * q + c * r
        J = tl.where(J > LEAST, J, 1.0)
        total, mean = total + w, mean + w * J
        if MIXED:
            ahead += w * tl.minimum(tl.maximum(tl.load(AHEAD + 8 * own + k), J / MOST), MOST * J)
    tl.debug_barrier()  # F is read again
    void = total <= 0
    volume = tl.where(void, 1.0, total)
    mean = tl.where(void, 1.0, mean / volume)
    c10, c01, c20, c30, raw, kappa, lam, slope = law(LAWS, first, capacity.to(tl.int64) * cells, True)
    dilatation = tl.where(void, 0.0, (kappa / 2 * (1 + 1 / (mean * mean)) + lam) / volume)
    if MIXED:
        mean = tl.where(void, 1.0, ahead / volume)
    pressure = kappa / 2 * (mean - 1 / mean) + lam * (mean - 1) - slope
    # blocks of two corners, (8, 8), for each pair of directions; corners of rows and columns
    m = tl.arange(0, 8)
    rows, columns, one = at + 24 * m[:, None], at + 24 * m[None, :], m[:, None] >= 0
    k00 = tl.zeros((8, 8), tl.float32)
    k01, k02, k10, k11, k12, k20, k21, k22 = k00, k00, k00, k00, k00, k00, k00, k00
    sr0 = tl.zeros((8, 1), tl.float32)  # the slope of the cell's volume
    sc0 = tl.zeros((1, 8), tl.float32)
    sr1, sr2, sc1, sc2 = sr0, sr0, sc0, sc0
    for k in range(8):
        w = tl.load(WEIGHTS + 8 * first + k)
        F = OUT + 9 * (8 * own + k)
        a, b, c, d, f, g = tl.load(F), tl.load(F + 1), tl.load(F + 2), tl.load(F + 3), tl.load(F + 4), tl.load(F + 5)
        h, u, j = tl.load(F + 6), tl.load(F + 7), tl.load(F + 8)
        ca, cb, cc, cd, cf, cg, ch, cl, cj = cofactor(a, b, c, d, f, g, h, u, j)
        J = a * ca + b * cb + c * cc
        J = tl.where(J > LEAST, J, 1.0)
        I1 = a * a + b * b + c * c + d * d + f * f + g * g + h * h + u * u + j * j
        I2 = ca * ca + cb * cb + cc * cc + cd * cd + cf * cf + cg * cg + ch * ch + cl * cl + cj * cj
        e = tl.exp(-2 / 3 * tl.log(J))
        s, t = e * I1 - 3, e * e
        dw, ddw = (3 * c30 * s + 2 * c20) * s + c10, 6 * c30 * s + 2 * c20
        y3, y13 = -2 / 3 * e / J * I1, -2 / 3 * e / J
        w1, w2 = dw * e + raw, c01 * t
        w3 = dw * y3 - 4 / 3 * c01 * t * I2 / J + pressure
        s11, s13, s23 = ddw * e * e, ddw * e * y3 + dw * y13, -4 / 3 * c01 * t / J
        s33 = ddw * y3 * y3 + dw * 10 / 9 * e / (J * J) * I1 + 28 / 9 * c01 * t * I2 / (J * J)
        pp, pq, qq = (w * (4 * s11 + 4 * w2)).to(tl.float32), (w * 2 * s13).to(tl.float32), (w * s33).to(tl.float32)
        same, other = (2 * w * (w1 + w2 * I1)).to(tl.float32), (w * w3).to(tl.float32)
        if TWO:
            s23, w2, I1 = (w * s23).to(tl.float32), (2 * w * w2).to(tl.float32), I1.to(tl.float32)
        w = w.to(tl.float32)
        a, b, c, d, f, g, h, u, j = _single(a, b, c, d, f, g, h, u, j)
        ca, cb, cc, cd, cf, cg, ch, cl, cj = _single(ca, cb, cc, cd, cf, cg, ch, cl, cj)
        x0, x1, x2 = _slopes(rows + 3 * k, one)
        y0, y1, y2 = _slopes(columns + 3 * k, m[None, :] >= 0)
        x0, x1, x2 = x0.to(tl.float32), x1.to(tl.float32), x2.to(tl.float32)
        y0, y1, y2 = y0.to(tl.float32), y1.to(tl.float32), y2.to(tl.float32)
        # slopes of I1 / 2 and of J
        p0, p1, p2 = _times(a, b, c, d, f, g, h, u, j, x0, x1, x2)
        q0, q1, q2 = _times(ca, cb, cc, cd, cf, cg, ch, cl, cj, x0, x1, x2)
        r0, r1, r2 = _times(a, b, c, d, f, g, h, u, j, y0, y1, y2)
        t0, t1, t2 = _times(ca, cb, cc, cd, cf, cg, ch, cl, cj, y0, y1, y2)
        sr0, sr1, sr2, sc0, sc1, sc2 = (
            sr0 + w * q0,
            sr1 + w * q1,
            sr2 + w * q2,
            sc0 + w * t0,
            sc1 + w * t1,
            sc2 + w * t2,
        )
        u0, u1, u2 = pp * r0 + pq * t0, pp * r1 + pq * t1, pp * r2 + pq * t2
        v0, v1, v2 = pq * r0 + qq * t0, pq * r1 + qq * t1, pq * r2 + qq * t2
        both = x0 * y0 + x1 * y1 + x2 * y2
        n0, n1, n2 = _times(
            a,
            b,
            c,
            d,
            f,
            g,
            h,
            u,
            j,
            other * (x1 * y2 - x2 * y1),
            other * (x2 * y0 - x0 * y2),
            other * (x0 * y1 - x1 * y0),
        )
        k00 += p0 * u0 + q0 * v0 + same * both
        k11 += p1 * u1 + q1 * v1 + same * both
        k22 += p2 * u2 + q2 * v2 + same * both
        k01 += p0 * u1 + q0 * v1 + n2
        k12 += p1 * u2 + q1 * v2 + n0
        k20 += p2 * u0 + q2 * v0 + n1
        k10 += p1 * u0 + q1 * v0 - n2
        k21 += p2 * u1 + q2 * v1 - n0
        k02 += p0 * u2 + q0 * v2 - n1
        if TWO:
            xx, xy, xz = a * a + d * d + h * h, a * b + d * f + h * u, a * c + d * g + h * j
            yy, yz, zz = b * b + f * f + u * u, b * c + f * g + u * j, c * c + g * g + j * j
            e0, e1, e2 = _times(xx, xy, xz, xy, yy, yz, xz, yz, zz, x0, x1, x2)
            z0, z1, z2 = _times(xx, xy, xz, xy, yy, yz, xz, yz, zz, y0, y1, y2)
            less = w2 * (x0 * z0 + x1 * z1 + x2 * z2)
            e0, e1, e2 = _times(a, b, c, d, f, g, h, u, j, e0, e1, e2)
            z0, z1, z2 = _times(a, b, c, d, f, g, h, u, j, z0, z1, z2)
            # half the slope of I2, and products of rows of F
            e0, e1, e2 = 2 * s23 * (I1 * p0 - e0), 2 * s23 * (I1 * p1 - e1), 2 * s23 * (I1 * p2 - e2)
            z0, z1, z2 = 2 * s23 * (I1 * r0 - z0), 2 * s23 * (I1 * r1 - z1), 2 * s23 * (I1 * r2 - z2)
            both, p0, p1, p2 = w2 * both, w2 * p0, w2 * p1, w2 * p2
            f01, f02, f12 = a * d + b * f + c * g, a * h + b * u + c * j, d * h + f * u + g * j
            k00 += e0 * t0 + q0 * z0 - less - (a * a + b * b + c * c) * both - r0 * p0
            k11 += e1 * t1 + q1 * z1 - less - (d * d + f * f + g * g) * both - r1 * p1
            k22 += e2 * t2 + q2 * z2 - less - (h * h + u * u + j * j) * both - r2 * p2
            k01 += e0 * t1 + q0 * z1 - f01 * both - r0 * p1
            k10 += e1 * t0 + q1 * z0 - f01 * both - r1 * p0
            k02 += e0 * t2 + q0 * z2 - f02 * both - r0 * p2
            k20 += e2 * t0 + q2 * z0 - f02 * both - r2 * p0
            k12 += e1 * t2 + q1 * z2 - f12 * both - r1 * p2
            k21 += e2 * t1 + q2 * z1 - f12 * both - r2 * p1
    s0, s1, s2 = sr0 * dilatation.to(tl.float32), sr1 * dilatation.to(tl.float32), sr2 * dilatation.to(tl.float32)
    out = K + 576 * own + 72 * m[:, None] + 3 * m[None, :]
    tl.store(out, k00 + s0 * sc0)
    tl.store(out + 1, k01 + s0 * sc1)
    tl.store(out + 2, k02 + s0 * sc2)
    tl.store(out + 24, k10 + s1 * sc0)
    tl.store(out + 25, k11 + s1 * sc1)
    tl.store(out + 26, k12 + s1 * sc2)
    tl.store(out + 48, k20 + s2 * sc0)
    tl.store(out + 49, k21 + s2 * sc1)
    tl.store(out + 50, k22 + s2 * sc2)


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
