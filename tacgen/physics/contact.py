"""Contact and Coulomb friction at quadrature points of facets, of many scenes; see mechanics.barrier and coupled.

Arrays have the scene first: positions (s, n), facets conn (s, f, a), points (s, f, q) with shape functions N (q, a) and
areas [mm^2], 0 where a facet does not exist. An indenter is as in physics.distances, with its pose in the sensor's
frame: rotation (s,) and position (s,).
"""

import warp as wp

from tacgen.physics.assembly import point
from tacgen.physics.distances import signed_distance
from tacgen.physics.types import (
    ONE,
    TWO,
    ZERO,
    Flags3,
    Ints,
    Ints3,
    Matrices,
    Matrices3,
    Reals,
    Reals2,
    Reals3,
    Vectors,
    Vectors2,
    Vectors3,
    real,
)

# gap over dhat below which the barrier is a parabola, so that Newton can start from an overlap [-]
PARABOLA_GAP_RATIO = 0.5
ABSENT_GAP_MM = 1e9  # gap of facets that do not exist [mm]
# depth over the indenter's reach [-] beyond which a point has tunnelled, anywhere in its step
MAX_DEPTH_PER_REACH = 0.75
# -cos of the angle between the outward normals at entry and later [-]: beyond it a point has tunnelled
MIN_OPPOSED_COSINE = 0.25
MIN_SLOPE = 1e-12  # of a distance and of a slip over eps [-], below which a division would overflow
PARABOLA = wp.constant(real(PARABOLA_GAP_RATIO))
ABSENT = wp.constant(real(ABSENT_GAP_MM))
DEEP = wp.constant(real(MAX_DEPTH_PER_REACH))
OPPOSED = wp.constant(real(MIN_OPPOSED_COSINE))
LEAST_SLOPE = wp.constant(real(MIN_SLOPE))
THREE = wp.constant(real(3.0))


@wp.func
def barrier(d: real, dhat: real) -> wp.vec3d:
    """Barrier [mm], its slope [-] and curvature [1/mm] at a gap d [mm]; see mechanics.barrier.barrier."""
    s = d / dhat
    if s >= ONE:
        return wp.vec3d()
    t = wp.max(s, PARABOLA)
    r, ln = ONE - t, wp.log(t)
    part = r / t
    b, db, ddb = -r * r * ln, r * (TWO * ln - part), part * (real(4.0) + part) - TWO * ln
    below = s - t
    return wp.vec3d(dhat * (b + below * (db + ddb / TWO * below)), db + ddb * below, ddb / dhat)


@wp.func
def smooth(u: real, eps: real) -> wp.vec3d:
    """f0 [mm], f0'/u [1/mm] and (f0'' - f0'/u)/u^2 [1/mm^3] at a slip length u [mm]; see mechanics.coupled.smooth."""
    if u < eps:
        return wp.vec3d(
            u * u * (eps - u / THREE) / (eps * eps),
            (TWO - u / eps) / eps,
            -ONE / (eps * eps * wp.max(u, LEAST_SLOPE * eps)),
        )
    return wp.vec3d(u - eps / THREE, ONE / u, -ONE / (u * u * u))


@wp.func
def across(v: wp.vec3d, n: wp.vec3d) -> wp.vec3d:
    """The part of a vector across a unit vector."""
    return v - wp.dot(v, n) * n


@wp.kernel(enable_backward=False, module="tacgen.physics")
def barriers(d: Reals, dhat: real, out: Vectors):
    k = wp.tid()
    out[k] = barrier(d[k], dhat)


@wp.kernel(enable_backward=False, module="tacgen.physics")
def slips(u: Reals, eps: real, out: Vectors):
    """`smooth` at slip lengths u."""
    k = wp.tid()
    out[k] = smooth(u[k], eps)


@wp.kernel(enable_backward=False, module="tacgen.physics")
def gaps(
    x: Vectors2, conn: Ints3, N: Reals2, areas: Reals3, rotation: Matrices, position: Vectors, shapes: Reals2,
    values: Reals, lists: Ints, at: Vectors3, d: Reals3, n: Vectors3, H: Matrices3,
):  # fmt: skip
    """Points `at` (s, f, q), their distances d from the indenters [mm], gradients n and Hessians H [1/mm] in the
    sensor's frame; without rows in H, n and `at` the distances alone."""
    s, f, q = wp.tid()
    R = rotation[s]
    here = point(x, conn, N, s, f, q)
    bends = H.shape[0] > 0
    found = signed_distance(shapes, values, lists, s, wp.transpose(R) * (here - position[s]), bends)
    d[s, f, q] = wp.where(areas[s, f, q] > ZERO, found.d, ABSENT)
    if bends:
        at[s, f, q] = here
        n[s, f, q] = R * found.n
        H[s, f, q] = R * found.H * wp.transpose(R)


