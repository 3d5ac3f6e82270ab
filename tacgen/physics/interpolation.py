"""Interpolation of scattered values, as Warp kernels: a thin plate's basis, distances, and Clough & Tocher's cubics.

See geometry.thin_plate and geometry.clough_tocher for the formulas' sources.
"""

import warp as wp

from tacgen.physics.flat import get, put
from tacgen.physics.types import Ints, Pairs, Reals, Triples, real

LEAST_SQUARE = wp.constant(real(1e-300))  # of a distance whose logarithm is taken [mm^2]
MAX_WEIGHTS, MAX_ORDINATES = 9, 15  # of a triangle: its values and slopes, and the ordinates of its three cubics
WEIGHTS, ORDINATES = wp.constant(MAX_WEIGHTS), wp.constant(MAX_ORDINATES)
Shares = wp.types.vector(length=MAX_ORDINATES, dtype=real)


@wp.kernel(enable_backward=False, module="tacgen.physics")
def plate(at: Pairs, known: Pairs, out: Reals):
    """r^2 log(r) at points (m,) about known ones (n,), and a plane's three functions: (m, n + 3)."""
    i = wp.tid()
    p, n = at[i], known.shape[0]
    start = i * (n + 3)
    j = int(0)
    while j < n:
        off = p - get(known, j)
        square = wp.dot(off, off)
        put(out, start + j, real(0.5) * square * wp.log(wp.max(square, LEAST_SQUARE)))
        j += 1
    out[start + n] = real(1.0)
    out[start + n + 1] = p[0]
    out[start + n + 2] = p[1]


@wp.kernel(enable_backward=False, module="tacgen.physics")
def distances(at: Pairs, to: Pairs, box: Pairs, out: Reals):
    """Distances (n,) from points to the nearest of others (m,) within a box of corners (2,), else infinite."""
    i = wp.tid()
    p, low, high, least = at[i], box[0], box[1], real(wp.inf)
    if p[0] >= low[0] and p[1] >= low[1] and p[0] <= high[0] and p[1] <= high[1]:
        j = int(0)
        while j < to.shape[0]:
            off = p - get(to, j)
            least = wp.min(least, wp.dot(off, off))
            j += 1
    out[i] = wp.sqrt(least)


@wp.func
def barycentric(transform: Pairs, t: int, p: wp.vec2d) -> wp.vec3d:
    """Barycentric coordinates in a triangle by its rows of Delaunay.transform."""
    off = p - get(transform, 3 * t + 2)
    i, j = wp.dot(get(transform, 3 * t), off), wp.dot(get(transform, 3 * t + 1), off)
    return wp.vec3d(i, j, real(1.0) - (i + j))


@wp.kernel(enable_backward=False, module="tacgen.physics")
def ordinates(points: Pairs, simplices: Triples, neighbors: Triples, transform: Pairs, out: Reals):
    """Bezier ordinates (t, 9, 15) of each weight's function over triangles: at corners, beside them toward the next two
    corners, inside, and across the edges. A thread for each triangle and weight."""
    thread = wp.tid()
    t, m = thread / WEIGHTS, thread % WEIGHTS
    first, axis, node = thread * ORDINATES, (m + 1) % 2, (m - 3) / 2
    corner = simplices[t]
    k = int(0)
    while k < 3:
        value, total = wp.where(m == k, real(1.0), real(0.0)), real(0.0)
        put(out, first + k, value)
        n = int(0)
        while n < 2:
            toward = real(0.0) + value
            if m >= 3 and node == k:
                toward += (points[corner[(k + 1 + n) % 3]][axis] - points[corner[k]][axis]) / real(3.0)
            put(out, first + 3 + 2 * k + n, toward)
            total += toward
            n += 1
        put(out, first + 9 + k, (value + total) / real(3.0))
        k += 1
    k = int(0)
    while k < 3:
        turn, beside = real(-0.5), neighbors[t][k]
        i, j = (k + 1) % 3, (k + 2) % 3
        if beside >= 0:  # by the coordinates of the centroid of the triangle across the edge
            there = simplices[beside]
            middle = points[there[0]] + points[there[1]] + points[there[2]]
            at = barycentric(transform, t, middle / real(3.0))
            turn = (real(2.0) * at[j] + at[i] - real(1.0)) / (real(2.0) - real(3.0) * (at[i] + at[j]))
        ahead, back = get(out, first + 3 + 2 * i), get(out, first + 4 + 2 * j)
        bend = turn * (real(3.0) * (ahead - back) + get(out, first + j) - get(out, first + i))
        inner = get(out, first + 9 + i) + get(out, first + 9 + j)
        put(out, first + 12 + k, (bend - get(out, first + i) + real(2.0) * ahead - back + inner) / real(2.0))
        k += 1


@wp.kernel(enable_backward=False, module="tacgen.physics")
def cubic_weights(
    xy: Pairs, number: Ints, nodes: int, simplices: Triples, transform: Pairs, ordinates: Reals, out: Reals,
    columns: Ints,
):  # fmt: skip
    """Weights (n, 9) of a triangle's three values and of their slopes, alternately along x and y, and their indices
    among the values and slopes of so many nodes; nan and 0 where the number of the triangle is negative."""
    p = wp.tid()
    t, start = get(number, p), p * WEIGHTS
    m = int(0)
    if t < 0:
        while m < WEIGHTS:
            out[start + m] = real(wp.nan)
            columns[start + m] = 0
            m += 1
        return
    at, corner, share = barycentric(transform, t, get(xy, p)), get(simplices, t), Shares()
    c = wp.min(at[0], wp.min(at[1], at[2]))  # the piece between the other two corners and the centroid
    b = at - wp.vec3d(c, c, c)
    c *= real(3.0)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        square = real(3.0) * b[k] * b[k]
        share[k] = b[k] * b[k] * b[k]
        share[3 + 2 * k] = square * b[i]
        share[4 + 2 * k] = square * b[j]
        share[9 + k] = c * c * c / real(9.0) + c * c * b[k] + square * c
        share[12 + k] = real(2.0) * c * c * c / real(9.0) + c * c * (b[i] + b[j]) + real(6.0) * c * b[i] * b[j]
        put(columns, start + k, corner[k])
        put(columns, start + 3 + 2 * k, nodes + 2 * corner[k])
        put(columns, start + 4 + 2 * k, nodes + 2 * corner[k] + 1)
    first = t * WEIGHTS * ORDINATES
    while m < WEIGHTS:
        total = real(0.0)
        n = int(0)
        while n < ORDINATES:
            total += share[n] * get(ordinates, first + n)
            n += 1
        put(out, start + m, total)
        first += ORDINATES
        m += 1


@wp.kernel(enable_backward=False, module="tacgen.physics")
def weighted(weights: Reals, columns: Ints, nodal: Reals, count: int, out: Reals):
    """Sums (n, count) of nodal values and slopes (3s, count) by weights (n, 9) of those in `columns` (n, 9)."""
    p = wp.tid()
    start, first = p * count, p * WEIGHTS
    c = int(0)
    while c < count:
        total = real(0.0)
        for k in range(3):
            for n in range(3):
                m = first + 3 * k + n
                total += get(weights, m) * get(nodal, get(columns, m) * count + c)
        put(out, start + c, total)
        c += 1
