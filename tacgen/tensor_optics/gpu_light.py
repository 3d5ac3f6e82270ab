"""Light of the samples of many pictures in one launch, by Triton; imported only where there is a GPU.

The formulas, and the names in them, are those of optics.strip_light_table, shadows, interreflection, coating and
coat_texture. Where those interpolate between samples that hardly differ (optics.adaptive_sampling), here every sample
is computed.
"""

import triton
import triton.language as tl

from tacgen.tensor_optics.gpu_faces import placed

SAMPLES_PER_PROGRAM = 32  # of a program: one warp, whose samples wait for each other at the horizon only


@triton.jit
def _horizon(
    TERRAIN, SMALL, LARGE, EXTENT, rows, columns, small_columns, large_columns, wide, tall,
    x, y, z, dx, dy, reach, above_low, above_high, below_low, below_high, wanted,
    SMALL_CELLS: tl.constexpr, LARGE_CELLS: tl.constexpr,
):  # fmt: skip
    """shadows.horizon, of the samples `wanted`; `wide`, `tall`: the sides of the terrain's rectangle."""
    wx, wy = wide / (columns - 1), tall / (rows - 1)
    u0, v0 = (x + wide / 2) / wx, (y + tall / 2) / wy
    du, dv = dx / wx, dy / wy
    du, dv = tl.where(tl.abs(du) > 1e-9, du, 1e-9), tl.where(tl.abs(dv) > 1e-9, dv, 1e-9)
    across, down, step = 1.0 / du, 1.0 / dv, 0.5 * (wx + wy)
    right, under = (du > 0).to(tl.int32), (dv > 0).to(tl.int32)
    lowest, x0, x1 = tl.load(EXTENT), tl.load(EXTENT + 1), tl.load(EXTENT + 2)
    y0, y1 = tl.load(EXTENT + 3), tl.load(EXTENT + 4)
    first = tl.maximum(((1 - right) * (columns - 1) - u0) * across, ((1 - under) * (rows - 1) - v0) * down)
    first = tl.maximum(first, 1.5 * step) + 1e-6
    r = tl.minimum((right * (columns - 1) - u0) * across, (under * (rows - 1) - v0) * down)
    r = tl.minimum(r, reach) - 1e-6
    first = tl.maximum(first, (tl.where(right > 0, x0, x1) - u0) * across)
    first = tl.maximum(first, (tl.where(under > 0, y0, y1) - v0) * down)
    r = tl.minimum(r, (tl.where(right > 0, x1, x0) - u0) * across - 1e-4)
    r = tl.minimum(r, (tl.where(under > 0, y1, y0) - v0) * down - 1e-4)
    passed, limit = above_high, above_high
    r = tl.where(limit < 0, tl.minimum(r, (lowest - z) / limit), r)
    active = wanted & (r > first) & (z * 0 + lowest < float("inf"))
    check, enter = active, first
    while tl.max(active.to(tl.int32), 0) > 0:
        u, v = u0 + r * du, v0 + r * dv
        i = tl.minimum(tl.maximum(tl.where(active, u, 0.0).to(tl.int32), 0), columns - 2)
        j = tl.minimum(tl.maximum(tl.where(active, v, 0.0).to(tl.int32), 0), rows - 2)
        check = check & active
        bi, bj = i // LARGE_CELLS, j // LARGE_CELLS
        drop = tl.load(LARGE + bj * large_columns + bi, mask=check, other=0.0) - z
        far = tl.maximum(((bi + 1 - right) * LARGE_CELLS - u0) * across, ((bj + 1 - under) * LARGE_CELLS - v0) * down)
        far = tl.maximum(far, first)
        over = check & (drop >= limit * tl.where(drop < 0, far, r))
        bi, bj = i // SMALL_CELLS, j // SMALL_CELLS
        drop = tl.load(SMALL + bj * small_columns + bi, mask=check, other=0.0) - z
        near = tl.maximum(((bi + 1 - right) * SMALL_CELLS - u0) * across, ((bj + 1 - under) * SMALL_CELLS - v0) * down)
        near = tl.maximum(near, first)
        skipped = over | (check & (drop >= limit * tl.where(drop < 0, near, r)))
        enter = tl.where(check & (skipped == 0), near, enter)
        go = active & (skipped == 0)
        a, b, at = u - i, v - j, TERRAIN + j * columns + i
        rise = (1 - b) * ((1 - a) * tl.load(at, mask=go, other=0.0) + a * tl.load(at + 1, mask=go, other=0.0))
        at += columns
        rise += b * ((1 - a) * tl.load(at, mask=go, other=0.0) + a * tl.load(at + 1, mask=go, other=0.0))
        rise -= z
        hit = go & (rise < limit * r)
        passed = tl.where(hit, rise / r, passed)
        limit = tl.where(hit, tl.where(passed <= above_low, tl.minimum(passed, below_high), passed), limit)
        nearer = r - (step + 0.04 * r)
        r = tl.where(go, nearer, tl.where(active, tl.minimum(tl.where(over, far, near), r) - 1e-4, r))
        check = (go == 0) | (r <= enter)
        active = active & ((hit & (passed <= below_low)) == 0) & (r > first)
    return passed


