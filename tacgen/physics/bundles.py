"""Light of a column of an LED strip on a point of the face, as Warp functions; see optics.strip_light_table.

It is a bundle in the vertical plane of its irradiance vector: the lateral part of that times distance^2, over its range
of slopes [mm^2]; its least slope (rise over sideways way); the greatest that does not come from behind the face; and
the slope of the face, from which on it does [-].
"""

import warp as wp

from tacgen.physics.flat import get
from tacgen.physics.strips import PI, ggx
from tacgen.physics.types import HALF, ONE, TWO, ZERO, Singles, real

MAX_NORMAL_Z = -1e-3  # largest z component of a normal [-]
single = wp.float32
MOST_NORMAL = wp.constant(real(MAX_NORMAL_Z))
GAUSS = wp.constant(real(12.0**-0.5))  # of a range, from its middle to Gauss's points
INSIDE = wp.constant(real(1.001))  # entries by which a place stays before the end of a table


@wp.struct
class Cell:
    """A place of a table (heights, rows, columns, c): its first number, those to the next entries, and weights."""

    first: int
    across: int
    down: int
    up: int
    w00: single
    w01: single
    w10: single
    w11: single
    share: single


@wp.func
def cell_of(size: wp.vec4i, x: real, y: real, z: real) -> Cell:
    """The place of a table of `size` at column x, row y and height z; beyond its ends that at the end."""
    u = wp.clamp(x, ZERO, real(size[2]) - INSIDE)
    v = wp.clamp(y, ZERO, real(size[1]) - INSIDE)
    w = wp.clamp(z, ZERO, real(size[0]) - INSIDE)
    i, j, k, one = int(u), int(v), int(w), single(1.0)
    a, b = single(u - real(i)), single(v - real(j))
    o = Cell()
    o.first = ((k * size[1] + j) * size[2] + i) * size[3]
    o.across = size[3]
    o.down = size[2] * size[3]
    o.up = size[1] * size[2] * size[3]
    o.w00 = (one - b) * (one - a)
    o.w01 = (one - b) * a
    o.w10 = b * (one - a)
    o.w11 = b * a
    o.share = single(w - real(k))
    return o


@wp.func
def mixed(
    table: Singles, at: int, across: int, down: int, up: int, w00: single, w01: single, w10: single, w11: single,
    share: single,
) -> single:  # fmt: skip
    """The number of a table that is linear between the number `at` and those beside it, see `Cell`."""
    low = w00 * get(table, at) + w01 * get(table, at + across)
    low += w10 * get(table, at + down) + w11 * get(table, at + down + across)
    high = w00 * get(table, at + up) + w01 * get(table, at + up + across)
    high += w10 * get(table, at + up + down) + w11 * get(table, at + up + down + across)
    return low + share * (high - low)


@wp.func
def between(table: Singles, o: Cell, c: int) -> single:
    """Number c of a table at a place, linear."""
    return mixed(table, o.first + c, o.across, o.down, o.up, o.w00, o.w01, o.w10, o.w11, o.share)


@wp.func
def bundle(ex: single, ey: single, ez: single, half: single, nx: single, ny: single, nz: single):
    """The bundle of a column's light on a point of the face with this normal, from its fields there."""
    side = wp.sqrt(ex * ex + ey * ey)
    each = single(1.0) / wp.max(side, single(1e-30))
    slope, turn = ez * each, -(nx * ex + ny * ey) * each / nz
    return side / (half + half), slope - half, wp.min(slope + half, turn), turn


@wp.func
def bundle_at(table: Singles, o: Cell, c: int, both: int, n: wp.vec3) -> wp.vec4:
    """The bundle of column c of `both`, the direct light's before the reflected's, at a place of the table."""
    x, y, z = between(table, o, c), between(table, o, c + both), between(table, o, c + 2 * both)
    lateral, low, high, turn = bundle(x, y, z, between(table, o, c + 3 * both), n[0], n[1], n[2])
    return wp.vec4(lateral, low, high, turn)


@wp.func
def seen_of(
    light: wp.vec4, edge: real, d: wp.vec2d, rho2: real, rise: real, n: wp.vec3d, view: wp.vec3d, ci: real, alpha: real
) -> wp.vec2d:
    """Light of one bundle by a white Lambertian coat and by a rough mirror, as far as it passes slopes below `edge`;
    d: unit vector sideways toward it, at a squared distance rho2 and a height `rise` [mm]."""
    low, top = real(light[1]), wp.min(edge, real(light[2]))
    if not top > low:
        return wp.vec2d()
    side = real(light[0]) * (top - low) / (rho2 + rise * rise)
    turn, seen = real(light[3]), HALF * (top + low)  # mean slope of what is seen of the column
    bright = real(0.0)
    if alpha > ZERO:
        along, spread = view[0] * d[0] + view[1] * d[1], (top - low) * GAUSS
        steep = seen - spread
        point = int(0)
        while point < 2:
            long = wp.sqrt(ONE + steep * steep)
            co = -n[2] * (turn - steep) / long
            bright += HALF * side * long * ggx((along + view[2] * steep) / long, ci, co, alpha)
            steep += TWO * spread
            point += 1
    return wp.vec2d(-side * n[2] * (turn - seen) / PI, bright)


@wp.func
def wanted(light: wp.vec4, free: real) -> wp.vec2d:
    """Least and greatest slope of a bundle that the untouched face lets pass up to `free`; equal in the dark."""
    low, top = real(light[1]), wp.min(real(light[2]), free)
    return wp.where(light[0] > single(0.0) and low < top, wp.vec2d(low, top), wp.vec2d())


@wp.func
def column_seen(
    direct: wp.vec4, mirrored: wp.vec4, lit: bool, relit: bool, edge: real, d: wp.vec2d, rho: real, rise: real,
    mirrored_rise: real, n: wp.vec3d, view: wp.vec3d, ci: real, alpha: real,
) -> wp.vec2d:  # fmt: skip
    """Light of one column, if it is lit, and of its reflection in the plate, see `seen_of`."""
    made = wp.vec2d()
    if lit:
        made += seen_of(direct, edge, d, rho * rho, rise, n, view, ci, alpha)
    if relit:
        made += seen_of(mirrored, edge, d, rho * rho, mirrored_rise, n, view, ci, alpha)
    return made
