"""Light of columns of LED strips for whole pictures, as Warp functions and kernels; see optics.strip_light_table.

A column's light on a point of the face is a bundle in the vertical plane of its irradiance vector: the lateral part of
that times distance^2, over its range of slopes [mm^2]; its least slope (rise over sideways way); the greatest that does
not come from behind the face; and the slope of the face, from which on it does [-].
"""

import warp as wp

from tacgen.physics.flat import get, put
from tacgen.physics.laws import real
from tacgen.physics.shadows import horizon, terrain
from tacgen.physics.strips import ASIDE, FACING, HALF, ONE, PI, TWO, ZERO, arrive, ggx, shaded

LATERAL_STEP_MM = 0.1  # spacing of the lateral distances for which connections are tabulated [mm]
HEIGHT_STEP_MM = 0.5  # spacing of the heights [mm]
POINTS_ALONG_COLUMN, POINTS_ACROSS_COLUMN = 2, 16  # quadrature points along and across a column
MAX_SLOPE = 9.0  # of a ray, larger than all [-]
MAX_NORMAL_Z = -1e-3  # largest z component of a normal [-]
# fields of a column's light: its irradiance vector times distance^2 [mm^2], and half its range of slopes [-]
LIGHT_FIELDS = 4
single = wp.float32
FIELDS, ACROSS = wp.constant(LIGHT_FIELDS), wp.constant(POINTS_ACROSS_COLUMN)
LATERAL, RISE = wp.constant(real(LATERAL_STEP_MM)), wp.constant(real(HEIGHT_STEP_MM))
HALF_COLUMN = wp.constant(single(0.5 / POINTS_ALONG_COLUMN))
MOST_SLOPE = wp.constant(real(MAX_SLOPE))
MOST_NORMAL = wp.constant(real(MAX_NORMAL_Z))
GAUSS = wp.constant(real(12.0**-0.5))  # of a range, from its middle to Gauss's points
INSIDE = wp.constant(real(1.001))  # entries by which a place stays before the end of a table


@wp.kernel(enable_backward=False, module="tacgen.optics")
def connections(
    z: wp.array(dtype=real),
    aside: wp.array(dtype=real),
    sources: wp.array(dtype=real),
    home: wp.array(dtype=wp.int32),
    slab: wp.array(dtype=wp.vec3d),
    out: wp.array4d(dtype=single),
):
    """Arrivals (sources ways, 2, 4, heights) of light for every source's height, way aside, image and height."""
    thread = wp.tid()
    s = thread / aside.shape[0]
    rho = aside[thread - s * aside.shape[0]]
    for image in range(2):
        i = int(0)
        while i < z.shape[0]:
            found = arrive(slab, rho, z[i], sources[s], home[s], image)
            out[thread, image, 0, i] = single(found.aside)
            out[thread, image, 1, i] = single(found.up)
            out[thread, image, 2, i] = single(found.leaving)
            out[thread, image, 3, i] = single(found.weight)
            i += 1


