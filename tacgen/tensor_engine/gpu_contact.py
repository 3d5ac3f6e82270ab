"""Contact and friction at the points of facets in one launch, by Triton; imported only where there is a GPU.

The formulas, and the names in them, are those of mechanics.coupled. A program takes points of one scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import triton
import triton.language as tl
from torch import Tensor

from tacgen.mechanics.barrier import PARABOLA_GAP_RATIO
from tacgen.mechanics.tunnelling import MAX_DEPTH_PER_REACH, MIN_OPPOSED_COSINE
from tacgen.tensor_engine.gpu_distance import POINTS_PER_PROGRAM, signed_distance, store_vector

if TYPE_CHECKING:
    from tacgen.tensor_engine.records import ContactArrays, Forces

TL_ABSENT_GAP_MM = tl.constexpr(1e9)  # gap of facets that do not exist [mm]
TL_PARABOLA_GAP_RATIO = tl.constexpr(PARABOLA_GAP_RATIO)
# no code of its own for each value that they may have
UNSPECIALIZED_CONTACT = ("count", "nodes", "apart", "q", "trials")


@triton.jit
def _point(X, CONN, N, scene, k, nodes, apart, q, inside):
    """The points number k (facet q + point) of nodes X."""
    x, y, z = 0.0, 0.0, 0.0
    for corner in tl.static_range(4):
        weight = tl.load(N + 4 * (k % q) + corner, mask=inside, other=0.0)
        node = tl.load(CONN + scene * apart + k // q * 4 + corner, mask=inside, other=0)
        at = X + 3 * (scene * nodes + node)
        x += weight * tl.load(at, mask=inside, other=0.0)
        y += weight * tl.load(at + 1, mask=inside, other=0.0)
        z += weight * tl.load(at + 2, mask=inside, other=0.0)
    return x, y, z


@triton.jit
def _local(x, y, z, r, position):
    """Points in the frame of an indenter at a pose."""
    x, y, z = x - tl.load(position), y - tl.load(position + 1), z - tl.load(position + 2)
    a = x * tl.load(r) + y * tl.load(r + 3) + z * tl.load(r + 6)
    b = x * tl.load(r + 1) + y * tl.load(r + 4) + z * tl.load(r + 7)
    return a, b, x * tl.load(r + 2) + y * tl.load(r + 5) + z * tl.load(r + 8)


@triton.jit
def _gap(x, y, z, scene, area, offset, R, POSITION, KIND, TABLE, VALUES):
    """The gap at points in the sensor's frame, and its derivatives in the indenter's."""
    lx, ly, lz = _local(x, y, z, R + 9 * scene, POSITION + 3 * scene)
    d, gx, gy, gz, xx, yy, zz, xy, xz, yz = signed_distance(
        lx, ly, lz, tl.load(KIND + scene), TABLE + 8 * scene, VALUES
    )
    return tl.where(area > 0, d + offset, TL_ABSENT_GAP_MM), gx, gy, gz, xx, yy, zz, xy, xz, yz


@triton.jit
def _turned(r, x, y, z):
    """A vector of the indenter's frame in the sensor's."""
    a = tl.load(r) * x + tl.load(r + 1) * y + tl.load(r + 2) * z
    b = tl.load(r + 3) * x + tl.load(r + 4) * y + tl.load(r + 5) * z
    c = tl.load(r + 6) * x + tl.load(r + 7) * y + tl.load(r + 8) * z
    return a, b, c


@triton.jit
def _barrier_slopes(d, dhat):
    s = d / dhat
    t = tl.minimum(tl.maximum(s, TL_PARABOLA_GAP_RATIO), 1.0)
    r, ln, below = 1 - t, tl.log(t), tl.minimum(s - TL_PARABOLA_GAP_RATIO, 0.0)
    part = r / t
    second = part * (4 + part) - 2 * ln
    return r * (2 * ln - part) + second * below, second / dhat


@triton.jit
def _dot(ax, ay, az, bx, by, bz):
    return ax * bx + ay * by + az * bz


@triton.jit
def _row(n, ex, ey, ez, nx, ny, nz, hx, hy, hz, sx, sy, sz, w, xx, xy, xz):
    """A row of what is across the normal, less how the normal turns; n its component, e that of the unit matrix."""
    x = ex - n * nx - w * (xx - n * hx) - n * sx
    y = ey - n * ny - w * (xy - n * hy) - n * sy
    z = ez - n * nz - w * (xz - n * hz) - n * sz
    return x, y, z


@triton.jit
def _store_row(at, stored, flat, g, gx, gy, gz, soft, hx, hy, hz, pull, px, py, pz, t, fx, fy, fz):
    """Store a row of a tangent; 0 where `flat`."""
    none = g * 0
    store_vector(at, none, none, none, flat)
    x, y = g * gx + soft * hx + pull * px + t * fx, g * gy + soft * hy + pull * py + t * fy
    store_vector(at, x, y, g * gz + soft * hz + pull * pz + t * fz, stored)


@triton.jit(do_not_specialize=UNSPECIALIZED_CONTACT)
def _forces(
    X, CONN, N, AREAS, R, POSITION, KIND, TABLE, VALUES, KAPPA, DHAT, OFFSET, MU, EPS, ANCHOR,
    GAP, AT, NORMAL, FORCE, PUSH, TANGENT, DEFINITE, count, nodes, apart, q, SIZE: tl.constexpr,
):  # fmt: skip
    scene = tl.program_id(0).to(tl.int64)
    k = tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    inside = k < count
    number = scene * count + k
    area = tl.load(AREAS + number, mask=inside, other=0.0)
    weight, dhat, offset = tl.load(KAPPA + scene) * area, tl.load(DHAT + scene), tl.load(OFFSET + scene)
    mu, eps = tl.load(MU + scene), tl.load(EPS + scene)
    x, y, z = _point(X, CONN, N, scene, k, nodes, apart, q, inside)
    d, gx, gy, gz, xx, yy, zz, xy, xz, yz = _gap(x, y, z, scene, area, offset, R, POSITION, KIND, TABLE, VALUES)
    r = R + 9 * scene
    gx, gy, gz = _turned(r, gx, gy, gz)
    size = tl.maximum(tl.sqrt(_dot(gx, gy, gz, gx, gy, gz)), 1e-12)
    nx, ny, nz = gx / size, gy / size, gz / size
    db, ddb = _barrier_slopes(d, dhat)
    force = -weight * db * size
    ux = x - tl.load(ANCHOR + 3 * number, mask=inside, other=0.0)
    uy = y - tl.load(ANCHOR + 3 * number + 1, mask=inside, other=0.0)
    uz = z - tl.load(ANCHOR + 3 * number + 2, mask=inside, other=0.0)
    un = _dot(ux, uy, uz, nx, ny, nz)
    tx, ty, tz = ux - un * nx, uy - un * ny, uz - un * nz
    length = tl.sqrt(_dot(tx, ty, tz, tx, ty, tz))
    slope = tl.where(length < eps, (2 - length / eps) / eps, 1 / tl.maximum(length, 1e-12 * eps))
    rub = mu * force
    tl.store(GAP + number, d, mask=inside)
    store_vector(AT + 3 * number, x, y, z, inside)
    store_vector(NORMAL + 3 * number, nx, ny, nz, inside)
    tl.store(FORCE + number, force, mask=inside)
    pull = rub * slope
    store_vector(PUSH + 3 * number, force * nx - pull * tx, force * ny - pull * ty, force * nz - pull * tz, inside)
    touching = db != 0
    curved = tl.where(d < 0, 0.0, 1.0)
    ax, ay, az = _turned(r, xx * curved, xy * curved, xz * curved)  # columns of R H
    bx, by, bz = _turned(r, xy * curved, yy * curved, yz * curved)
    cx, cy, cz = _turned(r, xz * curved, yz * curved, zz * curved)
    xx, xy, xz = _turned(r, ax, bx, cx)  # rows of R H R^T
    xy, yy, yz = _turned(r, ay, by, cy)
    xz, yz, zz = _turned(r, az, bz, cz)
    v = tl.maximum(length, 1e-12 * eps)
    bend = tl.where(length < eps, -1 / (eps * eps * v), -1 / (v * v * v))
    stiff, soft = weight * ddb, weight * db
    # across the normal, and how it turns
    hx, hy, hz = _dot(xx, xy, xz, nx, ny, nz), _dot(xy, yy, yz, nx, ny, nz), _dot(xz, yz, zz, nx, ny, nz)
    sx = _dot(xx, xy, xz, tx, ty, tz) / size
    sy = _dot(xy, yy, yz, tx, ty, tz) / size
    sz = _dot(xz, yz, zz, tx, ty, tz) / size
    w = un / size
    pxx, pxy, pxz = _row(nx, 1, 0, 0, nx, ny, nz, hx, hy, hz, sx, sy, sz, w, xx, xy, xz)
    pyx, pyy, pyz = _row(ny, 0, 1, 0, nx, ny, nz, hx, hy, hz, sx, sy, sz, w, xy, yy, yz)
    pzx, pzy, pzz = _row(nz, 0, 0, 1, nx, ny, nz, hx, hy, hz, sx, sy, sz, w, xz, yz, zz)
    qx, qy, qz = _dot(pxx, pyx, pzx, tx, ty, tz), _dot(pxy, pyy, pzy, tx, ty, tz), _dot(pxz, pyz, pzz, tx, ty, tz)
    # what multiplies t: rub bend P^T t + mu slope dN
    fx = rub * bend * qx - mu * slope * (stiff * size * gx + soft * hx)
    fy = rub * bend * qy - mu * slope * (stiff * size * gy + soft * hy)
    fz = rub * bend * qz - mu * slope * (stiff * size * gz + soft * hz)
    T, D, bent = TANGENT + 9 * number, DEFINITE + 9 * number, rub * bend
    stored, flat = inside & touching, inside & ~touching
    _store_row(T, stored, flat, stiff * gx, gx, gy, gz, soft, xx, xy, xz, pull, pxx, pxy, pxz, tx, fx, fy, fz)
    _store_row(T + 3, stored, flat, stiff * gy, gx, gy, gz, soft, xy, yy, yz, pull, pyx, pyy, pyz, ty, fx, fy, fz)
    _store_row(T + 6, stored, flat, stiff * gz, gx, gy, gz, soft, xz, yz, zz, pull, pzx, pzy, pzz, tz, fx, fy, fz)
    bx, by, bz = bent * tx, bent * ty, bent * tz
    ax, ay, az = 1 - nx * nx, -nx * ny, -nx * nz
    _store_row(D, stored, flat, stiff * gx, gx, gy, gz, 0, ax, ay, az, pull, ax, ay, az, tx, bx, by, bz)
    ax, ay, az = -ny * nx, 1 - ny * ny, -ny * nz
    _store_row(D + 3, stored, flat, stiff * gy, gx, gy, gz, 0, ax, ay, az, pull, ax, ay, az, ty, bx, by, bz)
    ax, ay, az = -nz * nx, -nz * ny, 1 - nz * nz
    _store_row(D + 6, stored, flat, stiff * gz, gx, gy, gz, 0, ax, ay, az, pull, ax, ay, az, tz, bx, by, bz)


@triton.jit(do_not_specialize=UNSPECIALIZED_CONTACT)
def _merits(
    X, STEP, FRACTIONS, CONN, N, AREAS, R, POSITION, KIND, TABLE, VALUES, KAPPA, DHAT, OFFSET, MU, EPS, ANCHOR,
    NORMAL, FORCE, OUT, count, nodes, apart, q, trials, SIZE: tl.constexpr,
):  # fmt: skip
    scene, trial = tl.program_id(0).to(tl.int64), tl.program_id(1)
    kappa, dhat, offset = tl.load(KAPPA + scene), tl.load(DHAT + scene), tl.load(OFFSET + scene)
    mu, eps, fraction = tl.load(MU + scene), tl.load(EPS + scene), tl.load(FRACTIONS + scene * trials + trial)
    k = tl.program_id(2) * SIZE + tl.arange(0, SIZE)
    inside = k < count
    number = scene * count + k
    area = tl.load(AREAS + number, mask=inside, other=0.0)
    x, y, z = _point(X, CONN, N, scene, k, nodes, apart, q, inside)
    px, py, pz = _point(STEP, CONN, N, scene, k, nodes, apart, q, inside)
    x, y, z = x + fraction * px, y + fraction * py, z + fraction * pz
    d, _, _, _, _, _, _, _, _, _ = _gap(x, y, z, scene, area, offset, R, POSITION, KIND, TABLE, VALUES)
    s = d / dhat
    t = tl.minimum(tl.maximum(s, TL_PARABOLA_GAP_RATIO), 1.0)
    r, ln, below = 1 - t, tl.log(t), tl.minimum(s - TL_PARABOLA_GAP_RATIO, 0.0)
    slope, second = 2 * r * ln - r * r / t, -2 * ln + 4 * r / t + (r / t) * (r / t)
    energy = kappa * area * dhat * (slope * below + second / 2 * below * below - r * r * ln)
    ux = x - tl.load(ANCHOR + 3 * number, mask=inside, other=0.0)
    uy = y - tl.load(ANCHOR + 3 * number + 1, mask=inside, other=0.0)
    uz = z - tl.load(ANCHOR + 3 * number + 2, mask=inside, other=0.0)
    nx = tl.load(NORMAL + 3 * number, mask=inside, other=0.0)
    ny = tl.load(NORMAL + 3 * number + 1, mask=inside, other=0.0)
    nz = tl.load(NORMAL + 3 * number + 2, mask=inside, other=0.0)
    un = _dot(ux, uy, uz, nx, ny, nz)
    ux, uy, uz = ux - un * nx, uy - un * ny, uz - un * nz
    u = tl.sqrt(_dot(ux, uy, uz, ux, uy, uz))
    slip = tl.where(u < eps, u * u * (eps - u / 3) / (eps * eps), u - eps / 3)
    force = tl.load(FORCE + number, mask=inside, other=0.0)
    total = tl.sum(tl.where(inside, energy + mu * force * slip, 0.0), 0)
    tl.store(OUT + (scene * trials + trial) * tl.num_programs(2) + tl.program_id(2), total)


@triton.jit
def _way(
    BEFORE, X, CONN, N, AREAS, R, POSITION, OLD_R, OLD_POSITION, GAPS, scene, k, count, nodes, apart, q, inside
):  # fmt: skip
    """Where points were in an indenter's frame, how they move in it, and whether they may come to touch."""
    x, y, z = _point(BEFORE, CONN, N, scene, k, nodes, apart, q, inside)
    x, y, z = _local(x, y, z, OLD_R + 9 * scene, OLD_POSITION + 3 * scene)
    tx, ty, tz = _point(X, CONN, N, scene, k, nodes, apart, q, inside)
    tx, ty, tz = _local(tx, ty, tz, R + 9 * scene, POSITION + 3 * scene)
    tx, ty, tz = tx - x, ty - y, tz - z
    length = tl.sqrt(_dot(tx, ty, tz, tx, ty, tz))
    near = length > tl.maximum(tl.load(GAPS + scene * count + k, mask=inside, other=0.0), 0.0)
    near = near & inside & (tl.load(AREAS + scene * count + k, mask=inside, other=0.0) > 0)
    return x, y, z, tx, ty, tz, near, tl.where(near, length, 0.0)


