"""Light of every sample of many pictures in one launch, as a Warp kernel, and the heights that it needs.

A thread does a sample: what a core does in rows for some samples, by the same functions, and interpolates between them.
"""

import warp as wp

from tacgen.physics.bundles import MOST_NORMAL, between, bundle_at, cell_of, column_seen, single, wanted
from tacgen.physics.coat import Glow, dimming, embossed, glow_at, paint_share, pattern_at
from tacgen.physics.flat import get
from tacgen.physics.raster import sides, triangle_of, weights
from tacgen.physics.shadows import horizon, terrain
from tacgen.physics.strips import ASIDE, FACING
from tacgen.physics.types import (
    HALF,
    TWO,
    Ints,
    Longs2,
    Pairs,
    Reals,
    Reals2,
    Singles,
    SingleVectors2,
    Triples,
    Vectors,
    Vectors2,
    real,
)


@wp.kernel(enable_backward=False, module="tacgen.optics")
def heights(keys: Longs2, faces: Triples, screen: Pairs, nodes: Vectors, columns: int, out: Reals2):
    """Heights (f, rows columns) [mm] of faces over a grid, by the keys of the triangles there, 0 where none lies."""
    f, k = wp.tid()
    t, z = triangle_of(keys[f, k]), real(0.0)
    if t >= 0:
        first, face = f * (nodes.shape[0] / keys.shape[0]), faces[t]
        row = k / columns
        there = weights(sides(screen, first, face), real(k - row * columns) + HALF, real(row) + HALF)
        z = (real(1.0) - there[0] - there[1]) * nodes[first + face[0]][2]
        z += there[0] * nodes[first + face[1]][2] + there[1] * nodes[first + face[2]][2]
    out[f, k] = z


