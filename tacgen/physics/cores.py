"""The closest points of the cores of analytic indenters; see geometry.analytic_sdf, which names the numbers of each.

`shapes` (s, k): a row of numbers for each indenter, from FIRST_NUMBER on those of its shape.
"""

from enum import IntEnum

import warp as wp

from tacgen.physics.types import Reals2, real

FIRST_NUMBER = 1  # of a row of `shapes`; before it the number of the shape
SMALLEST_LENGTH_MM = 1e-12  # length [mm] below which the direction of a vector is rounding error
A, B, C = (wp.constant(FIRST_NUMBER + k) for k in range(3))
TINY = wp.constant(real(SMALLEST_LENGTH_MM))
DOWNWARD = wp.constant(wp.vec3d(0.0, 0.0, -1.0))


class ShapeNumber(IntEnum):
    """The number of a shape, by the name of its core in geometry.analytic_sdf; `field` is a spline on a grid."""

    field = 0
    sphere = 1
    capsule = 2
    torus = 3
    cylinder = 4
    box = 5
    cone = 6
    wedge = 7


@wp.struct
class Core:
    """Closest core point to p, its derivative J, depth in the core >= 0 and the direction out of it, and the radius.

    A core that is a point or a line has no interior: on it the direction out is down.
    """

    closest: wp.vec3d
    J: wp.mat33d
    depth: real
    out: wp.vec3d
    radius: real


@wp.func
def polar(p: wp.vec3d) -> tuple[real, wp.vec3d, wp.vec3d]:
    """Distance from the z axis, radial and azimuthal unit vectors; on the axis those of x and y."""
    rho = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    c, s = real(1.0), real(0.0)
    if rho >= TINY:
        c = p[0] / rho
        s = p[1] / rho
    return rho, wp.vec3d(c, s, real(0.0)), wp.vec3d(-s, c, real(0.0))


@wp.func
def one_if(is_so: bool) -> real:
    return wp.where(is_so, real(1.0), real(0.0))


@wp.func
def sign(v: real) -> real:
    return wp.where(v >= real(0.0), real(1.0), real(-1.0))


@wp.func
def sphere(shapes: Reals2, s: int, p: wp.vec3d) -> Core:
    core = Core()
    core.radius = shapes[s, A]
    core.closest = wp.vec3d(real(0.0), real(0.0), core.radius)
    core.out = DOWNWARD
    return core


@wp.func
def capsule(shapes: Reals2, s: int, p: wp.vec3d) -> Core:
    core = Core()
    core.radius = shapes[s, A]
    half = shapes[s, B] / real(2.0)
    core.closest = wp.vec3d(wp.clamp(p[0], -half, half), real(0.0), core.radius)
    core.J[0, 0] = one_if(wp.abs(p[0]) < half)
    core.out = DOWNWARD
    return core


@wp.func
def torus(shapes: Reals2, s: int, p: wp.vec3d) -> Core:
    core = Core()
    core.radius = shapes[s, B]
    rho, radial, azimuth = polar(p)
    core.closest = shapes[s, A] * radial
    core.closest[2] = core.radius
    core.J = shapes[s, A] / wp.max(rho, TINY) * wp.outer(azimuth, azimuth)
    core.out = DOWNWARD
    return core


@wp.func
def cylinder(shapes: Reals2, s: int, p: wp.vec3d) -> Core:
    core = Core()
    core.radius = shapes[s, B]
    rho, radial, azimuth = polar(p)
    low, top, rim = core.radius, shapes[s, C] - core.radius, shapes[s, A] - core.radius
    core.closest = wp.min(rho, rim) * radial
    core.closest[2] = wp.clamp(p[2], low, top)
    turning = wp.where(rho > rim, rim / wp.max(rho, TINY), real(1.0))
    core.J = turning * wp.outer(azimuth, azimuth) + one_if(rho < rim) * wp.outer(radial, radial)
    core.J[2, 2] = one_if(core.closest[2] == p[2])
    below, above, beside = p[2] - low, top - p[2], rim - rho
    core.depth = wp.max(wp.min(wp.min(below, above), beside), real(0.0))
    core.out = wp.where(below <= beside, DOWNWARD, radial)
    if above < below and above < beside:
        core.out = -DOWNWARD
    return core