@triton.jit(do_not_specialize=UNSPECIALIZED_CONTACT)
def _parts_of_way(
    BEFORE, X, CONN, N, AREAS, R, POSITION, OLD_R, OLD_POSITION, GAPS, REACH, OUT, count, nodes, apart, q,
    SIZE: tl.constexpr,
):  # fmt: skip
    scene, longest, i = tl.program_id(0).to(tl.int64), tl.zeros((SIZE,), tl.float64), 0
    while i < count:
        k = i + tl.arange(0, SIZE)
        _, _, _, _, _, _, _, length = _way(
            BEFORE, X, CONN, N, AREAS, R, POSITION, OLD_R, OLD_POSITION, GAPS, scene, k, count, nodes, apart, q,
            k < count,
        )  # fmt: skip
        longest = tl.maximum(longest, length)
        i += SIZE
    tl.store(OUT + scene, tl.maximum(tl.ceil(4 * tl.max(longest, 0) / tl.load(REACH + scene)), 2.0))


@triton.jit(do_not_specialize=UNSPECIALIZED_CONTACT)
def _blocked(
    BEFORE, X, CONN, N, AREAS, R, POSITION, OLD_R, OLD_POSITION, GAPS, REACH, PARTS, OFFSET, KIND, TABLE, VALUES, OUT,
    count, nodes, apart, q, DEEP: tl.constexpr, TURNED: tl.constexpr, SIZE: tl.constexpr,
):  # fmt: skip
    scene, k = tl.program_id(0).to(tl.int64), tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    x, y, z, tx, ty, tz, near, length = _way(
        BEFORE, X, CONN, N, AREAS, R, POSITION, OLD_R, OLD_POSITION, GAPS, scene, k, count, nodes, apart, q, k < count,
    )  # fmt: skip
    through, entered, ex, ey, ez = 0 * k, 0 * k, 0 * x, 0 * x, 0 * x
    if tl.max(length, 0) > 0:
        parts, offset, deepest = tl.load(PARTS + scene), tl.load(OFFSET + scene), -DEEP * tl.load(REACH + scene)
        kind, done = tl.load(KIND + scene), 0.0
        while done <= parts:
            part = done / parts
            d, nx, ny, nz, _, _, _, _, _, _ = signed_distance(
                x + part * tx, y + part * ty, z + part * tz, kind, TABLE + 8 * scene, VALUES
            )
            inside = (d + offset < 0) & near
            new = inside & (entered == 0)
            ex, ey, ez = tl.where(new, nx, ex), tl.where(new, ny, ey), tl.where(new, nz, ez)
            turned = ((entered == 1) | inside) & (_dot(ex, ey, ez, nx, ny, nz) < -TURNED)
            through = tl.where(turned | (near & (d < deepest)), 1, through)
            entered = tl.where(inside, 1, 0)
            done += 1.0
    tl.store(OUT + scene * tl.num_programs(1) + tl.program_id(1), tl.max(through, 0) > 0)


