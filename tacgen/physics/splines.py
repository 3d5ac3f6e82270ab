"""A signed distance as a cubic B-spline on a regular grid; see geometry.sdf_grid."""

import warp as wp

from tacgen.physics.types import HALF, Reals, Reals2, real

# numbers of a field in its row of `shapes`: its nodes along each axis, the first node's position [mm], the side of a
# cell [mm], and where its coefficients begin in `values`
NODES, ORIGIN, CELL, COEFFICIENTS = (wp.constant(k) for k in (1, 4, 7, 8))
SIXTH, TWO_THIRDS_OF_ONE = wp.constant(real(1.0 / 6.0)), wp.constant(real(2.0 / 3.0))
THREE_HALVES = wp.constant(real(1.5))


@wp.struct
class Distance:
    """A signed distance, its gradient and its Hessian."""

    d: real
    n: wp.vec3d
    H: wp.mat33d


@wp.func
def weights(t: real) -> tuple[wp.vec4d, wp.vec4d, wp.vec4d]:
    """Weights of the four nodes around a point at t in its cell: for values, slopes and curvatures."""
    s = real(1.0) - t
    value = wp.vec4d(
        s * s * s * SIXTH,
        TWO_THIRDS_OF_ONE - t * t + HALF * t * t * t,
        TWO_THIRDS_OF_ONE - s * s + HALF * s * s * s,
        t * t * t * SIXTH,
    )
    slope = wp.vec4d(
        -HALF * s * s,
        real(-2.0) * t + THREE_HALVES * t * t,
        real(2.0) * s - THREE_HALVES * s * s,
        HALF * t * t,
    )
    return value, slope, wp.vec4d(s, real(3.0) * t - real(2.0), real(3.0) * s - real(2.0), t)


@wp.func
def place(shapes: Reals2, s: int, p: wp.vec3d) -> wp.vec3d:
    """A point in cells from the first node."""
    origin = wp.vec3d(shapes[s, ORIGIN], shapes[s, ORIGIN + 1], shapes[s, ORIGIN + 2])
    return (p - origin) / shapes[s, CELL]


@wp.func
def steps(shapes: Reals2, s: int) -> tuple[int, int]:
    """From one node's number to those of the next along the first and the second axis; along the third it is 1."""
    row = int(shapes[s, NODES + 2])
    return int(shapes[s, NODES + 1]) * row, row


@wp.func
def spline(shapes: Reals2, values: Reals, s: int, p: wp.vec3d) -> Distance:
    """The distance at p; outside the grid a lower bound, and not a number where p is none."""
    out = Distance()
    at = place(shapes, s, p)
    cell = shapes[s, CELL]
    inner, away = wp.vec3d(), wp.vec3d()
    first = wp.vec3i()
    for a in range(3):
        count = shapes[s, NODES + a]
        x = wp.where(wp.isfinite(at[a]), at[a], real(1.0))
        x = wp.clamp(x, real(1.0), count - real(2.0))  # each point needs a node on both sides of its cell
        away[a] = (at[a] - x) * cell
        first[a] = wp.min(int(x), int(count) - 3)
        inner[a] = x - real(first[a])
    u0, u1, u2 = weights(inner[0])
    v0, v1, v2 = weights(inner[1])
    w0, w1, w2 = weights(inner[2])
    plane, row = steps(shapes, s)
    start = int(shapes[s, COEFFICIENTS]) + (first[0] - 1) * plane + (first[1] - 1) * row + first[2] - 1
    d, gx, gy, gz = real(0.0), real(0.0), real(0.0), real(0.0)
    xx, yy, zz = real(0.0), real(0.0), real(0.0)
    xy, xz, yz = real(0.0), real(0.0), real(0.0)
    for a in range(4):
        p00, p10, p01 = real(0.0), real(0.0), real(0.0)  # derivatives in y and z
        p20, p02, p11 = real(0.0), real(0.0), real(0.0)
        for b in range(4):
            i = start + a * plane + b * row
            c = wp.vec4d(values[i], values[i + 1], values[i + 2], values[i + 3])
            q0, q1, q2 = wp.dot(w0, c), wp.dot(w1, c), wp.dot(w2, c)
            p00 += v0[b] * q0
            p01 += v0[b] * q1
            p02 += v0[b] * q2
            p10 += v1[b] * q0
            p11 += v1[b] * q1
            p20 += v2[b] * q0
        d += u0[a] * p00
        gx += u1[a] * p00
        gy += u0[a] * p10
        gz += u0[a] * p01
        xx += u2[a] * p00
        yy += u0[a] * p20
        zz += u0[a] * p02
        xy += u1[a] * p10
        xz += u1[a] * p01
        yz += u0[a] * p11
    out.d = d
    out.n = wp.vec3d(gx, gy, gz) / cell
    outside = wp.dot(away, away)
    if outside == real(0.0):
        out.H = wp.mat33d(xx, xy, xz, xy, yy, yz, xz, yz, zz) / (cell * cell)
    elif not outside > real(0.0):
        out.d = outside
    elif d > real(0.0):  # the body is inside the grid, so this is a lower bound of its distance
        out.d = wp.sqrt(d * d + outside)
        for a in range(3):
            out.n[a] = wp.where(away[a] != real(0.0), away[a], d * out.n[a]) / out.d
    return out