@triton.jit
def _entry(at, across, down, up, w00, w01, w10, w11, share, there):
    """A number of the table of light between its entries."""
    near = w00 * tl.load(at, mask=there, other=0.0) + w01 * tl.load(at + across, mask=there, other=0.0)
    at += down
    near += w10 * tl.load(at, mask=there, other=0.0) + w11 * tl.load(at + across, mask=there, other=0.0)
    at += up - down
    far = w00 * tl.load(at, mask=there, other=0.0) + w01 * tl.load(at + across, mask=there, other=0.0)
    at += down
    far += w10 * tl.load(at, mask=there, other=0.0) + w11 * tl.load(at + across, mask=there, other=0.0)
    return near + share * (far - near)


@triton.jit
def _cell(place, count):
    """The entry before a place of a table along one axis, and the share of the way to the next."""
    place = tl.minimum(tl.maximum(place, 0.0), count - 1.001)
    entry = place.to(tl.int32)
    return entry, place - entry


@triton.jit
def _bundle(ex, ey, ez, half, nx, ny, nz):
    """strip_light_table.incident: SIDE, LOW, HIGH and TURN of a column's light."""
    side = tl.sqrt(ex * ex + ey * ey)
    each = 1.0 / tl.maximum(side, 1e-30)
    slope, turn = ez * each, -(nx * ex + ny * ey) * each / nz
    return side / (half + half), slope - half, tl.minimum(slope + half, turn), turn


@triton.jit
def _ggx(turn, ci, co, alpha):
    """strip_light.ggx."""
    ch2, a2 = (ci + co) * (ci + co) / (2.0 + 2.0 * turn), alpha * alpha
    q = ch2 * (a2 - 1.0) + 1.0
    g = 4 * ci * co / ((ci + tl.sqrt(a2 + (1 - a2) * ci * ci)) * (co + tl.sqrt(a2 + (1 - a2) * co * co)))
    return a2 / (3.141592653589793 * q * q) * g / (4 * ci)


@triton.jit
def _lit(edge, side, low, high, turn, lit, rho, rise, nz, ci, vside, vz, alpha, GLOSSY: tl.constexpr):
    """Light of a column, direct or reflected, by a white matt coat and by a rough mirror; vside: the part of the
    direction toward the camera along that toward the light."""
    top = tl.minimum(edge, high)
    there = lit & (top > low)
    top = tl.where(there, top, low + 1.0)
    side = tl.where(there, side * (top - low) / (rho * rho + rise * rise), 0.0)
    turn = tl.where(there, turn, 0.0)
    seen = 0.5 * (top + low)
    white, bright = -side * nz * (turn - seen), side * 0.0
    if GLOSSY:
        spread = (top - low) / 3.4641016151377544  # Gauss's points
        for sign in tl.static_range(2):
            steep = seen + (2 * sign - 1) * spread
            long = tl.sqrt(1.0 + steep * steep)
            toward = (vside + vz * steep) / long
            bright += 0.5 * side * long * _ggx(toward, ci, -nz * (turn - steep) / long, alpha)
    return white, bright