@wp.kernel(enable_backward=False, module="tacgen.optics")
def light(
    keys: Longs2, faces: Triples, screen: Pairs, nodes: Vectors, facing: Vectors, rest: Pairs, width: int,
    heights: Reals, small: Reals, large: Reals, extent: Reals, rows: int, columns: int, wide: real, tall: real,
    toward: Vectors, passed: Reals, middle: Vectors, strip: Ints, grid: Vectors, table: Singles, size: wp.vec4i,
    mirror: real, matt: Vectors2, gloss: Vectors2, alpha: real, terms: wp.array(dtype=Glow), level: Pairs,
    colours: Vectors, dots: Ints, dot_sizes: Reals, texture: Reals, texture_rows: int, texture_columns: int,
    relief_x: Reals, relief_y: Reals, touched: Reals,
    out: SingleVectors2,
):  # fmt: skip
    """Linear radiance (f, samples) of faces of nodes (f n,) with normals `facing`, by the keys of the triangles behind
    samples; optics.direct_light.Direct.seen, with stray light and the coating's pattern.

    Args:
        heights, small, large, extent, rows, columns, wide, tall: see shadows.terrain.
        toward, passed, terms, level: of each sample: unit way to the camera, share of the radiance in the gel that
            reaches it, the glow's polynomial, and the sideways parts of the untouched normal there.
        middle, strip, grid, table, size, mirror: the light, as for strip_columns.toward_camera.
        matt, gloss (strips, 1): what each strip adds by a white Lambertian coat and by a rough mirror of roughness
            `alpha`; of a glossy coat with dots also the light that arrives (strips, 2).
        colours (4,): the coating's relative change under full paint; its radiance in stray light; its whole
            reflectance; that of paint.
        dots, dot_sizes: counts of dots in rows, 0 rows: none; then their spacing, radius, rim and middle x, y [mm].
        texture: the coating's pattern (rows columns,), none if empty.
        relief_x, relief_y, touched: slopes of its relief (rows columns,) [-], and the share of contact at the nodes
            (f n,); none if either is empty.
    """
    f, s = wp.tid()
    t = triangle_of(keys[f, s])
    if t < 0:
        stray = colours[1]
        out[f, s] = wp.vec3(single(stray[0]), single(stray[1]), single(stray[2]))
        return
    first, face = f * rest.shape[0], faces[t]
    row = s / width
    there = weights(sides(screen, first, face), real(s - row * width) + HALF, real(row) + HALF)
    v, w = there[0], there[1]
    u = real(1.0) - v - w
    i, j, k = first + face[0], first + face[1], first + face[2]
    p = u * get(nodes, i) + v * get(nodes, j) + w * get(nodes, k)
    normal = wp.normalize(u * get(facing, i) + v * get(facing, j) + w * get(facing, k))
    xy = u * rest[face[0]] + v * rest[face[1]] + w * rest[face[2]]
    across, down = real(texture_columns) / wide, real(texture_rows) / tall
    if relief_x.shape[0] > 0 and touched.shape[0] > 0:
        pressed = u * get(touched, i) + v * get(touched, j) + w * get(touched, k)
        if pressed > real(0.0):
            normal = embossed(
                normal, pressed, relief_x, relief_y, texture_rows, texture_columns, across, down, xy[0], xy[1]
            )
    view = toward[s]
    ci = wp.max(wp.dot(normal, view), FACING)
    n = wp.vec3d(normal[0], normal[1], wp.min(normal[2], MOST_NORMAL))
    steep = wp.vec3(single(n[0]), single(n[1]), single(n[2]))
    ground = terrain(extent, f, rows, columns, wide, tall)
    at, count = wp.cw_div(p - grid[0], grid[1]), middle.shape[0]
    cell = cell_of(size, at[0], at[1], at[2])
    seen, arrived = wp.vec3d(), wp.vec3d()
    c = int(0)
    while c < count:
        direct, mirrored = (
            bundle_at(table, cell, c, 2 * count, steep),
            bundle_at(table, cell, c + count, 2 * count, steep),
        )
        free, source, led = real(between(table, cell, 8 * count + c)), get(middle, c), get(strip, c)
        above, below = wanted(direct, free), wanted(mirrored, free)
        lit, relit = above[0] < above[1], below[0] < below[1]
        if lit or relit:
            dx, dy = source[0] - p[0], source[1] - p[1]
            rho = wp.max(wp.sqrt(dx * dx + dy * dy), ASIDE)
            d = wp.vec2d(dx / rho, dy / rho)
            above, below = wp.where(lit, above, below), wp.where(relit, below, above)
            edge = horizon(heights, small, large, ground, p[0], p[1], p[2], d[0], d[1], rho, above, below)
            rise, mirrored_rise = source[2] - p[2], TWO * mirror - source[2] - p[2]
            made = column_seen(
                direct, mirrored, lit, relit, wp.min(edge, free), d, rho, rise, mirrored_rise, n, view, ci, alpha
            )
            seen += made[0] * matt[led, 0] + made[1] * gloss[led, 0]
            if matt.shape[1] > 1:
                arrived += made[0] * matt[led, 1] + made[1] * gloss[led, 1]
        c += 1
    bounced, share = glow_at(terms[s], level[s], normal), real(0.0)
    seen = passed[s] * seen + bounced
    if dots.shape[0] > 0:
        share = paint_share(
            xy[0] - dot_sizes[4], xy[1] - dot_sizes[5], dots, dot_sizes[0], dot_sizes[1], dot_sizes[2], dot_sizes[3]
        )
    factor = dimming(share, colours[0])
    if matt.shape[1] > 1:
        arrived = passed[s] * arrived + wp.cw_div(bounced, colours[2])
        seen += share * (wp.cw_mul(colours[3], arrived) - seen)
    else:
        seen = wp.cw_mul(seen, factor)
    seen += wp.cw_mul(colours[1], factor)
    if texture.shape[0] > 0:
        seen *= pattern_at(texture, texture_rows, texture_columns, across, down, xy[0], xy[1])
    out[f, s] = wp.vec3(single(seen[0]), single(seen[1]), single(seen[2]))
