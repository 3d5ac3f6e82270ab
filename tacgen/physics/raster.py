"""Rasterisation of sheets of triangles, as Warp kernels: what lies behind each sample of a picture, and what is hidden.

Arrays are flat, the frame first, since a core addresses flat arrays twice as fast: screen (f n,) places of the nodes in
samples, sample centres at +0.5; near (f n,) their distances from the viewer; faces (t,) node numbers. Of the triangles
behind a sample that with the smallest key wins: its depth there in single precision, as an integer of its order, then
its number. So the result does not depend on the order in which threads run.
"""

import warp as wp

from tacgen.physics.flat import get, is_nan, put
from tacgen.physics.types import HALF, Flags, Ints, Longs, Pairs, Reals, Triples, real

# weight of a node below which a sample lies beside the triangle, so that none falls between two [-]
EDGE_SLACK = -1e-12
EMPTY_SAMPLE_KEY = (1 << 63) - 1  # key of a sample behind which no triangle lies
EMPTY = wp.constant(wp.int64(EMPTY_SAMPLE_KEY))
SLACK = wp.constant(real(EDGE_SLACK))
NOWHERE = wp.constant(real(wp.nan))  # a value where no triangle lies
DEPTH_BITS = wp.constant(wp.int64(32))  # place of the depth in a key
NUMBER_MASK = wp.constant(wp.int64(0xFFFFFFFF))  # of the triangle's number in a key


@wp.func
def key_of(depth: real, t: int) -> wp.int64:
    """A key whose order is that of depths, then of triangles."""
    bits = wp.cast(wp.float32(depth), wp.int32)
    ordered = bits ^ ((bits >> 31) & 0x7FFFFFFF)
    return (wp.int64(ordered) << DEPTH_BITS) | wp.int64(t)


@wp.func
def triangle_of(key: wp.int64) -> int:
    """The triangle of a key, -1 where none lies."""
    return wp.where(key == EMPTY, -1, int(key & NUMBER_MASK))


@wp.func
def sides(at: Pairs, first: int, face: wp.vec3i) -> wp.mat33d:
    """A triangle's first node and the ways from it to the second and third, as rows, and as last number twice its area,
    positive where its nodes turn from x to y; `first`: where the frame's nodes begin."""
    a, b, c = get(at, first + face[0]), get(at, first + face[1]), get(at, first + face[2])
    return wp.mat33d(
        a[0], a[1], real(0.0), b[0] - a[0], b[1] - a[1], real(0.0), c[0] - a[0], c[1] - a[1],
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]),
    )  # fmt: skip


@wp.func
def weights(side: wp.mat33d, x: real, y: real) -> wp.vec2d:
    """Weights of a triangle's second and third node at a place, by its `sides`."""
    dx, dy, scale = x - side[0, 0], y - side[0, 1], real(1.0) / side[2, 2]
    return wp.vec2d((dx * side[2, 1] - dy * side[2, 0]) * scale, (side[1, 0] * dy - side[1, 1] * dx) * scale)


@wp.kernel(enable_backward=False, module="tacgen.physics")
def rasterized(
    faces: Triples, screen: Pairs, near: Reals, nodes: int, height: int, width: int, keys: Longs, turned: Ints
):
    """The least keys (f h w,) of the triangles behind each sample, EMPTY before; a thread for each frame and triangle.

    turned (2 f,), 0 before: 1 where a triangle shows its back, and where one shows its front.
    """
    t = wp.tid()
    f = int(0)
    if t >= faces.shape[0]:
        f = t / faces.shape[0]
        t -= f * faces.shape[0]
    face, first = get(faces, t), f * nodes
    side = sides(screen, first, face)
    if side[2, 2] == real(0.0) or is_nan(side[2, 2] - side[2, 2]):
        return
    turned[2 * f + wp.where(side[2, 2] > real(0.0), 1, 0)] = 1
    ax, ay = side[0, 0], side[0, 1]
    scale = real(1.0) / side[2, 2]
    bx, by, cx, cy = side[1, 0], side[1, 1], side[2, 0], side[2, 1]
    wide, tall = real(width), real(height)
    left = int(wp.clamp(wp.ceil(ax + wp.min(wp.min(bx, cx), real(0.0)) - HALF), real(0.0), wide))
    right = int(wp.clamp(wp.floor(ax + wp.max(wp.max(bx, cx), real(0.0)) - HALF), real(-1.0), wide - real(1.0)))
    top = int(wp.clamp(wp.ceil(ay + wp.min(wp.min(by, cy), real(0.0)) - HALF), real(0.0), tall))
    bottom = int(wp.clamp(wp.floor(ay + wp.max(wp.max(by, cy), real(0.0)) - HALF), real(-1.0), tall - real(1.0)))
    bx, by, cx, cy = scale * bx, scale * by, scale * cx, scale * cy
    za, zb, zc = get(near, first + face[0]), get(near, first + face[1]), get(near, first + face[2])
    j = int(top)
    while j <= bottom:
        y, start = real(j) + HALF - ay, (f * height + j) * width
        above, below = y * cx, bx * y
        i = int(left)
        while i <= right:
            x = real(i) + HALF - ax
            v, w = x * cy - above, below - by * x
            u = real(1.0) - v - w
            if u >= SLACK and v >= SLACK and w >= SLACK:
                wp.atomic_min(keys, start + i, key_of(u * za + v * zb + w * zc, t))
            i += 1
        j += 1


