"""Signed distances of the indenters of many scenes in one launch, by Triton; imported only where there is a GPU.

The formulas, and the names in them, are those of geometry.analytic_sdf and sdf_grid. A program takes points of one
scene, so that its kind of indenter is a real branch.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

POINTS_PER_PROGRAM = 128  # of a program


@triton.jit
def _sign(v):
    return tl.where(v >= 0, v * 0 + 1, v * 0 - 1)


@triton.jit
def _clamp(v, low, high):
    return tl.minimum(tl.maximum(v, low), high)


@triton.jit
def _node(number, a, b, c, d):
    """The weight of one of four nodes."""
    return tl.where(number == 0, a, tl.where(number == 1, b, tl.where(number == 2, c, d)))


@triton.jit
def _weights(t):
    """B-spline weights of the four nodes around points at t in their cells: values, slopes, curvatures."""
    s = 1 - t
    a, d = s * s * s / 6, t * t * t / 6
    b, c = (4 - 6 * t * t + 3 * t * t * t) / 6, (4 - 6 * s * s + 3 * s * s * s) / 6
    slope_b, slope_c = -2 * t + 1.5 * t * t, 2 * s - 1.5 * s * s
    return a, b, c, d, -(s * s) / 2, slope_b, slope_c, t * t / 2, s, 3 * t - 2, 3 * s - 2, t


@triton.jit
def _along(at, count, origin, cell):
    """Along one axis the first of four nodes, the place between the middle ones, and how far outside it is."""
    place = (at - origin) / cell
    inner = tl.minimum(tl.maximum(tl.where(place == place, place, 1.0), 1.0), count - 2)
    index = tl.minimum(inner.to(tl.int64), count.to(tl.int64) - 3)
    return index - 1, inner - index, (place - inner) * cell


@triton.jit
def signed_distance(x, y, z, kind, table, VALUES):
    """d, its gradient, and its second derivatives xx yy zz xy xz yz at points in the indenter's frame; kind: its number
    in scope.SUPPORTED_SHAPES; table: its row."""
    t0, t1, t2 = tl.load(table), tl.load(table + 1), tl.load(table + 2)
    zero = x * 0
    one = zero + 1
    d, gx, gy, gz, xx, yy, zz, xy, xz, yz = zero, zero, zero, zero, zero, zero, zero, zero, zero, zero
    if kind == 7:
        t3, ox, oy = tl.load(table + 3), tl.load(table + 4), tl.load(table + 5)
        oz, cell = tl.load(table + 6), tl.load(table + 7)
        i, u, ax = _along(x, t1, ox, cell)
        j, v, ay = _along(y, t2, oy, cell)
        first, w, az = _along(z, t3, oz, cell)
        rows, planes = t3.to(tl.int64), (t2 * t3).to(tl.int64)
        first += VALUES + t0.to(tl.int64) + i * planes + j * rows
        va, vb, vc, vd, sa, sb, sc, sd, ba, bb, bc, bd = _weights(u)
        wa, wb, wc, wd, ta, tb, tc, td, ca, cb, cc, cd = _weights(v)
        xa, xb, xc, xd, ya, yb, yc, yd, za, zb, zc, zd = _weights(w)
        for a in range(4):
            p00, p10, p01, p20, p02, p11 = zero, zero, zero, zero, zero, zero  # derivatives in y and z
            for b in range(4):
                line = first + a * planes + b * rows
                c0, c1, c2, c3 = tl.load(line), tl.load(line + 1), tl.load(line + 2), tl.load(line + 3)
                q0 = xa * c0 + xb * c1 + xc * c2 + xd * c3
                q1 = ya * c0 + yb * c1 + yc * c2 + yd * c3
                q2 = za * c0 + zb * c1 + zc * c2 + zd * c3
                value, slope = _node(b, wa, wb, wc, wd), _node(b, ta, tb, tc, td)
                p00 += value * q0
                p01 += value * q1
                p02 += value * q2
                p10 += slope * q0
                p11 += slope * q1
                p20 += _node(b, ca, cb, cc, cd) * q0
            value, slope, bend = _node(a, va, vb, vc, vd), _node(a, sa, sb, sc, sd), _node(a, ba, bb, bc, bd)
            d += value * p00
            gx += slope * p00
            gy += value * p10
            gz += value * p01
            xx += bend * p00
            yy += value * p20
            zz += value * p02
            xy += slope * p10
            xz += slope * p01
            yz += value * p11
        gx, gy, gz, square = gx / cell, gy / cell, gz / cell, cell * cell
        outside = ax * ax + ay * ay + az * az
        near = outside == 0  # elsewhere a lower bound; not a number stays so
        beyond = (outside != 0) & (d > 0)
        reach = tl.sqrt(d * d + outside)
        safe = tl.maximum(reach, 1e-300)
        gx = tl.where(beyond, tl.where(ax != 0, ax, d * gx) / safe, gx)
        gy = tl.where(beyond, tl.where(ay != 0, ay, d * gy) / safe, gy)
        gz = tl.where(beyond, tl.where(az != 0, az, d * gz) / safe, gz)
        d = tl.where(outside == outside, tl.where(beyond, reach, d), outside)
        xx, yy, zz = (
            tl.where(near, xx / square, 0.0),
            tl.where(near, yy / square, 0.0),
            tl.where(near, zz / square, 0.0),
        )
        xy, xz, yz = (
            tl.where(near, xy / square, 0.0),
            tl.where(near, xz / square, 0.0),
            tl.where(near, yz / square, 0.0),
        )
    else:
        # the closest point of the core and its derivatives J, the depth in the core and the direction out, the radius
        cx, cy, cz, jxx, jyy, jzz, jxy, jxz, jyz = zero, zero, zero, zero, zero, zero, zero, zero, zero
        depth, nx, ny, nz, radius = zero, zero, zero, zero - 1, t0
        rho = tl.sqrt(x * x + y * y)
        on_axis = rho < 1e-12
        c, s = (
            tl.where(on_axis, 1.0, x / tl.where(on_axis, 1.0, rho)),
            tl.where(on_axis, 0.0, y / tl.where(on_axis, 1.0, rho)),
        )
        around = tl.maximum(rho, 1e-12)
        if kind == 0:  # sphere
            cz = zero + t0
        elif kind == 1:  # capsule
            cx, cz, jxx = _clamp(x, -t1 / 2, t1 / 2), zero + t0, tl.where(tl.abs(x) < t1 / 2, one, zero)
        elif kind == 2:  # torus
            radius = t1
            cx, cy, cz, part = t0 * c, t0 * s, zero + t1, t0 / around
            jxx, jyy, jxy = part * s * s, part * c * c, -part * s * c
        elif kind == 3:  # cylinder
            radius = t1
            rim = t0 - t1
            near_rim, part, full = (
                tl.minimum(rho, rim),
                tl.where(rho > rim, rim / around, 1.0),
                tl.where(rho < rim, one, zero),
            )
            cx, cy, cz = near_rim * c, near_rim * s, tl.maximum(z, t1)
            jxx, jyy = part * s * s + full * c * c, part * c * c + full * s * s
            jxy, jzz = (full - part) * s * c, tl.where(z > t1, one, zero)
            below, beside = z - t1, rim - rho
            sideways = beside < below
            depth = tl.maximum(tl.minimum(below, beside), 0.0)
            nx, ny, nz = tl.where(sideways, c, zero), tl.where(sideways, s, zero), tl.where(sideways, zero, -one)
        elif kind == 4:  # box
            radius = t2
            hx, hy = t0 / 2 - t2, t1 / 2 - t2
            cx, cy, cz = _clamp(x, -hx, hx), _clamp(y, -hy, hy), tl.maximum(z, t2)
            jxx, jyy, jzz = tl.where(cx == x, one, zero), tl.where(cy == y, one, zero), tl.where(cz == z, one, zero)
            below, by_x, by_y = z - t2, hx - tl.abs(x), hy - tl.abs(y)
            to_x = by_x < below
            to_y = by_y < tl.minimum(below, by_x)
            depth = tl.maximum(tl.minimum(tl.minimum(below, by_x), by_y), 0.0)
            nx = tl.where(to_x & ~to_y, _sign(x), zero)
            ny = tl.where(to_y, _sign(y), zero)
            nz = tl.where(to_x | to_y, zero, -one)
        elif kind == 5:  # cone
            radius = t1
            si, co = tl.sin(t0), tl.cos(t0)
            up = z - t1
            along, outward = tl.maximum(rho * si + up * co, 0.0), rho * co - up * si
            side = along > 0
            cx, cy, cz = along * si * c, along * si * s, along * co + t1
            part, whole = tl.where(side, along * si / around, 0.0), tl.where(side, one, zero)
            jxx, jyy = whole * si * si * c * c + part * s * s, whole * si * si * s * s + part * c * c
            jxy, jzz = (whole * si * si - part) * s * c, whole * co * co
            jxz, jyz = whole * si * co * c, whole * si * co * s
            depth = tl.where(side & (outward < 0), -outward, zero)
            nx, ny = tl.where(side, c * co, zero), tl.where(side, s * co, zero)
            nz = tl.where(side, -si * one, -one)
        else:  # wedge
            radius = t1
            si, co, sign, up, half = tl.sin(t0), tl.cos(t0), _sign(x), z - t1, t2 / 2 - t1
            along, outward = tl.maximum(tl.abs(x) * si + up * co, 0.0), tl.abs(x) * co - up * si
            side = along > 0
            within = side & (outward < 0)
            cx, cy = tl.where(within, x, sign * along * si), _clamp(y, -half, half)
            cz = tl.where(within, z, along * co + t1)
            jxx = tl.where(within, 1.0, tl.where(side, one, zero) * si * si)
            jzz = tl.where(within, 1.0, tl.where(side, one, zero) * co * co)
            jxz = tl.where(within, 0.0, tl.where(side, one, zero) * sign * si * co)
            jyy = tl.where(tl.abs(y) < half, one, zero)
            by_side, by_end = tl.where(side, -outward, -one), half - tl.abs(y)
            endways = by_end < by_side
            depth = tl.maximum(tl.minimum(by_side, by_end), 0.0)
            nx, ny = tl.where(endways, zero, sign * co), tl.where(endways, _sign(y), zero)
            nz = tl.where(endways, zero, -si * one)
        vx, vy, vz = x - cx, y - cy, z - cz
        length = tl.sqrt(vx * vx + vy * vy + vz * vz)
        core = (depth > 0) | (length < 1e-12)
        safe = tl.where(core, 1.0, length)
        gx, gy, gz = tl.where(core, nx, vx / safe), tl.where(core, ny, vy / safe), tl.where(core, nz, vz / safe)
        d = tl.where(core, -depth, length) - radius
        curved = tl.where(~core, one, zero) / safe
        xx, yy, zz = (1 - jxx - gx * gx) * curved, (1 - jyy - gy * gy) * curved, (1 - jzz - gz * gz) * curved
        xy, xz, yz = (-jxy - gx * gy) * curved, (-jxz - gx * gz) * curved, (-jyz - gy * gz) * curved
    return d, gx, gy, gz, xx, yy, zz, xy, xz, yz


@triton.jit(do_not_specialize=("count",))
def _distances(P, KIND, TABLE, VALUES, D, G, H, count, SIZE: tl.constexpr):
    scene = tl.program_id(0)
    k = tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    inside = k < count
    at = scene.to(tl.int64) * count + k
    x = tl.load(P + 3 * at, mask=inside, other=0.0)
    y = tl.load(P + 3 * at + 1, mask=inside, other=0.0)
    z = tl.load(P + 3 * at + 2, mask=inside, other=1.0)
    d, gx, gy, gz, xx, yy, zz, xy, xz, yz = signed_distance(x, y, z, tl.load(KIND + scene), TABLE + 8 * scene, VALUES)
    tl.store(D + at, d, mask=inside)
    store_vector(G + 3 * at, gx, gy, gz, inside)
    store_vector(H + 9 * at, xx, xy, xz, inside)
    store_vector(H + 9 * at + 3, xy, yy, yz, inside)
    store_vector(H + 9 * at + 6, xz, yz, zz, inside)


@triton.jit
def store_vector(at, x, y, z, inside):
    """Store three numbers one after the other."""
    tl.store(at, x, mask=inside)
    tl.store(at + 1, y, mask=inside)
    tl.store(at + 2, z, mask=inside)


def distances(p: Tensor, kinds: Tensor, table: Tensor, values: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """As shapes.Shapes.distance, of points p (s, k, 3) and the parts of the shapes."""
    p, (s, k, _) = p.contiguous(), p.shape
    d, g, H = p.new_empty(s, k), torch.empty_like(p), p.new_empty(s, k, 3, 3)
    if d.numel():
        _distances[(s, triton.cdiv(k, POINTS_PER_PROGRAM))](
            p, kinds, table, values, d, g, H, k, SIZE=POINTS_PER_PROGRAM
        )
    return d, g, H
