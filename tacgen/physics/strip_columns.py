"""Light of columns of LED strips for whole pictures, as Warp kernels; see optics.strip_light_table."""

import warp as wp

from tacgen.physics.bundles import INSIDE, MOST_NORMAL, bundle, cell_of, column_seen, mixed, single, wanted
from tacgen.physics.flat import get, put
from tacgen.physics.shadows import horizon, terrain
from tacgen.physics.strips import ASIDE, FACING, arrive, shaded
from tacgen.physics.types import (
    ONE,
    TWO,
    ZERO,
    Ints,
    Longs,
    Pairs,
    Reals,
    Singles,
    Singles3,
    Singles4,
    Triples,
    Vectors,
    real,
)

LATERAL_STEP_MM = 0.1  # spacing of the lateral distances for which connections are tabulated [mm]
HEIGHT_STEP_MM = 0.5  # spacing of the heights [mm]
POINTS_ALONG_COLUMN, POINTS_ACROSS_COLUMN = 2, 16  # quadrature points along and across a column
MAX_SLOPE = 9.0  # of a ray, larger than all [-]
# fields of a column's light: its irradiance vector times distance^2 [mm^2], and half its range of slopes [-]
LIGHT_FIELDS = 4
FIELDS, ACROSS = wp.constant(LIGHT_FIELDS), wp.constant(POINTS_ACROSS_COLUMN)
LATERAL, RISE = wp.constant(real(LATERAL_STEP_MM)), wp.constant(real(HEIGHT_STEP_MM))
HALF_COLUMN = wp.constant(single(0.5 / POINTS_ALONG_COLUMN))
MOST_SLOPE = wp.constant(real(MAX_SLOPE))


@wp.kernel(enable_backward=False, module="tacgen.optics")
def connections(z: Reals, aside: Reals, sources: Reals, home: Ints, slab: Vectors, out: Singles4):
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
    places: Vectors, z: Reals, sources: Vectors, ways: Vectors, sizes: Pairs, kinds: wp.array(dtype=wp.vec2i),
    middle: Vectors, level: Ints, home: Ints, table: Singles, laterals: int, panels: Vectors, slab: Vectors,
    room: Singles, out: Singles,
):  # fmt: skip
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
    places: Vectors, z: Reals, middle: Vectors, heights: Reals, small: Reals, large: Reals, extent: Reals, rows: int,
    columns: int, wide: real, tall: real, out: Singles3,
):  # fmt: skip
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


@wp.kernel(enable_backward=False, module="tacgen.optics")
def toward_camera(
    index: Longs, step: int, faces: Triples, triangle: Ints, place: Pairs, nodes: Vectors, normals: Vectors,
    views: Vectors, passed: Reals, middle: Vectors, strip: Ints, grid: Vectors, light: Singles, size: wp.vec4i,
    mirror: real, shares: Pairs, count: int, alpha: real, heights: Reals, small: Reals, large: Reals, extent: Reals,
    rows: int, columns: int, wide: real, tall: real, room: Singles, out: Reals,
):  # fmt: skip
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
            cell = cell_of(size, place_of[0], place_of[1], place_of[2])
            near, across, down, up = cell.first, cell.across, cell.down, cell.up
            w00, w01, w10, w11, share = cell.w00, cell.w01, cell.w10, cell.w11, cell.share  # loops of vectors want none
            nx, ny, nz = single(n[0]), single(n[1]), single(n[2])
            c = int(0)
            while c < size[3]:
                number = mixed(light, near + c, across, down, up, w00, w01, w10, w11, share)
                put(room, first + c, number)
                c += 1
            c = int(0)
            while c < both:  # the bundles take the places of the fields
                i = first + c
                x, y, z = get(room, i), get(room, i + both), get(room, i + 2 * both)
                lateral, low, high, turn = bundle(x, y, z, get(room, i + 3 * both), nx, ny, nz)
                put(room, i, lateral)
                put(room, i + both, low)
                put(room, i + 2 * both, high)
                put(room, i + 3 * both, turn)
                c += 1
            c = int(0)
            while c < middle.shape[0]:
                i, j = first + c, first + c + middle.shape[0]
                direct = wp.vec4(get(room, i), get(room, i + both), get(room, i + 2 * both), get(room, i + 3 * both))
                mirrored = wp.vec4(get(room, j), get(room, j + both), get(room, j + 2 * both), get(room, j + 3 * both))
                free = real(get(room, first + FIELDS * both + c))
                above, below = wanted(direct, free), wanted(mirrored, free)
                lit, relit = above[0] < above[1], below[0] < below[1]
                if lit or relit:
                    source = get(middle, c)
                    dx, dy = source[0] - p[0], source[1] - p[1]
                    rho = wp.max(wp.sqrt(dx * dx + dy * dy), ASIDE)
                    d = wp.vec2d(dx / rho, dy / rho)
                    a, b = wp.where(lit, above, below), wp.where(relit, below, above)
                    edge = wp.min(horizon(heights, small, large, face, p[0], p[1], p[2], d[0], d[1], rho, a, b), free)
                    rise, mirrored_rise = source[2] - p[2], TWO * mirror - source[2] - p[2]
                    made = column_seen(
                        direct, mirrored, lit, relit, edge, d, rho, rise, mirrored_rise, n, view, ci, alpha
                    )
                    made *= get(passed, at)
                    m = int(0)
                    while m < count:
                        part = get(shares, strip[c] * count + m)
                        put(out, to + m, get(out, to + m) + wp.dot(made, part))
                        m += 1
                c += 1
        s += step
