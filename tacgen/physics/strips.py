"""Light from points of LED strips through flat clear layers, as Warp functions and kernels; docs/OPTICS.md derives it.

A slab holds bottom, top [mm] and index of each layer, from the plate outward; light mirrors at its first bottom,
against air, and the outermost layer, with the camera's face in it, has no top. Rays are told by k = n sin(theta).
"""

import warp as wp

from tacgen.physics.flat import get, is_nan
from tacgen.physics.shadows import horizon, terrain
from tacgen.physics.types import HALF, ONE, TWO, ZERO, Pairs, Pairs2, Reals, Vectors, real

# distance of a ray's end from a strip's plane, below which the strip does not block it [mm]
MIN_BLOCKING_DISTANCE_MM = 0.01
MIN_LATERAL_DISTANCE_MM = 1e-9  # of a source, so that its direction is one [mm]
MAX_CONNECTION_STEPS = 20  # of Newton's method
MAX_CONNECTION_CHANGE = 1e-4  # of 1 + x at the last step; the remaining error is of the order of its square [-]
MIN_SQUARED_COSINE = 1e-12  # of a ray, which rounds to 0 for two points at the same height [-]
MIN_VIEW_COSINE = 0.05  # of the direction to the camera, in the model of a rough mirror [-]
BLOCKING = wp.constant(real(MIN_BLOCKING_DISTANCE_MM))
ASIDE = wp.constant(real(MIN_LATERAL_DISTANCE_MM))
CHANGE = wp.constant(real(MAX_CONNECTION_CHANGE))
LEVEL = wp.constant(real(MIN_SQUARED_COSINE))
FACING = wp.constant(real(MIN_VIEW_COSINE))
PI = wp.constant(real(3.141592653589793))


@wp.struct
class Arrival:
    """Light of a point source where it arrives in the outermost layer."""

    aside: real  # lateral component of the unit vector toward the light
    up: real  # z component of the unit vector toward the light
    leaving: real  # z component of the unit vector along which the light leaves the source
    weight: real  # radiance carried over times solid angle, per area [1/mm^2] normal to the leaving direction


@wp.func
def fresnel(k: real, n1: real, n2: real) -> real:
    """Share of unpolarised light that passes from n1 to n2 at k = n sin(theta); 0 beyond the critical angle."""
    if k >= n1 or k >= n2:
        return ZERO
    a, b = k / n1, k / n2
    c1, c2 = wp.sqrt(ONE - a * a), wp.sqrt(ONE - b * b)
    s, p = (n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2), (n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2)
    return ONE - HALF * (s * s + p * p)


@wp.func
def way(layer: wp.vec3d, z: real, source: real, image: int) -> real:
    """Length along z in a layer between two heights, or by way of the slab's bottom (image 1)."""
    if image == 0:
        high, low = wp.max(source, z), wp.min(source, z)
        return wp.max(wp.min(high, layer[1]) - wp.max(low, layer[0]), ZERO)
    return wp.max(wp.min(z, layer[1]) - layer[0], ZERO) + wp.max(wp.min(source, layer[1]) - layer[0], ZERO)


@wp.func
def length(slab: Vectors, i: int, z: real, source: real, image: int) -> real:
    """`way` in layer i, which is never 0 in the outermost: a strip's point may be level with the sample."""
    found = way(get(slab, i), z, source, image)
    if i == slab.shape[0] - 1:
        return wp.max(found, real(1e-5))
    return found


@wp.func
def connect(slab: Vectors, rho: real, z: real, source: real, image: int) -> wp.vec2d:
    """k of the ray that travels sideways by rho [mm] from `source` to z, and d rho/dk."""
    low, paraxial = real(wp.inf), real(0.0)
    i = int(0)
    while i < slab.shape[0]:
        if length(slab, i, z, source, image) > ZERO:
            low = wp.min(low, get(slab, i)[2])
        i += 1
    i = int(0)
    while i < slab.shape[0]:
        paraxial += length(slab, i, z, source, image) * low / get(slab, i)[2]
        i += 1
    x, step = rho / paraxial, real(wp.inf)
    count = int(0)
    while count < MAX_CONNECTION_STEPS and wp.abs(step) > CHANGE * (ONE + x):
        value, slope = real(0.0), real(0.0)
        i = int(0)
        while i < slab.shape[0]:
            part, n = length(slab, i, z, source, image), get(slab, i)[2]
            if part > ZERO:
                n2 = n * n
                root = wp.sqrt(n2 + (n2 - low * low) * x * x)
                value += part * low * x / root
                slope += part * low * n2 / (root * root * root)
            i += 1
        step = (rho - value) / slope
        x += step
        count += 1
    k, derivative = low * x / wp.sqrt(ONE + x * x), real(0.0)
    i = int(0)
    while i < slab.shape[0]:
        part, n = length(slab, i, z, source, image), get(slab, i)[2]
        if part > ZERO:
            c2 = wp.max(n * n - k * k, LEVEL)
            derivative += part * n * n / (c2 * wp.sqrt(c2))
        i += 1
    return wp.vec2d(k, derivative)