@wp.kernel(enable_backward=False, module="tacgen.physics")
def forces(
    at: Vectors3, d: Reals3, g: Vectors3, H: Matrices3, areas: Reals3, kappa: Reals, dhat: Reals, offset: Reals,
    friction: Reals, eps: Reals, anchor: Vectors3, gap: Reals3, normal: Vectors3, N: Reals3, force: Vectors3,
    tangent: Matrices3, definite: Matrices3,
):  # fmt: skip
    """The parts of mechanics.coupled.ContactForces at points with distance d, its gradient g and Hessian H.

    At points that overlap, which no solution has, the tangents omit the rotation of the normal: there, at the start of
    Newton's method, N is far too large.
    """
    s, f, q = wp.tid()
    weight, mu, slope = kappa[s] * areas[s, f, q], friction[s], g[s, f, q]
    size = wp.max(wp.length(slope), LEAST_SLOPE)
    n = slope / size
    space = d[s, f, q] + offset[s]
    b = barrier(space, dhat[s])
    push = -weight * b[1] * size
    gap[s, f, q] = space
    normal[s, f, q] = n
    N[s, f, q] = push
    if b[1] == ZERO:
        force[s, f, q] = wp.vec3d()
        tangent[s, f, q] = wp.mat33d()
        definite[s, f, q] = wp.mat33d()
        return
    bent = wp.where(space < ZERO, wp.mat33d(), H[s, f, q])
    D = weight * b[2] * wp.outer(slope, slope)
    S = D
    D += weight * b[1] * bent
    pull = push * n
    if mu != ZERO:
        away = at[s, f, q] - anchor[s, f, q]
        lever = wp.dot(away, n)
        t = away - lever * n
        f0 = smooth(wp.length(t), eps[s])
        flat = wp.identity(n=3, dtype=real) - wp.outer(n, n)
        Hn = bent * n
        S += mu * push * (f0[1] * flat + f0[2] * wp.outer(t, t))
        # dt/dx: the normal depends on the position on the indenter, dn/dx = (1 - n n^T) H/|g|
        P = flat - lever / size * (bent - wp.outer(n, Hn)) - wp.outer(n, bent * t) / size
        pull -= mu * push * f0[1] * t
        dN = -weight * (b[2] * size * slope + b[1] * Hn)
        D += mu * (push * (f0[1] * P + f0[2] * wp.outer(t, wp.transpose(P) * t)) + f0[1] * wp.outer(t, dN))
    force[s, f, q] = pull
    tangent[s, f, q] = D
    definite[s, f, q] = S


@wp.kernel(enable_backward=False, module="tacgen.physics")
def merits(
    x: Vectors2, step: Vectors2, fractions: Reals2, conn: Ints3, shape_values: Reals2, areas: Reals3,
    rotation: Matrices, position: Vectors, shapes: Reals2, values: Reals, lists: Ints, kappa: Reals, dhat: Reals,
    offset: Reals, friction: Reals, eps: Reals, anchor: Vectors3, normal: Vectors3, N: Reals3, energy: Reals3,
):  # fmt: skip
    """Energies (s, t, f q) [N mm] of the barrier, and of friction with these normal forces N and normals, at the points
    of x + fraction step."""
    s, t, k = wp.tid()
    count = areas.shape[2]
    f, q = k // count, k % count
    at = point(x, conn, shape_values, s, f, q)
    if step.shape[0] > 0:
        at += fractions[s, t] * point(step, conn, shape_values, s, f, q)
    area = areas[s, f, q]
    if area <= ZERO:
        energy[s, t, k] = ZERO
        return
    local = wp.transpose(rotation[s]) * (at - position[s])
    found = signed_distance(shapes, values, lists, s, local, False)
    total = kappa[s] * area * barrier(found.d + offset[s], dhat[s])[0]
    if friction[s] != ZERO and N[s, f, q] != ZERO:
        slip = across(at - anchor[s, f, q], normal[s, f, q])
        total += friction[s] * N[s, f, q] * smooth(wp.length(slip), eps[s])[0]
    energy[s, t, k] = total


@wp.kernel(enable_backward=False, module="tacgen.physics")
def ways(
    before: Vectors2, x: Vectors2, conn: Ints3, N: Reals2, areas: Reals3, was_rotation: Matrices, was_position: Vectors,
    rotation: Matrices, position: Vectors, gap: Reals3, start: Vectors3, step: Vectors3, length: Reals3,
):  # fmt: skip
    """Points (s, f, q) in the indenter's frame at its pose before, the way of each to where it is now in that frame,
    and the way's length [mm], 0 where it is not longer than the gap before: such a point cannot have touched."""
    s, f, q = wp.tid()
    begin = wp.transpose(was_rotation[s]) * (point(before, conn, N, s, f, q) - was_position[s])
    end = wp.transpose(rotation[s]) * (point(x, conn, N, s, f, q) - position[s])
    way = wp.length(end - begin)
    near = way > wp.max(gap[s, f, q], ZERO) and areas[s, f, q] > ZERO
    start[s, f, q] = begin
    step[s, f, q] = end - begin
    length[s, f, q] = wp.where(near, way, ZERO)


@wp.kernel(enable_backward=False, module="tacgen.physics")
def blocked(
    start: Vectors3, step: Vectors3, length: Reals3, parts: Reals, reach: Reals, offset: Reals, shapes: Reals2,
    values: Reals, lists: Ints, through: Flags3,
):  # fmt: skip
    """Whether points (s, f, q) pass through the indenter on their `ways`, which are looked at in so many parts (s,);
    see mechanics.tunnelling.blocked."""
    s, f, q = wp.tid()
    out, entered, entry = bool(False), bool(False), wp.vec3d()
    if length[s, f, q] > ZERO:
        for k in range(int(parts[s]) + 1):
            at = start[s, f, q] + real(k) / parts[s] * step[s, f, q]
            found = signed_distance(shapes, values, lists, s, at, False)
            inside = found.d + offset[s] < ZERO
            if inside and not entered:
                entry = found.n
            turned = (inside or entered) and wp.dot(entry, found.n) < -OPPOSED
            out = out or turned or found.d < -DEEP * reach[s]
            entered = inside
            if out:
                break
    through[s, f, q] = out