@wp.kernel(enable_backward=False, module="tacgen.optics")
def column_light(
    places: wp.array(dtype=wp.vec3d),
    z: wp.array(dtype=real),
    sources: wp.array(dtype=wp.vec3d),
    ways: wp.array(dtype=wp.vec3d),
    sizes: wp.array(dtype=wp.vec2d),
    kinds: wp.array(dtype=wp.vec2i),
    middle: wp.array(dtype=wp.vec3d),
    level: wp.array(dtype=wp.int32),
    home: wp.array(dtype=wp.int32),
    table: wp.array(dtype=single),
    laterals: int,
    panels: wp.array(dtype=wp.vec3d),
    slab: wp.array(dtype=wp.vec3d),
    room: wp.array(dtype=single),
    out: wp.array(dtype=single),
):
    """Light of columns at heights z (m,) over places (n,) of the untouched face: (m, n, 2 FIELDS, columns), of each
    field that of the direct and then of the reflected light. A thread for each column does all places.

    Light that strips block at a place of the untouched face counts as blocked at all heights there.

    Args:
        sources, ways, sizes, kinds: as for strips.gathered, one column after the other, of middles (columns,).
        level, home: index (p,) of each point's height in the table, and the layer of each height.
        table: `connections` of so many lateral distances.
        room: (columns, 14 m).
    """
    c = wp.tid()
    m, count, each = z.shape[0], middle.shape[0], sources.shape[0] / middle.shape[0]
    outer = get(slab, slab.shape[0] - 1)[2]
    light = c * 14 * m  # 2 x FIELDS x m, then 2 x m of the least and of the greatest slopes, weights and facing
    least, weights, facings = light + 8 * m, light + 12 * m, light + 13 * m
    s = int(0)
    while s < places.shape[0]:
        p = places[s]
        share = wp.clamp((p[2] - z[0]) / (z[1] - z[0]), ZERO, real(m) - INSIDE)
        below = int(share)
        share -= real(below)
        i = int(0)
        while i < 8 * m:
            put(room, light + i, single(0.0))
            i += 1
        q = c * each
        while q < (c + 1) * each:
            if q % ACROSS == 0:
                i = int(0)
                while i < 2 * m:
                    put(room, least + i, single(wp.inf))
                    put(room, least + 2 * m + i, -single(wp.inf))
                    i += 1
            source, normal, size, from_layer = get(sources, q), get(ways, q), get(sizes, q), home[level[q]]
            dx, dy = source[0] - p[0], source[1] - p[1]
            rho = wp.max(wp.sqrt(dx * dx + dy * dy), ASIDE)
            dx, dy = dx / rho, dy / rho
            r = int(rho / LATERAL)
            far, x, y, soft = single(rho / LATERAL - real(r)), single(dx), single(dy), single(size[1] / rho)
            index = outer / get(slab, from_layer)[2]
            turned, up, area = single(index * (normal[0] * dx + normal[1] * dy)), single(normal[2]), single(size[0])
            near = single(1.0) - far
            image = int(0)
            while image < 2:
                low = ((level[q] * laterals + r) * 2 + image) * 4 * m
                high = low + 8 * m
                blocked = bool(False)
                if panels.shape[0] > 0:
                    a, b = low + below, high + below
                    k = (ONE - share) * real(near * get(table, a) + far * get(table, b))
                    k += share * real(near * get(table, a + 1) + far * get(table, b + 1))
                    blocked = shaded(slab, panels, p, source, from_layer, image, k * outer)
                if not blocked:
                    i = int(0)
                    while i < m:
                        sine = near * get(table, low + i) + far * get(table, high + i)
                        leaving = near * get(table, low + 2 * m + i) + far * get(table, high + 2 * m + i)
                        carried = near * get(table, low + 3 * m + i) + far * get(table, high + 3 * m + i)
                        facing = wp.max(leaving * up - sine * turned, single(0.0))
                        put(room, facings + i, facing)
                        put(room, weights + i, area * facing * carried)
                        i += 1
                    power = int(0)
                    while power < kinds[q][1]:
                        i = int(0)
                        while i < m:
                            put(room, weights + i, get(room, weights + i) * get(room, facings + i))
                            i += 1
                        power += 1
                    to, range_at = light + image * 4 * m, least + image * m
                    i = int(0)
                    while i < m:
                        sine = near * get(table, low + i) + far * get(table, high + i)
                        rise = near * get(table, low + m + i) + far * get(table, high + m + i)
                        weight, slope = get(room, weights + i), rise / sine
                        put(room, to + i, get(room, to + i) + weight * sine * x)
                        put(room, to + m + i, get(room, to + m + i) + weight * sine * y)
                        put(room, to + 2 * m + i, get(room, to + 2 * m + i) + weight * rise)
                        put(room, range_at + i, wp.min(get(room, range_at + i), slope - soft))
                        put(room, range_at + 2 * m + i, wp.max(get(room, range_at + 2 * m + i), slope + soft))
                        i += 1
                image += 1
            q += 1
            if q % ACROSS == 0:
                i = int(0)
                while i < 2 * m:
                    half = light + (i / m * 4 + 3) * m + i % m
                    wide = get(room, least + 2 * m + i) - get(room, least + i)
                    put(room, half, get(room, half) + wp.max(wide, single(0.0)) * HALF_COLUMN)
                    i += 1
        dx, dy = middle[c][0] - p[0], middle[c][1] - p[1]
        i = int(0)
        while i < m:
            for image in range(2):
                height = wp.where(image == 1, TWO * get(slab, 0)[0], TWO * z[i]) - middle[c][2] - z[i]
                away2 = single(dx * dx + dy * dy + height * height)
                for field in range(4):
                    value = get(room, light + (image * 4 + field) * m + i)
                    if field < 3:
                        value *= away2
                    to = ((i * places.shape[0] + s) * (2 * FIELDS + 1) + 2 * field + image) * count + c
                    put(out, to, value)
            i += 1
        s += 1