@wp.kernel(enable_backward=False, module="tacgen.physics")
def placed(keys: Longs, faces: Triples, screen: Pairs, width: int, triangle: Ints, place: Pairs):
    """Triangles (h w,) of a frame's keys, -1 where none lies, and the weights of their second and third node there."""
    k = wp.tid()
    t = triangle_of(get(keys, k))
    put(triangle, k, t)
    if t >= 0:
        row = int((real(k) + HALF) / real(width))
        put(place, k, weights(sides(screen, 0, get(faces, t)), real(k - row * width) + HALF, real(row) + HALF))


@wp.kernel(enable_backward=False, module="tacgen.physics")
def blended(faces: Triples, triangle: Ints, place: Pairs, values: Reals, count: int, unit: bool, out: Reals):
    """Values (n, count) at samples of those at nodes (nodes, count), linear on triangles, nan where none lies; unit:
    each row divided by its length."""
    i = wp.tid()
    t, at = get(triangle, i), i * count
    k = int(0)
    if t < 0:
        while k < count:
            put(out, at + k, NOWHERE)
            k += 1
        return
    here, face = get(place, i), get(faces, t)
    v, w = here[0], here[1]
    u = real(1.0) - v - w
    a, b, c = face[0] * count, face[1] * count, face[2] * count
    square = real(0.0)
    while k < count:
        value = u * get(values, a + k) + v * get(values, b + k) + w * get(values, c + k)
        square += value * value
        put(out, at + k, value)
        k += 1
    if unit:
        scale = real(1.0) / wp.sqrt(square)
        while k > 0:
            k -= 1
            put(out, at + k, get(out, at + k) * scale)


@wp.kernel(enable_backward=False, module="tacgen.physics")
def hidden(
    faces: Triples, screen: Pairs, depth: Reals, at: Pairs, own: Reals, cell: Reals, height: int, width: int,
    slack: real, out: Flags,
):  # fmt: skip
    """Whether a triangle (t,) lies more than `slack` before points at (n,) of depth `own`, False before.

    The points are in the order of their `cell` (n,), floor(y) width + x, all in the picture.
    """
    face = faces[wp.tid()]
    side = sides(screen, 0, face)
    ax, ay = side[0, 0], side[0, 1]
    left = wp.max(ax + wp.min(wp.min(side[1, 0], side[2, 0]), real(0.0)), real(0.0))
    right = wp.min(ax + wp.max(wp.max(side[1, 0], side[2, 0]), real(0.0)), real(width) - real(1e-9))
    if side[2, 2] == real(0.0) or is_nan(side[2, 2] - side[2, 2]) or left > right:
        return
    za, zb, zc = depth[face[0]], depth[face[1]], depth[face[2]]
    nearest = wp.min(wp.min(za, zb), zc)
    top = wp.max(ay + wp.min(wp.min(side[1, 1], side[2, 1]), real(0.0)), real(0.0))
    bottom = wp.min(ay + wp.max(wp.max(side[1, 1], side[2, 1]), real(0.0)), real(height) - HALF)
    for row in range(int(wp.floor(top)), int(wp.floor(bottom)) + 1):
        i = wp.lower_bound(cell, real(row * width) + left)
        while i < cell.shape[0] and get(cell, i) <= real(row * width) + right:
            if get(own, i) - nearest > slack and not out[i]:
                place = weights(side, at[i][0], at[i][1])
                u = real(1.0) - place[0] - place[1]
                if place[0] >= real(0.0) and place[1] >= real(0.0) and u >= real(0.0):
                    out[i] = own[i] - (u * za + place[0] * zb + place[1] * zc) > slack
            i += 1
