"""Pictures by a look-up table (Taxim), as Warp kernels. Pictures are flat, row by row; see optics.taxim_table."""

import warp as wp

from tacgen.physics.flat import get, is_nan, put
from tacgen.physics.types import HALF, Longs, Pairs, Reals, Reals3, Vectors, Vectors2, real

SLOPE_BINS = 41  # of each slope component, the sine of its angle from -1 to 1
# spacing of pixels whose shadows are computed, and of the points tested on the line to a lamp [px]
SHADOW_SPACING_PX = 4
BINS = wp.constant(SLOPE_BINS)
SPACING = wp.constant(real(SHADOW_SPACING_PX))
HALF_BINS = wp.constant(real((SLOPE_BINS - 1) / 2))
BEFORE_LAST = wp.constant(real(1e-9))  # by which a place stays before a table's last entry [entries]
Basis = wp.types.vector(length=6, dtype=real)  # 1, x, y, x^2, x y, y^2 at a pixel
Lamp = wp.types.vector(length=7, dtype=real)  # ends of a strip and half its height [mm]


@wp.kernel(enable_backward=False, module="tacgen.optics")
def accumulated(index: Longs, basis: wp.array(dtype=Basis), light: Vectors, a: Reals3, b: Vectors2):
    """Add samples (n,) and their light (n,) to the normal equations (bins, 6, 6) and (bins, 6); one thread does all."""
    for s in range(index.shape[0]):
        k, row = int(index[s]), basis[s]
        for i in range(6):
            for j in range(6):
                a[k, i, j] = a[k, i, j] + row[i] * row[j]
            b[k, i] = b[k, i] + row[i] * light[s]


@wp.kernel(enable_backward=False, module="tacgen.optics")
def bent(height: Reals, normal: Vectors, untouched: Vectors, out: Reals, slope: Pairs):
    """Heights (n,) and differences of normals in x and y (n,); 0 where they are nan."""
    i = wp.tid()
    bend = get(normal, i) - get(untouched, i)
    z = get(height, i)
    put(out, i, wp.where(is_nan(z), real(0.0), z))
    u, v = wp.where(is_nan(bend[0]), real(0.0), bend[0]), wp.where(is_nan(bend[1]), real(0.0), bend[1])
    put(slope, i, wp.vec2d(u, v))


@wp.func
def within(at: real, last: int) -> real:
    """A place among 0, 1, ... last, before the last."""
    return wp.clamp(at, real(0.0), real(last) - BEFORE_LAST)


@wp.func
def terms_light(terms: Vectors, at: int, basis: Basis) -> wp.vec3d:
    """Light by the polynomial of one bin."""
    total = wp.vec3d()
    k = int(0)
    while k < 6:
        total += basis[k] * get(terms, at + k)
        k += 1
    return total


@wp.kernel(enable_backward=False, module="tacgen.optics")
def looked_up(terms: Vectors, slope: Pairs, basis: wp.array(dtype=Basis), dark: Vectors2, width: int, out: Vectors):
    """The table's light (n,), bilinear between bins (bins, bins, 6), less what is dark at every SHADOW_SPACING_PX-th
    pixel and beyond."""
    p = wp.tid()
    y = p / width
    here, row = get(slope, p), basis[p]
    u = within((here[0] + real(1.0)) * HALF_BINS, BINS - 1)
    v = within((here[1] + real(1.0)) * HALF_BINS, BINS - 1)
    i, j = int(u), int(v)
    a, b = u - real(i), v - real(j)
    at, below = 6 * (j * BINS + i), 6 * ((j + 1) * BINS + i)
    low = (real(1.0) - a) * terms_light(terms, at, row) + a * terms_light(terms, at + 6, row)
    high = (real(1.0) - a) * terms_light(terms, below, row) + a * terms_light(terms, below + 6, row)
    light = (real(1.0) - b) * low + b * high
    v = within(real(y) / SPACING - HALF, dark.shape[0] - 1)
    u = within(real(p - y * width) / SPACING - HALF, dark.shape[1] - 1)
    i, j = int(u), int(v)
    d, e = v - real(j), u - real(i)
    above = (real(1.0) - e) * dark[j, i] + e * dark[j, i + 1]
    under = (real(1.0) - e) * dark[j + 1, i] + e * dark[j + 1, i + 1]
    put(out, p, light - ((real(1.0) - d) * above + d * under))


@wp.kernel(enable_backward=False, module="tacgen.optics")
def shadows(height: Reals, lowest: Reals, lamps: wp.array(dtype=Lamp), width: int, mm_per_px: real, out: Reals):
    """How much (n, lamps), 0 to 1, of each lamp is hidden from each pixel (n,), see taxim_table.shadows; lowest
    (1,): the least height [mm]."""
    p = wp.tid()
    h, y = height.shape[0] / width, p / width
    x = p - y * width
    right, bottom = real(width - 1), real(h - 1)
    px, py = (real(x) + HALF - real(width) * HALF) * mm_per_px, (real(y) + HALF - real(h) * HALF) * mm_per_px
    pz, least = get(height, p), lowest[0]
    for k in range(lamps.shape[0]):
        lamp = lamps[k]
        start = wp.vec3d(lamp[0], lamp[1], lamp[2])
        along = wp.vec3d(lamp[3], lamp[4], lamp[5]) - start
        t = ((px - start[0]) * along[0] + (py - start[1]) * along[1]) / wp.max(wp.dot(along, along), real(1e-12))
        nearest = start + wp.clamp(t, real(0.0), real(1.0)) * along
        dx, dy = nearest[0] - px, nearest[1] - py
        far = wp.max(wp.sqrt(dx * dx + dy * dy), real(1e-9))
        rise = (nearest[2] - pz) / far
        du, dv, soft = dx / far / mm_per_px, dy / far / mm_per_px, lamp[6] / far
        found, s = real(0.0), mm_per_px + real(0.0)
        while s < far:
            z, u, v = pz + s * rise, real(x) + s * du, real(y) + s * dv
            if u < real(0.0) or v < real(0.0) or u > right or v > bottom or (z < least and rise <= real(0.0)):
                break
            drop = z - get(height, int(v + HALF) * width + int(u + HALF))
            found = wp.max(found, wp.min(drop / wp.max(soft * s, real(1e-3)), real(1.0)))
            s += mm_per_px
        out[p * lamps.shape[0] + k] = found