def blocked(
    c: ContactArrays, before: Tensor, x: Tensor, rotation: Tensor, position: Tensor, gap: Tensor, reach: Tensor
) -> Tensor:
    """Whether a point passes through the indenter (s,) on the way from nodes `before` (s, n, 3), when its pose was
    another and the gap (s, f, q), to x; see load_step.blocked."""
    (s, f, q), n = c.areas.shape, x.shape[1]
    parts, blocks = reach.new_empty(s), triton.cdiv(f * q, POINTS_PER_PROGRAM)
    out = torch.empty(s, blocks, dtype=torch.bool, device=x.device)
    way = tuple(part.contiguous() for part in (c.N, c.areas, c.rotation, c.position, rotation, position, gap, reach))
    way, counts = (before.contiguous(), x.contiguous(), c.conn, *way), (f * q, n, c.conn.stride(0), q)
    _parts_of_way[(s,)](*way, parts, *counts, SIZE=512, num_warps=16)
    shape = c.shapes.kinds, c.shapes.table, c.shapes.values
    _blocked[(s, blocks)](
        *way,
        parts,
        c.offset,
        *shape,
        out,
        *counts,
        DEEP=MAX_DEPTH_PER_REACH,
        TURNED=MIN_OPPOSED_COSINE,
        SIZE=POINTS_PER_PROGRAM,
    )
    return out.any(1)