@triton.jit
def _painted(x, y, COUNTS, rows, reaching, across, down, radius, edge, there):
    """coating.painted: the share of paint at rest positions; at most `reaching` rows are near enough."""
    last, away2 = (rows - 1) / 2.0, x * 0 + float("inf")
    level, reach = y / down + last, (radius + edge / 2) / down
    row = tl.maximum(tl.ceil(level - reach), 0.0)
    for _ in range(reaching):
        near = there & (row <= tl.minimum(level + reach, 2 * last))
        end = (tl.load(COUNTS + tl.where(near, row, 0.0).to(tl.int32), mask=near, other=1) - 1) / 2.0
        dot = tl.minimum(tl.maximum(tl.floor(x / across + end + 0.5) - end, -end), end)
        dx, dy = x - dot * across, (level - row) * down
        away2 = tl.where(near, tl.minimum(away2, dx * dx + dy * dy), away2)
        row += 1.0
    return tl.minimum(tl.maximum((radius - tl.sqrt(away2)) / edge + 0.5, 0.0), 1.0)


@triton.jit
def _woven(x, y, TEXTURE, rows, columns, wide, tall, there):
    """coat_texture.sampled: the coating's pattern at rest positions."""
    u = tl.minimum(tl.maximum((x / wide + 0.5) * columns - 0.5, 0.0), columns - 1.0)
    v = tl.minimum(tl.maximum((y / tall + 0.5) * rows - 0.5, 0.0), rows - 1.0)
    left, top = tl.minimum(u.to(tl.int32), columns - 2), tl.minimum(v.to(tl.int32), rows - 2)
    a, b, at = u - left, v - top, TEXTURE + tl.where(there, top * columns + left, 0)
    above = (1 - a) * tl.load(at) + a * tl.load(at + 1)
    below = (1 - a) * tl.load(at + columns) + a * tl.load(at + columns + 1)
    return tl.where(there, (1 - b) * above + b * below, 1.0)