@wp.func
def layer_at(slab: Vectors, z: real) -> int:
    """Index of the layer at height z."""
    home = int(0)
    while home < slab.shape[0] - 1 and z >= get(slab, home)[1]:
        home += 1
    return home


@wp.func
def arrive(slab: Vectors, rho: real, z: real, source: real, home: int, image: int) -> Arrival:
    """Path of light from a point at lateral distance `rho` [mm] and height `source`, in layer `home`, to height z in
    the outermost layer: direct (image 0), or reflected (1) at the slab's bottom."""
    last = slab.shape[0] - 1
    found = connect(slab, rho, z, source, image)
    k, ng, nl = found[0], get(slab, last)[2], get(slab, home)[2]
    sg, sl = k / ng, k / nl
    cg, cl = wp.sqrt(wp.max(ONE - sg * sg, LEVEL)), wp.sqrt(wp.max(ONE - sl * sl, LEVEL))
    passed = real(1.0)
    i = int(0)
    while i < last:
        inner, outer = get(slab, i)[2], get(slab, i + 1)[2]
        if inner != outer:
            if image == 1 or i >= home:
                passed *= fresnel(k, outer, inner)
            if image == 1 and i < home:
                passed *= fresnel(k, inner, outer)
        i += 1
    if image == 1:
        passed *= ONE - fresnel(k, get(slab, 0)[2], ONE)
    made = Arrival()
    made.aside = sg
    rising = image == 0 and source > z  # the strip stands deeper in the gel than the sample
    made.up = wp.where(rising, cg, -cg)
    made.leaving = wp.where(image == 0, wp.where(rising, -cl, cl), -cl)
    # solid angle in the gel per area of strip, and radiance carried over as L/n^2
    made.weight = sg / (ng * cg * found[1] * rho) / cl * (ng / nl) * (ng / nl) * passed
    return made


@wp.func
def ggx(turn: real, ci: real, co: real, alpha: real) -> real:
    """GGX reflection times cos(wo), of microfacets with reflectance 1: D G1 G1 / (4 cos wi).

    `turn`: cosine between the directions wi and wo; ci, co: their cosines to the normal, > 0.
    """
    ch2 = (ci + co) * (ci + co) / (TWO + TWO * turn)
    a2 = alpha * alpha
    q, rest = ch2 * (a2 - ONE) + ONE, ONE - a2
    g = real(4.0) * ci * co / ((ci + wp.sqrt(a2 + rest * ci * ci)) * (co + wp.sqrt(a2 + rest * co * co)))
    return a2 / (PI * q * q) * g / (real(4.0) * ci)


@wp.func
def crosses(panels: Vectors, a: wp.vec3d, b: wp.vec3d) -> bool:
    """Whether a strip blocks the straight line from a to b [mm], which may start or end on one.

    panels (4 m,): middle of each strip, half of its side along and up [mm], and its unit normal.
    """
    m = int(0)
    while m < panels.shape[0]:
        middle, along, up, normal = get(panels, m), get(panels, m + 1), get(panels, m + 2), get(panels, m + 3)
        ta, tb = wp.dot(normal, a - middle), wp.dot(normal, b - middle)
        if (ta > BLOCKING and tb < -BLOCKING) or (ta < -BLOCKING and tb > BLOCKING):
            off = a + ta / (ta - tb) * (b - a) - middle
            if wp.abs(wp.dot(off, along)) < wp.dot(along, along) and wp.abs(wp.dot(off, up)) < wp.dot(up, up):
                return True
        m += 4
    return False


