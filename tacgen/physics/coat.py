"""The coating, as Warp functions and kernels: dots of paint, its grain and wear, and the glow of interreflection."""

import warp as wp

from tacgen.physics.flat import get, is_nan, put
from tacgen.physics.types import Ints, Longs, Pairs, Reals, Vectors, real

NORMAL_TERMS = 5  # terms of the glow's polynomial in the change of the normal: 1, x, y, x^2, y^2
MAX_NORMAL_CHANGE = 0.9  # of a normal's x or y, up to which the glow's polynomial follows it [-]
MOST_TURN = wp.constant(real(MAX_NORMAL_CHANGE))
Glow = wp.types.matrix(shape=(NORMAL_TERMS, 3), dtype=wp.float32)  # terms of three colours


@wp.func
def paint_share(x: real, y: real, counts: Ints, across: real, down: real, radius: real, edge: real) -> real:
    """Share of paint at a rest position [mm] from the middle of rows of `counts` dots, 0 where it is nan.

    across, down: the dots' spacing; radius: theirs; edge: width of the blurred rim [mm].
    """
    last = real(counts.shape[0] - 1) / real(2.0)
    level, reach = y / down + last, (radius + edge / real(2.0)) / down
    row, away2 = wp.max(wp.ceil(level - reach), real(0.0)), real(wp.inf)
    while row <= wp.min(level + reach, real(2.0) * last):  # the rows near enough
        end = real(get(counts, int(row)) - 1) / real(2.0)
        nearest = wp.clamp(wp.rint(x / across + end) - end, -end, end)
        off = wp.vec2d(x - nearest * across, (level - row) * down)
        away2 = wp.min(away2, wp.dot(off, off))
        row += real(1.0)
    if away2 == real(wp.inf):
        return real(0.0)
    return wp.clamp((radius - wp.sqrt(away2)) / edge + real(0.5), real(0.0), real(1.0))


@wp.func
def pattern_at(field: Reals, rows: int, columns: int, across: real, down: real, x: real, y: real) -> real:
    """A pattern (rows columns,) over a rectangle about 0 at a rest position [mm], with `across` and `down` of its nodes
    a mm: linear, and constant beyond its nodes."""
    u = wp.clamp(x * across + real(0.5) * real(columns - 1), real(0.0), real(columns - 1))
    v = wp.clamp(y * down + real(0.5) * real(rows - 1), real(0.0), real(rows - 1))
    left, top = wp.min(int(u), columns - 2), wp.min(int(v), rows - 2)
    a, b, at = u - real(left), v - real(top), top * columns + left
    above = (real(1.0) - a) * get(field, at) + a * get(field, at + 1)
    below = (real(1.0) - a) * get(field, at + columns) + a * get(field, at + columns + 1)
    return (real(1.0) - b) * above + b * below


@wp.func
def embossed(
    normal: wp.vec3d, share: real, slopes_x: Reals, slopes_y: Reals, rows: int, columns: int, across: real, down: real,
    x: real, y: real,
) -> wp.vec3d:  # fmt: skip
    """A unit normal turned by slopes of a relief at right angles to the face, patterns as in `pattern_at`, of which a
    share shows."""
    dx = pattern_at(slopes_x, rows, columns, across, down, x, y)
    dy = pattern_at(slopes_y, rows, columns, across, down, x, y)
    return wp.normalize(normal + share * wp.vec3d(dx, dy, real(0.0)))


@wp.func
def glow_at(terms: Glow, untouched: wp.vec2d, normal: wp.vec3d) -> wp.vec3d:
    """Interreflected radiance (3,) by the polynomial of a sample, where the normal was `untouched`."""
    dx = wp.clamp(normal[0] - untouched[0], -MOST_TURN, MOST_TURN)
    dy = wp.clamp(normal[1] - untouched[1], -MOST_TURN, MOST_TURN)
    made = wp.vec3d()
    for c in range(3):
        along, bent = real(terms[1, c]), real(terms[3, c])
        across, curled = real(terms[2, c]), real(terms[4, c])
        made[c] = wp.max(real(terms[0, c]) + dx * (along + dx * bent) + dy * (across + dy * curled), real(0.0))
    return made


@wp.func
def dimming(share: real, change: wp.vec3d) -> wp.vec3d:
    """The coating's light (3,) under a share of paint over that without, by its relative change under full paint."""
    return wp.vec3d(real(1.0), real(1.0), real(1.0)) + share * change


@wp.kernel(enable_backward=False, module="tacgen.optics")
def dim(light: Vectors, share: Reals, change: Vectors, even: Vectors):
    """Dim light (n,) by shares of paint (n,), see `dimming`, or with a row in `even` (1,) add that, so dimmed."""
    k = wp.tid()
    factor, here = dimming(get(share, k), change[0]), get(light, k)
    if even.shape[0] > 0:
        put(light, k, here + wp.cw_mul(even[0], factor))
    else:
        put(light, k, wp.cw_mul(here, factor))


@wp.kernel(enable_backward=False, module="tacgen.optics")
def paint(xy: Pairs, counts: Ints, across: real, down: real, radius: real, edge: real, out: Reals):
    """Shares of paint (n,) at rest positions (n,) from the dots' middle, see `paint_share`."""
    k = wp.tid()
    here = get(xy, k)
    put(out, k, paint_share(here[0], here[1], counts, across, down, radius, edge))


@wp.kernel(enable_backward=False, module="tacgen.optics")
def pattern(field: Reals, rows: int, columns: int, across: real, down: real, xy: Pairs, out: Reals):
    """A pattern at rest positions (n,), 1 where they are nan, see `pattern_at`."""
    k = wp.tid()
    here = get(xy, k)
    x, y = here[0], here[1]
    if is_nan(x) or is_nan(y):
        put(out, k, real(1.0))
    else:
        put(out, k, pattern_at(field, rows, columns, across, down, x, y))


@wp.kernel(enable_backward=False, module="tacgen.optics")
def emboss(
    normals: Vectors, share: Reals, xy: Pairs, slopes_x: Reals, slopes_y: Reals, rows: int, columns: int, across: real,
    down: real, out: Vectors,
):  # fmt: skip
    """Normals (n,) at rest positions (n,), turned where the share of contact (n,) is positive, see `embossed`."""
    k = wp.tid()
    normal, here, pressed = get(normals, k), get(xy, k), get(share, k)
    if pressed > real(0.0):
        normal = embossed(normal, pressed, slopes_x, slopes_y, rows, columns, across, down, here[0], here[1])
    put(out, k, normal)


@wp.kernel(enable_backward=False, module="tacgen.optics")
def glow(terms: wp.array(dtype=Glow), untouched: Pairs, normals: Vectors, index: Longs, out: Vectors):
    """Interreflected radiance (n,) at the samples `index` (n,), 0 where the normal is nan."""
    k = wp.tid()
    i = int(get(index, k))
    normal = get(normals, i)
    if is_nan(normal[2]):
        put(out, k, wp.vec3d())
    else:
        put(out, k, glow_at(terms[i], get(untouched, i), normal))
