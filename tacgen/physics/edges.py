"""Exact distance to the triangles near sharp edges of a mesh; see geometry.exact_edges."""

import warp as wp

from tacgen.physics.splines import CELL, COEFFICIENTS, NODES, ORIGIN, Distance, place, steps, weights
from tacgen.physics.types import Ints, Ints3, Reals, Reals2, real

MAX_TIED_DISTANCES = 16  # distances that are about as small at one point
# distance over the radius up to which contact may act [-]: normals and curvatures beyond are the spline's
MAX_CONTACT_RADII = 3.0
SINGLE_PRECISION_MM = 1e-5  # rounding error of distances in single precision [mm]
MIN_CORE_DISTANCE_MM = 1e-9  # distance from the core [mm] within which its direction is rounding error
TRIANGLE_NUMBERS = 30  # of a triangle: corners a, b, c, and outward normals of face, edges and corners
# numbers of a field with exact edges in its row of `shapes`: their radius [mm], 0 without; where in `values` the share,
# the distances of the lists and the triangles begin; where in `lists` the number of each cell's list, the lists' first
# places, the lists and the triangles' bodies begin; how many numbers a row has
RADIUS, SHARE, AWAY, TRIANGLES, LIST, START, NEAR, BODY, ROW_NUMBERS = (wp.constant(k) for k in range(9, 18))
FAR = wp.constant(real(1.0 + MAX_CONTACT_RADII))
NONE = wp.constant(real(MIN_CORE_DISTANCE_MM))
ROUNDING = wp.constant(real(SINGLE_PRECISION_MM))
FACE, EDGES, CORNERS = (wp.constant(k) for k in (3, 4, 7))  # rows of a triangle's normals
INFINITE = wp.constant(real(float("inf")))
THIRD = wp.constant(real(1.0 / 3.0))
# where in a row are places in `values`, and in `lists`: they change where indenters of a batch stand together
FIRST_VALUE, FIRST_LIST = (COEFFICIENTS, SHARE, AWAY, TRIANGLES), (LIST, START, NEAR, BODY)
MOST_TIED = wp.constant(MAX_TIED_DISTANCES)
Tied = wp.types.matrix(shape=(MAX_TIED_DISTANCES, 3), dtype=real)


@wp.func
def row_of(values: Reals, triangle: int, row: int) -> wp.vec3d:
    """A corner or a normal of the triangle that begins at this place."""
    i = triangle + 3 * row
    return wp.vec3d(values[i], values[i + 1], values[i + 2])


@wp.func
def closest(values: Reals, triangle: int, p: wp.vec3d) -> tuple[int, wp.vec3d]:
    """The row of a triangle with the normal at its point closest to p: 3 of the face, 4 5 6 of edges, 7 8 9 of corners;
    and that point. Source: Ericson (2005), Real-Time Collision Detection, 5.1.5."""
    a, b, c = row_of(values, triangle, 0), row_of(values, triangle, 1), row_of(values, triangle, 2)
    ab, ac = b - a, c - a
    d1, d2 = wp.dot(ab, p - a), wp.dot(ac, p - a)
    d3, d4 = wp.dot(ab, p - b), wp.dot(ac, p - b)
    d5, d6 = wp.dot(ab, p - c), wp.dot(ac, p - c)
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    zero = real(0.0)
    if d1 <= zero and d2 <= zero:
        return CORNERS, a
    if d3 >= zero and d4 <= d3:
        return CORNERS + 1, b
    if d6 >= zero and d5 <= d6:
        return CORNERS + 2, c
    if vc <= zero and d1 >= zero and d3 <= zero:
        return EDGES, a + d1 / (d1 - d3) * ab
    if vb <= zero and d2 >= zero and d6 <= zero:
        return EDGES + 2, a + d2 / (d2 - d6) * ac
    if va <= zero and d4 - d3 >= zero and d5 - d6 >= zero:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return EDGES + 1, a + (real(1.0) - w) * ab + w * ac
    return FACE, a + vb / (va + vb + vc) * ab + vc / (va + vb + vc) * ac


@wp.func
def edge_of(values: Reals, triangle: int, row: int) -> wp.vec3d:
    """The edge with the normal in this row, from its first corner to its second."""
    return row_of(values, triangle, (row - 3) % 3) - row_of(values, triangle, row - 4)


@wp.func
def bend(values: Reals, triangle: int, row: int, n: wp.vec3d, length: real) -> wp.mat33d:
    """Hessian of the distance from the point of a triangle that `row` names, `length` away along n."""
    if row == FACE:
        return wp.mat33d()
    D = wp.identity(n=3, dtype=real) - wp.outer(n, n)
    if row < CORNERS:  # along an edge there is no curvature
        edge = edge_of(values, triangle, row)
        edge = edge / wp.length(edge)
        D = D - wp.outer(edge, edge)
    return D / length