@wp.func
def shaded(slab: Vectors, panels: Vectors, p: wp.vec3d, source: wp.vec3d, home: int, image: int, k: real) -> bool:
    """Whether a strip blocks the refracted path of `k` between a point of the face and a source, direct or
    reflected; see `arrive` for home and image."""
    dx, dy = source[0] - p[0], source[1] - p[1]
    rho = wp.max(wp.sqrt(dx * dx + dy * dy), ASIDE)
    dx, dy = dx / rho, dy / rho
    r, z, i, down = real(0.0), p[2] + ZERO, layer_at(slab, p[2]), bool(image == 1 or source[2] < p[2])
    while i >= 0:
        here, end = get(slab, i), source[2] + ZERO
        if down and (image == 1 or i > home):
            end = here[0]
        if not down and i < home:
            end = here[1]
        ahead = r + wp.abs(end - z) * k / wp.sqrt(wp.max(here[2] * here[2] - k * k, LEVEL))
        start = wp.vec3d(p[0] + r * dx, p[1] + r * dy, z)
        if crosses(panels, start, wp.vec3d(p[0] + ahead * dx, p[1] + ahead * dy, end)):
            return True
        if i == home and (image == 0 or not down):
            return False
        r, z = ahead, end
        if down and i == 0:
            down = False
        else:
            i += wp.where(down, -1, 1)
    return False


@wp.kernel(enable_backward=False, module="tacgen.optics")
def transmitted(k: Reals, indices: Reals, out: Reals):
    """Share (n,) of light that passes all interfaces between layers of some indices, at k (n,)."""
    j = wp.tid()
    passed = real(1.0)
    for i in range(indices.shape[0] - 1):
        passed *= fresnel(k[j], indices[i], indices[i + 1])
    out[j] = passed


@wp.kernel(enable_backward=False, module="tacgen.optics")
def gathered(
    at: Vectors, normals: Vectors, views: Vectors, sources: Vectors, ways: Vectors, sizes: Pairs,
    kinds: wp.array(dtype=wp.vec2i), slab: Vectors, panels: Vectors, alpha: real, heights: Reals, small: Reals,
    large: Reals, extent: Reals, rows: int, columns: int, wide: real, tall: real, out: Pairs2,
):  # fmt: skip
    """Radiance (samples, strips) toward the camera per unit LED radiance, of a white Lambertian coat and of a rough
    mirror, see strip_light.gather; out: 0 before.

    sources, ways, sizes, kinds (p,): the strips' points, their normals, area and half extent, and strip and lobe.
    """
    s = wp.tid()
    p, n, view = at[s], normals[s], views[s]
    if is_nan(p[0]):
        return
    face, outer = terrain(extent, 0, rows, columns, wide, tall), get(slab, slab.shape[0] - 1)[2]
    ci = wp.max(wp.dot(n, view), FACING)
    q = int(0)
    while q < sources.shape[0]:
        source, normal = get(sources, q), get(ways, q)
        kind, size = kinds[q], get(sizes, q)
        dx, dy = source[0] - p[0], source[1] - p[1]
        rho = wp.max(wp.sqrt(dx * dx + dy * dy), ASIDE)
        dx, dy = dx / rho, dy / rho
        home = layer_at(slab, source[2])
        image = int(0)
        while image < 2:
            light = arrive(slab, rho, p[2], source[2], home, image)
            sl = light.aside * outer / get(slab, home)[2]
            co = (n[0] * dx + n[1] * dy) * light.aside + n[2] * light.up
            facing = light.leaving * normal[2] - sl * (normal[0] * dx + normal[1] * dy)
            weight = light.weight * facing * size[0]
            if co > ZERO and facing > ZERO and weight > ZERO:
                slope, soft = light.up / light.aside, size[1] / rho
                near = wp.vec2d(slope - soft, slope + soft)
                edge = horizon(heights, small, large, face, p[0], p[1], p[2], dx, dy, rho, near, near)
                weight *= wp.clamp(HALF + HALF * (edge - slope) / soft, ZERO, ONE)
                power = int(0)
                while power < kind[1]:
                    weight *= facing
                    power += 1
                if weight > ZERO and not shaded(slab, panels, p, source, home, image, light.aside * outer):
                    turn = (view[0] * dx + view[1] * dy) * light.aside + view[2] * light.up
                    out[s, kind[0]] = out[s, kind[0]] + weight * wp.vec2d(co / PI, ggx(turn, ci, co, alpha))
            image += 1
        q += 1