@wp.func
def box(shapes: Reals2, s: int, p: wp.vec3d) -> Core:
    core = Core()
    core.radius = shapes[s, C]
    x, y = shapes[s, A] / real(2.0) - core.radius, shapes[s, B] / real(2.0) - core.radius
    core.closest = wp.vec3d(wp.clamp(p[0], -x, x), wp.clamp(p[1], -y, y), wp.max(p[2], core.radius))
    for k in range(3):
        core.J[k, k] = one_if(core.closest[k] == p[k])
    below, by_x, by_y = p[2] - core.radius, x - wp.abs(p[0]), y - wp.abs(p[1])
    core.depth = wp.max(wp.min(below, wp.min(by_x, by_y)), real(0.0))
    core.out = DOWNWARD
    if by_x < below or by_y < below:
        core.out = wp.vec3d(sign(p[0]), real(0.0), real(0.0))
        if by_y < by_x:
            core.out = wp.vec3d(real(0.0), sign(p[1]), real(0.0))
    return core


@wp.func
def cone(shapes: Reals2, s: int, p: wp.vec3d) -> Core:
    core = Core()
    core.radius = shapes[s, B]
    rho, radial, azimuth = polar(p)
    si, co, z = wp.sin(shapes[s, A]), wp.cos(shapes[s, A]), p[2] - core.radius
    along, outward = wp.max(rho * si + z * co, real(0.0)), rho * co - z * si
    core.closest = along * si * radial
    core.closest[2] = along * co + core.radius
    core.out = DOWNWARD
    if along > real(0.0):
        generator = si * radial + wp.vec3d(real(0.0), real(0.0), co)
        core.J = wp.outer(generator, generator) + along * si / wp.max(rho, TINY) * wp.outer(azimuth, azimuth)
        core.depth = wp.max(-outward, real(0.0))
        core.out = co * radial - wp.vec3d(real(0.0), real(0.0), si)
    return core


@wp.func
def wedge(shapes: Reals2, s: int, p: wp.vec3d) -> Core:
    core = Core()
    core.radius = shapes[s, B]
    half, side, z = shapes[s, C] / real(2.0) - core.radius, sign(p[0]), p[2] - core.radius
    si, co = wp.sin(shapes[s, A]), wp.cos(shapes[s, A])
    along, outward = wp.max(wp.abs(p[0]) * si + z * co, real(0.0)), wp.abs(p[0]) * co - z * si
    within = along > real(0.0) and outward < real(0.0)  # in the cross-section
    y = wp.clamp(p[1], -half, half)
    core.closest = wp.vec3d(side * along * si, y, along * co + core.radius)
    if within:
        core.closest = wp.vec3d(p[0], y, p[2])
        core.J[0, 0] = real(1.0)
        core.J[2, 2] = real(1.0)
    elif along > real(0.0):
        generator = wp.vec3d(side * si, real(0.0), co)
        core.J = wp.outer(generator, generator)
    core.J[1, 1] = one_if(wp.abs(p[1]) < half)
    by_side, by_end = wp.where(along > real(0.0), -outward, real(-1.0)), half - wp.abs(p[1])
    core.depth = wp.max(wp.min(by_side, by_end), real(0.0))
    core.out = wp.vec3d(side * co, real(0.0), -si)
    if by_end < by_side:
        core.out = wp.vec3d(real(0.0), sign(p[1]), real(0.0))
    return core


@wp.func
def core_of(shapes: Reals2, s: int, p: wp.vec3d) -> Core:
    """The core of an analytic indenter as seen from a point p in the indenter's frame."""
    kind = int(shapes[s, 0])
    if kind == ShapeNumber.sphere:
        return sphere(shapes, s, p)
    if kind == ShapeNumber.capsule:
        return capsule(shapes, s, p)
    if kind == ShapeNumber.torus:
        return torus(shapes, s, p)
    if kind == ShapeNumber.cylinder:
        return cylinder(shapes, s, p)
    if kind == ShapeNumber.box:
        return box(shapes, s, p)
    if kind == ShapeNumber.cone:
        return cone(shapes, s, p)
    return wedge(shapes, s, p)