def _parts(c: ContactArrays) -> tuple[Tensor, ...]:
    """The parts of a contact that kernels take: facets, shape functions, areas, poses, shapes, numbers and anchors."""
    parts = (
        c.N, c.areas, c.rotation, c.position, c.shapes.kinds, c.shapes.table, c.shapes.values,
        c.kappa, c.dhat, c.offset, c.friction, c.eps, c.anchor,
    )  # fmt: skip
    return c.conn, *(part.contiguous() for part in parts)


@triton.jit(do_not_specialize=UNSPECIALIZED_CONTACT)
def _gaps(
    X, CONN, N, AREAS, R, POSITION, KIND, TABLE, VALUES, OFFSET, OUT, count, nodes, apart, q, SIZE: tl.constexpr
):  # fmt: skip
    scene, k = tl.program_id(0).to(tl.int64), tl.program_id(1) * SIZE + tl.arange(0, SIZE)
    inside = k < count
    area = tl.load(AREAS + scene * count + k, mask=inside, other=0.0)
    x, y, z = _point(X, CONN, N, scene, k, nodes, apart, q, inside)
    d, _, _, _, _, _, _, _, _, _ = _gap(x, y, z, scene, area, tl.load(OFFSET + scene), R, POSITION, KIND, TABLE, VALUES)
    tl.store(OUT + scene * count + k, d, mask=inside)