@wp.kernel(enable_backward=False, module="tacgen.optics")
def untouched_horizons(
    places: wp.array(dtype=wp.vec3d),
    z: wp.array(dtype=real),
    middle: wp.array(dtype=wp.vec3d),
    heights: wp.array(dtype=real),
    small: wp.array(dtype=real),
    large: wp.array(dtype=real),
    extent: wp.array(dtype=real),
    rows: int,
    columns: int,
    wide: real,
    tall: real,
    out: wp.array3d(dtype=single),
):
    """Greatest slopes (m, n, >= columns) that pass the untouched face from heights z (m,) over places (n,) of it toward
    each column, in the last numbers of a row. Above the face they go on linearly, which is exact if the occluder is far
    away."""
    s = wp.tid()
    face, p = terrain(extent, 0, rows, columns, wide, tall), places[s]
    every, first = wp.vec2d(-MOST_SLOPE, MOST_SLOPE), out.shape[2] - middle.shape[0]
    for c in range(middle.shape[0]):
        dx, dy = middle[c][0] - p[0], middle[c][1] - p[1]
        rho = wp.max(wp.sqrt(dx * dx + dy * dy), ASIDE)
        dx, dy = dx / rho, dy / rho
        lower, level = real(0.0), real(0.0)
        i = int(-2)
        while i < z.shape[0]:  # first below the face and on it
            height = p[2] + real(i + 1) * RISE
            if i >= 0:
                height = z[i]
            if i >= 0 and height >= p[2]:
                out[i, s, first + c] = single(level + (level - lower) / RISE * (height - p[2]))
            else:
                found = horizon(heights, small, large, face, p[0], p[1], height, dx, dy, rho, every, every)
                if i == -2:
                    lower = found
                elif i == -1:
                    level = found
                else:
                    out[i, s, first + c] = single(found)
            i += 1


@wp.func
def trilinear(
    table: wp.array(dtype=single), size: wp.vec4i, x: real, y: real, z: real, out: wp.array(dtype=single), first: int
):
    """A table (heights, rows, columns, c) of `size` at column x, row y and height z: c numbers of `out`, linear,
    constant beyond its ends."""
    u = wp.clamp(x, ZERO, real(size[2]) - INSIDE)
    v = wp.clamp(y, ZERO, real(size[1]) - INSIDE)
    w = wp.clamp(z, ZERO, real(size[0]) - INSIDE)
    i, j, k, count = int(u), int(v), int(w), size[3]
    a, b, d, one = single(u - real(i)), single(v - real(j)), single(w - real(k)), single(1.0)
    w00, w01, w10, w11 = (one - b) * (one - a), (one - b) * a, b * (one - a), b * a
    near = ((k * size[1] + j) * size[2] + i) * count
    row, plane = size[2] * count, size[1] * size[2] * count
    c = int(0)
    while c < count:
        at = near + c
        low = w00 * get(table, at) + w01 * get(table, at + count)
        low += w10 * get(table, at + row) + w11 * get(table, at + row + count)
        at += plane
        high = w00 * get(table, at) + w01 * get(table, at + count)
        high += w10 * get(table, at + row) + w11 * get(table, at + row + count)
        put(out, first + c, low + d * (high - low))
        c += 1


@wp.func
def incident(room: wp.array(dtype=single), first: int, both: int, nx: single, ny: single, nz: single):
    """Bundles (4, 2 columns) of the columns' light on a point of the face with this normal, from Columns.light there;
    they take the places of its first fields in `room`."""
    c = int(0)
    while c < both:
        at = first + c
        ex, ey, ez, half = get(room, at), get(room, at + both), get(room, at + 2 * both), get(room, at + 3 * both)
        side = wp.sqrt(ex * ex + ey * ey)
        each = single(1.0) / wp.max(side, single(1e-30))
        slope, turn = ez * each, -(nx * ex + ny * ey) * each / nz
        put(room, at, side / (half + half))
        put(room, at + both, slope - half)
        put(room, at + 2 * both, wp.min(slope + half, turn))
        put(room, at + 3 * both, turn)
        c += 1


@wp.func
def seen_of(
    room: wp.array(dtype=single), at: int, both: int, edge: real, d: wp.vec2d, rho2: real, rise: real, n: wp.vec3d,
    view: wp.vec3d, ci: real, alpha: real,
) -> wp.vec2d:  # fmt: skip
    """Light of one column by a white Lambertian coat and by a rough mirror, as far as it passes slopes below `edge`;
    d: unit vector sideways toward it, at a squared distance rho2 and a height `rise` [mm]."""
    low, top = real(get(room, at + both)), wp.min(edge, real(get(room, at + 2 * both)))
    if not top > low:
        return wp.vec2d()
    side = real(get(room, at)) * (top - low) / (rho2 + rise * rise)
    turn, seen = real(get(room, at + 3 * both)), HALF * (top + low)  # mean slope of what is seen of the column
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