@wp.func
def is_lowest(values: Reals, triangle: int, row: int, n: wp.vec3d) -> bool:
    """Whether the point of a triangle that `row` names, from which n leads to a point outside, is closest to that of
    all the surface around it. A corner is taken for one that is not."""
    normal = row_of(values, triangle, row)
    if row >= CORNERS or wp.dot(n, normal) <= real(0.0):
        return False
    if row == FACE:
        return True
    face = row_of(values, triangle, FACE)
    beyond = normal - face / wp.length(face)  # the other face's normal
    # the edge runs against that face's orientation, so its cross product points from the edge into the face
    return wp.dot(n, wp.cross(edge_of(values, triangle, row), beyond)) <= real(0.0)


@wp.func
def nearest(
    shapes: Reals2, values: Reals, lists: Ints, s: int, p: wp.vec3d, begin: int, end: int, gap: real
) -> tuple[real, int, int, wp.vec3d]:
    """The smallest signed distance from the opened bodies at p, `gap` [mm] from the middle of its cell, whose list is
    from `begin` to `end`: from which triangle, its row, and its closest point."""
    near, away, body = int(shapes[s, NEAR]), int(shapes[s, AWAY]), int(shapes[s, BODY])
    triangles = int(shapes[s, TRIANGLES])
    alone = lists[body + lists[near + begin]] == lists[body + lists[near + end - 1]]
    length, which, row, point = real(INFINITE), int(0), int(FACE), wp.vec3d()
    least, t, found, c = real(INFINITE), int(0), int(FACE), wp.vec3d()
    for m in range(begin, end):
        triangle = triangles + TRIANGLE_NUMBERS * lists[near + m]
        if values[away + m] - gap < least:  # else it is farther than one before
            one, at = closest(values, triangle, p)
            far = wp.length(at - p)
            if far < least:
                least = far
                t = triangle
                found = one
                c = at
        last = m + 1 == end
        if alone and not last:
            last = values[away + m + 1] - gap >= least
        done = last  # with a body: lists are in order of their bodies
        if not alone and not last:
            done = lists[body + lists[near + m + 1]] != lists[body + lists[near + m]]
        if done:
            signed = least
            if wp.dot(p - c, row_of(values, t, found)) < real(0.0):
                signed = -least
            if signed < length:
                length = signed
                which = t
                row = found
                point = c
            least = real(INFINITE)
        if last:
            break
    return length, which, row, point


@wp.func
def rounded(
    shapes: Reals2, values: Reals, lists: Ints, s: int, p: wp.vec3d, begin: int, end: int, gap: real, point: wp.vec3d,
    lowest: Distance,
) -> Distance:  # fmt: skip
    """The smallest distance, from `point`, where others are nearly as small, above a crease: the normal would jump from
    one face to the other. Each other distance that is lowest on its part of the surface, larger by u < k, lowers it by

        (k - u)^3 / (6 k^2),    k = radius (1 - cosine of the angle between the normals),

    which is C2, and zero where a face ends at the crease (there u >= k).
    """
    out, known, count = lowest, Tied(), int(1)
    known[0] = point
    radius, first, bent = shapes[s, RADIUS], lowest.n, lowest.H
    near, away, triangles = int(shapes[s, NEAR]), int(shapes[s, AWAY]), int(shapes[s, TRIANGLES])
    for i in range(begin, end):
        if count == MOST_TIED or values[away + i] - gap > lowest.d + real(2.0) * radius:
            continue
        triangle = triangles + TRIANGLE_NUMBERS * lists[near + i]
        row, at = closest(values, triangle, p)
        m = p - at
        length = wp.length(m)
        k, u = radius * (real(1.0) - wp.dot(first, m) / length), length - lowest.d
        if u >= k:
            continue
        m = m / length
        if not is_lowest(values, triangle, row, m):
            continue
        again = bool(False)
        for j in range(count):
            again = again or wp.length(known[j] - at) < NONE
        if again:  # an edge of two triangles
            continue
        known[count] = at
        count += 1
        E = bend(values, triangle, row, m, length)
        part = (k - u) / k
        slope = -radius * (bent * m + E * first)
        v = m - first - u / k * slope
        half = part * part / real(2.0)
        out.d -= k * part * part * part / real(6.0)
        out.n += half * (m - first) - (half - part * part * part * THIRD) * slope
        out.H += half * (E - bent) - part / k * wp.outer(v, v)
    return out