@triton.jit
def light(
    KEYS, FACES, SCREEN, NODES, FACING, REST, TERRAIN, SMALL, LARGE, EXTENT, TOWARD, PASSED, TABLE, MIDDLE, STRIP,
    CORNER, MATT, GLOSS, GLOW, LEVEL, DOTS, COLOURS, TEXTURE, OUT,
    samples, width, nodes, rows, columns, small_rows, small_columns, large_rows, large_columns, wide, tall,
    heights, places_down, places_across, lamps, mirror, alpha, steepest, most_turn,
    dot_rows, dots_reaching, dot_across, dot_down, dot_radius, dot_edge, dot_x, dot_y, texture_rows, texture_columns,
    GLOSSY: tl.constexpr, PAINT: tl.constexpr, WOVEN: tl.constexpr,
    SMALL_CELLS: tl.constexpr, LARGE_CELLS: tl.constexpr, SAMPLES: tl.constexpr,
):  # fmt: skip
    """Radiance (F, samples, 3) of the coated face before the picture is blurred.

    PAINT: 0 for a coat without dots, 1 for dots on a matt one, 2 for dots on a glossy one. COLOURS (4, 3): the change
    under full paint, the stray light, the coat's reflectance, the paint's.
    """
    s, frame = tl.program_id(0) * SAMPLES + tl.arange(0, SAMPLES), tl.program_id(1).to(tl.int64)
    kept = s < samples
    key = tl.load(KEYS + frame * samples + s, mask=kept, other=0x7FFFFFFFFFFFFFFF)
    there = key != 0x7FFFFFFFFFFFFFFF
    face = tl.where(there, key & 0xFFFFFFFF, 0)
    k1, k2, k3, v, w = placed(face, s % width + 0.5, s // width + 0.5, FACES, SCREEN + 2 * frame * nodes)
    v, w = v.to(tl.float32), w.to(tl.float32)
    t = 1.0 - v - w
    N, D = NODES + 3 * frame * nodes, FACING + 3 * frame * nodes
    x = t * tl.load(N + 3 * k1) + v * tl.load(N + 3 * k2) + w * tl.load(N + 3 * k3)
    y = t * tl.load(N + 3 * k1 + 1) + v * tl.load(N + 3 * k2 + 1) + w * tl.load(N + 3 * k3 + 1)
    z = t * tl.load(N + 3 * k1 + 2) + v * tl.load(N + 3 * k2 + 2) + w * tl.load(N + 3 * k3 + 2)
    nx = t * tl.load(D + 3 * k1) + v * tl.load(D + 3 * k2) + w * tl.load(D + 3 * k3)
    ny = t * tl.load(D + 3 * k1 + 1) + v * tl.load(D + 3 * k2 + 1) + w * tl.load(D + 3 * k3 + 1)
    nz = t * tl.load(D + 3 * k1 + 2) + v * tl.load(D + 3 * k2 + 2) + w * tl.load(D + 3 * k3 + 2)
    scale = 1.0 / tl.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    vx = tl.load(TOWARD + 3 * s, mask=kept, other=0.0)
    vy = tl.load(TOWARD + 3 * s + 1, mask=kept, other=0.0)
    vz = tl.load(TOWARD + 3 * s + 2, mask=kept, other=-1.0)
    ci = tl.maximum(nx * vx + ny * vy + nz * vz, 0.05)
    steep = tl.minimum(nz, steepest)
    i, a = _cell((x - tl.load(CORNER)) / tl.load(CORNER + 3), places_across)
    j, b = _cell((y - tl.load(CORNER + 1)) / tl.load(CORNER + 4), places_down)
    k, share = _cell((z - tl.load(CORNER + 2)) / tl.load(CORNER + 5), heights)
    step = 9 * lamps  # numbers of one place
    down, up = step * places_across, step * places_across * places_down
    first = TABLE + tl.where(there, k * up + j * down + i * step, 0)
    w00, w01, w10, w11 = (1 - b) * (1 - a), (1 - b) * a, b * (1 - a), b * a
    T, S, L = TERRAIN + frame * rows * columns, SMALL + frame * small_rows * small_columns, LARGE
    L += frame * large_rows * large_columns
    red, green, blue, arrived_r, arrived_g, arrived_b = x * 0, x * 0, x * 0, x * 0, x * 0, x * 0
    for c in range(lamps):
        at = first + c
        px = _entry(at, step, down, up, w00, w01, w10, w11, share, there)
        qx = _entry(at + lamps, step, down, up, w00, w01, w10, w11, share, there)
        py = _entry(at + 2 * lamps, step, down, up, w00, w01, w10, w11, share, there)
        qy = _entry(at + 3 * lamps, step, down, up, w00, w01, w10, w11, share, there)
        pz = _entry(at + 4 * lamps, step, down, up, w00, w01, w10, w11, share, there)
        qz = _entry(at + 5 * lamps, step, down, up, w00, w01, w10, w11, share, there)
        ph = _entry(at + 6 * lamps, step, down, up, w00, w01, w10, w11, share, there)
        qh = _entry(at + 7 * lamps, step, down, up, w00, w01, w10, w11, share, there)
        free = _entry(at + 8 * lamps, step, down, up, w00, w01, w10, w11, share, there)
        p_side, p_low, p_high, p_turn = _bundle(px, py, pz, ph, nx, ny, steep)
        q_side, q_low, q_high, q_turn = _bundle(qx, qy, qz, qh, nx, ny, steep)
        p_top, q_top = tl.minimum(p_high, free), tl.minimum(q_high, free)
        p_lit, q_lit = there & (p_side > 0) & (p_low < p_top), there & (q_side > 0) & (q_low < q_top)
        mx, my, mz = tl.load(MIDDLE + 3 * c), tl.load(MIDDLE + 3 * c + 1), tl.load(MIDDLE + 3 * c + 2)
        dx, dy = mx - x, my - y
        rho = tl.maximum(tl.sqrt(dx * dx + dy * dy), 1e-9)
        dx, dy = dx / rho, dy / rho
        above_low, above_high = tl.where(p_lit, p_low, q_low), tl.where(p_lit, p_top, q_top)
        below_low, below_high = tl.where(q_lit, q_low, above_low), tl.where(q_lit, q_top, above_high)
        edge = _horizon(
            T, S, L, EXTENT + 5 * frame, rows, columns, small_columns, large_columns, wide, tall, x, y, z, dx, dy, rho,
            above_low, above_high, below_low, below_high, p_lit | q_lit, SMALL_CELLS, LARGE_CELLS,
        )  # fmt: skip
        edge = tl.minimum(edge, free)
        vside = vx * dx + vy * dy
        white, bright = _lit(
            edge, p_side, p_low, p_high, p_turn, p_lit, rho, mz - z, steep, ci, vside, vz, alpha, GLOSSY
        )
        more, shine = _lit(
            edge, q_side, q_low, q_high, q_turn, q_lit, rho, 2 * mirror - mz - z, steep, ci, vside, vz, alpha, GLOSSY
        )
        white, bright, strip = (white + more) / 3.141592653589793, bright + shine, tl.load(STRIP + c)
        M, G = MATT + 6 * strip, GLOSS + 6 * strip
        red += white * tl.load(M) + bright * tl.load(G)
        green += white * tl.load(M + 1) + bright * tl.load(G + 1)
        blue += white * tl.load(M + 2) + bright * tl.load(G + 2)
        if PAINT == 2:
            arrived_r += white * tl.load(M + 3)
            arrived_g += white * tl.load(M + 4)
            arrived_b += white * tl.load(M + 5)
    passes = tl.load(PASSED + s, mask=kept, other=0.0)
    turned_x = tl.load(LEVEL + 2 * s, mask=kept, other=0.0)
    turned_y = tl.load(LEVEL + 2 * s + 1, mask=kept, other=0.0)
    turned_x = tl.minimum(tl.maximum(nx - turned_x, -most_turn), most_turn)
    turned_y = tl.minimum(tl.maximum(ny - turned_y, -most_turn), most_turn)
    paint, factor = x * 0, x * 0 + 1.0
    rx = t * tl.load(REST + 2 * k1) + v * tl.load(REST + 2 * k2) + w * tl.load(REST + 2 * k3)
    ry = t * tl.load(REST + 2 * k1 + 1) + v * tl.load(REST + 2 * k2 + 1) + w * tl.load(REST + 2 * k3 + 1)
    if PAINT:
        x_off, y_off = rx - dot_x, ry - dot_y  # from the lattice's middle
        paint = _painted(x_off, y_off, DOTS, dot_rows, dots_reaching, dot_across, dot_down, dot_radius, dot_edge, there)
        paint = tl.where(there, paint, 0.0)
    if WOVEN:
        factor = _woven(rx, ry, TEXTURE, texture_rows, texture_columns, wide, tall, there)
    for c in tl.static_range(3):
        seen = red if c == 0 else (green if c == 1 else blue)
        arrived = arrived_r if c == 0 else (arrived_g if c == 1 else arrived_b)
        P = GLOW + 15 * s + c
        one, along = tl.load(P, mask=kept, other=0.0), tl.load(P + 3, mask=kept, other=0.0)
        across, bent = tl.load(P + 6, mask=kept, other=0.0), tl.load(P + 9, mask=kept, other=0.0)
        curled = tl.load(P + 12, mask=kept, other=0.0)
        bounced = one + turned_x * (along + turned_x * bent) + turned_y * (across + turned_y * curled)
        bounced = tl.where(there, tl.maximum(bounced, 0.0), 0.0)
        seen = tl.where(there, passes * seen, 0.0) + bounced
        change = paint * tl.load(COLOURS + c)
        if PAINT == 2:
            arrived = tl.where(there, passes * arrived, 0.0) + bounced / tl.load(COLOURS + 6 + c)
            seen += paint * (tl.load(COLOURS + 9 + c) * arrived - seen)
        else:
            seen *= 1.0 + change
        seen += tl.load(COLOURS + 3 + c) * (1.0 + change)
        tl.store(OUT + 3 * (frame * samples + s) + c, seen * factor, mask=kept)