@wp.kernel(enable_backward=False, module="tacgen.optics")
def toward_camera(
    index: wp.array(dtype=wp.int64),
    step: int,
    faces: wp.array(dtype=wp.vec3i),
    triangle: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.vec2d),
    nodes: wp.array(dtype=wp.vec3d),
    normals: wp.array(dtype=wp.vec3d),
    views: wp.array(dtype=wp.vec3d),
    passed: wp.array(dtype=real),
    middle: wp.array(dtype=wp.vec3d),
    strip: wp.array(dtype=wp.int32),
    grid: wp.array(dtype=wp.vec3d),
    light: wp.array(dtype=single),
    size: wp.vec4i,
    mirror: real,
    shares: wp.array(dtype=wp.vec2d),
    count: int,
    alpha: real,
    heights: wp.array(dtype=real),
    small: wp.array(dtype=real),
    large: wp.array(dtype=real),
    extent: wp.array(dtype=real),
    rows: int,
    columns: int,
    wide: real,
    tall: real,
    room: wp.array(dtype=single),
    out: wp.array(dtype=real),
):
    """Radiance (n, count) at the camera of the samples `index` (n,), 0 where there is no gel, see
    strip_light_table.toward_camera; each thread does every `step`-th.

    Args:
        faces, triangle, place, nodes: the sheet and the triangles behind all samples, as for raster.blended.
        middle, strip, grid, light, size, mirror: Columns; grid: the table's corner and its steps; size: its shape.
        shares: what each strip (strips, count) adds by a white Lambertian coat and by a rough mirror.
        room: (threads, size[3]).
    """
    thread = wp.tid()
    face, first = terrain(extent, 0, rows, columns, wide, tall), thread * size[3]
    both, corner, pitch = 2 * middle.shape[0], grid[0], grid[1]
    s = int(thread)
    while s < index.shape[0]:
        at = int(index[s])
        to, m, t = s * count, int(0), get(triangle, at)
        while m < count:
            put(out, to + m, ZERO)
            m += 1
        if t >= 0:
            hit, three = get(place, at), get(faces, t)
            p = (ONE - hit[0] - hit[1]) * get(nodes, three[0])
            p += hit[0] * get(nodes, three[1]) + hit[1] * get(nodes, three[2])
            n, view = get(normals, at), get(views, at)
            ci = wp.max(wp.dot(n, view), FACING)
            n = wp.vec3d(n[0], n[1], wp.min(n[2], MOST_NORMAL))
            place_of = wp.cw_div(p - corner, pitch)
            trilinear(light, size, place_of[0], place_of[1], place_of[2], room, first)
            incident(room, first, both, single(n[0]), single(n[1]), single(n[2]))
            c = int(0)
            while c < middle.shape[0]:
                direct, mirrored = first + c, first + c + middle.shape[0]
                free = real(get(room, first + FIELDS * both + c))
                above = wp.vec2d(real(get(room, direct + both)), wp.min(real(get(room, direct + 2 * both)), free))
                below = wp.vec2d(real(get(room, mirrored + both)), wp.min(real(get(room, mirrored + 2 * both)), free))
                lit = get(room, direct) > single(0.0) and above[0] < above[1]
                relit = get(room, mirrored) > single(0.0) and below[0] < below[1]
                if lit or relit:
                    source = get(middle, c)
                    dx, dy = source[0] - p[0], source[1] - p[1]
                    rho = wp.max(wp.sqrt(dx * dx + dy * dy), ASIDE)
                    d = wp.vec2d(dx / rho, dy / rho)
                    a, b = wp.where(lit, above, below), wp.where(relit, below, above)
                    edge = wp.min(horizon(heights, small, large, face, p[0], p[1], p[2], d[0], d[1], rho, a, b), free)
                    made = wp.vec2d()
                    if lit:
                        made = seen_of(room, direct, both, edge, d, rho * rho, source[2] - p[2], n, view, ci, alpha)
                    if relit:
                        rise = TWO * mirror - source[2] - p[2]
                        made += seen_of(room, mirrored, both, edge, d, rho * rho, rise, n, view, ci, alpha)
                    made *= get(passed, at)
                    m = int(0)
                    while m < count:
                        part = get(shares, strip[c] * count + m)
                        put(out, to + m, get(out, to + m) + wp.dot(made, part))
                        m += 1
                c += 1
        s += step