@wp.func
def blend(shapes: Reals2, values: Reals, s: int, first: wp.vec3i, t: wp.vec3d) -> Distance:
    """The exact distance's share at a point in the cell after node `first`, with its slopes and bends over the cell."""
    out = Distance()
    u0, u1, u2 = weights(t[0])
    v0, v1, v2 = weights(t[1])
    w0, w1, w2 = weights(t[2])
    plane, row = steps(shapes, s)
    start = int(shapes[s, SHARE]) + (first[0] - 1) * plane + (first[1] - 1) * row + first[2] - 1
    xy, xz, yz = real(0.0), real(0.0), real(0.0)
    for i in range(4):
        for j in range(4):
            for k in range(4):
                q = values[start + i * plane + j * row + k]
                if q != real(0.0):
                    x, y, z = u0[i], v0[j], w0[k]
                    out.d += q * x * y * z
                    out.n += q * wp.vec3d(u1[i] * y * z, x * v1[j] * z, x * y * w1[k])
                    out.H[0, 0] += q * u2[i] * y * z
                    out.H[1, 1] += q * x * v2[j] * z
                    out.H[2, 2] += q * x * y * w2[k]
                    xy += q * u1[i] * v1[j] * z
                    xz += q * u1[i] * y * w1[k]
                    yz += q * x * v1[j] * w1[k]
    out.H += wp.mat33d(real(0.0), xy, xz, xy, real(0.0), yz, xz, yz, real(0.0))
    return out


@wp.func
def sharpened(shapes: Reals2, values: Reals, lists: Ints, s: int, p: wp.vec3d, plain: Distance) -> Distance:
    """The distance `plain` of the spline, which near edges passes into the exact one; see exact_edges.SharpField."""
    at, cell, radius = place(shapes, s, p), shapes[s, CELL], shapes[s, RADIUS]
    first = wp.vec3i()
    for a in range(3):
        if not (at[a] >= real(1.0) and at[a] <= shapes[s, NODES + a] - real(2.0)):
            return plain
        first[a] = wp.min(int(at[a]), int(shapes[s, NODES + a]) - 3)
    plane, row = steps(shapes, s)
    number = lists[int(shapes[s, LIST]) + first[0] * plane + first[1] * row + first[2]]
    if number < 0:
        return plain
    t = at - wp.vec3d(real(first[0]), real(first[1]), real(first[2]))
    share = blend(shapes, values, s, first, t)
    gap = wp.length(t - wp.vec3d(real(0.5), real(0.5), real(0.5))) * cell + ROUNDING
    begin, end = lists[int(shapes[s, START]) + number], lists[int(shapes[s, START]) + number + 1]
    length, which, found, point = nearest(shapes, values, lists, s, p, begin, end, gap)
    out = plain
    if length > FAR * radius:
        out.d += share.d * (length - radius - plain.d)
        return out
    exact = Distance()
    exact.d = length
    if wp.abs(length) < NONE:  # the direction outward
        normal = row_of(values, which, found)
        exact.n = normal / wp.length(normal)
    else:
        exact.n = (p - point) / length
        exact.H = bend(values, which, found, exact.n, length)
        if length > real(0.0):
            exact = rounded(shapes, values, lists, s, p, begin, end, gap, point, exact)
    more, turn = exact.d - radius - plain.d, exact.n - plain.n
    cross = wp.outer(share.n, turn)
    out.d += share.d * more
    out.n += share.d * turn + more / cell * share.n
    out.H += share.d * (exact.H - plain.H) + (cross + wp.transpose(cross)) / cell + more / (cell * cell) * share.H
    return out


@wp.kernel(enable_backward=False, module="tacgen.physics")
def listed(
    shapes: Reals2, values: Reals, first: Ints3, reach: Reals, most: real, place: Ints, counts: Ints, near: Ints,
    away: Reals,
):  # fmt: skip
    """Number (m,) of triangles no farther from the middle of each cell, which `first` numbers, than its `reach` (m,),
    at most `most` [mm]; with `place` (m,), where the lists begin, they are written to `near`, and their distances to
    `away`. One thread."""
    cell, triangles = shapes[0, CELL], int(shapes[0, TRIANGLES])
    origin = wp.vec3d(shapes[0, ORIGIN], shapes[0, ORIGIN + 1], shapes[0, ORIGIN + 2])
    low, high = wp.vec3i(), wp.vec3i()
    for t in range((values.shape[0] - triangles) // TRIANGLE_NUMBERS):
        triangle = triangles + TRIANGLE_NUMBERS * t
        a, b, c = row_of(values, triangle, 0), row_of(values, triangle, 1), row_of(values, triangle, 2)
        for k in range(3):
            lower = wp.min(a[k], wp.min(b[k], c[k])) - most
            upper = wp.max(a[k], wp.max(b[k], c[k])) + most
            low[k] = wp.max(0, int(wp.floor((lower - origin[k]) / cell - real(0.5))))
            high[k] = wp.min(first.shape[k] - 1, int(wp.ceil((upper - origin[k]) / cell - real(0.5))))
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    number = first[i, j, k]
                    if number >= 0:
                        middle = origin + cell * (
                            wp.vec3d(real(i), real(j), real(k)) + wp.vec3d(real(0.5), real(0.5), real(0.5))
                        )
                        _, at = closest(values, triangle, middle)
                        length = wp.length(at - middle)
                        if length <= reach[number]:
                            if place.shape[0] > 0:
                                near[place[number] + counts[number]] = t
                                away[place[number] + counts[number]] = length
                            counts[number] = counts[number] + 1