def gaps(c: ContactArrays, x: Tensor) -> Tensor:
    """contact.Contacts.gap_at_nodes."""
    (s, f, q), x = c.areas.shape, x.contiguous()
    out = x.new_empty(s, f, q)
    if f * q:
        conn, N, areas, *parts = _parts(c)
        counts = f * q, x.shape[1], c.conn.stride(0), q
        _gaps[(s, triton.cdiv(f * q, POINTS_PER_PROGRAM))](
            x, conn, N, areas, *parts[:5], c.offset, out, *counts, SIZE=POINTS_PER_PROGRAM
        )
    return out


def forces(c: ContactArrays, x: Tensor) -> tuple[Tensor, ...]:
    """The parts of contact.Forces with tangents at nodes x (s, n, 3)."""
    (s, f, q), x = c.areas.shape, x.contiguous()
    shapes = ((), (3,), (3,), (), (3,), (3, 3), (3, 3))
    out = tuple(x.new_empty(s, f, q, *shape) for shape in shapes)
    if f * q:
        counts = f * q, x.shape[1], c.conn.stride(0), q
        _forces[(s, triton.cdiv(f * q, POINTS_PER_PROGRAM))](x, *_parts(c), *out, *counts, SIZE=POINTS_PER_PROGRAM)
    return out


def merits(c: ContactArrays, x: Tensor, p: Tensor, fractions: Tensor, frozen: Forces) -> Tensor:
    """contact.Contacts.merits."""
    (s, f, q), x, p, trials = c.areas.shape, x.contiguous(), p.contiguous(), fractions.shape[1]
    blocks = triton.cdiv(f * q, POINTS_PER_PROGRAM)
    out, given = x.new_empty(s, trials, blocks), (frozen.normal.contiguous(), frozen.N.contiguous())
    if out.numel():
        counts = f * q, x.shape[1], c.conn.stride(0), q, trials
        _merits[(s, trials, blocks)](
            x, p, fractions.contiguous(), *_parts(c), *given, out, *counts, SIZE=POINTS_PER_PROGRAM
        )
    return out.sum(-1)
