"""Kernels of the distance to the nearest of a few triangles, for `exact_edges`."""

import numpy as np

from tacgen.base.compiled import njit
from tacgen.geometry.sdf_grid import spline_weights

Array = np.ndarray
MAX_TIED_DISTANCES = 16  # distances that are about as small at one point
# distance over the radius up to which contact may act [-]: normals and curvatures beyond are the spline's
MAX_CONTACT_RADII = 3.0
SINGLE_PRECISION_MM = 1e-5  # rounding error of distances in single precision [mm]
MIN_CORE_DISTANCE_MM = 1e-9  # distance from the core [mm] within which its direction is rounding error


@njit(cache=False)
def _closest(t: Array, x: float, y: float, z: float) -> tuple[int, float, float, float]:
    """The row of a triangle t (10, 3) with the normal at its point closest to (x, y, z): 3 of the face, 4 5 6 of edges,
    7 8 9 of corners; and that point. Source: Ericson (2005), Real-Time Collision Detection, 5.1.5."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    q = (x, y, z)
    for i in range(3):
        ab, ac = t[1, i] - t[0, i], t[2, i] - t[0, i]
        d1 += ab * (q[i] - t[0, i])
        d2 += ac * (q[i] - t[0, i])
        d3 += ab * (q[i] - t[1, i])
        d4 += ac * (q[i] - t[1, i])
        d5 += ab * (q[i] - t[2, i])
        d6 += ac * (q[i] - t[2, i])
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if d1 <= 0 and d2 <= 0:
        row, v, w = 7, 0.0, 0.0
    elif d3 >= 0 and d4 <= d3:
        row, v, w = 8, 1.0, 0.0
    elif d6 >= 0 and d5 <= d6:
        row, v, w = 9, 0.0, 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        row, v, w = 4, d1 / (d1 - d3), 0.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        row, v, w = 6, 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        row, v = 5, 1 - w
    else:
        row, v, w = 3, vb / (va + vb + vc), vc / (va + vb + vc)
    return (
        row,
        t[0, 0] + v * (t[1, 0] - t[0, 0]) + w * (t[2, 0] - t[0, 0]),
        t[0, 1] + v * (t[1, 1] - t[0, 1]) + w * (t[2, 1] - t[0, 1]),
        t[0, 2] + v * (t[1, 2] - t[0, 2]) + w * (t[2, 2] - t[0, 2]),
    )


@njit(cache=True)
def listed(
    table: Array, first: Array, origin: Array, cell: float, reach: Array, place: Array, near: Array, away: Array
) -> Array:
    """Number (m,) of triangles no farther from the middle of each cell than its `reach` (m,) [mm]; with `place` (m,),
    where the lists begin, they are written to `near`, and their distances to `away`."""
    counts = np.zeros(len(reach), np.int64)
    most = reach.max()
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for t in range(len(table)):
        for a in range(3):
            lower = min(table[t, 0, a], table[t, 1, a], table[t, 2, a]) - most
            upper = max(table[t, 0, a], table[t, 1, a], table[t, 2, a]) + most
            low[a] = max(0, int(np.floor((lower - origin[a]) / cell - 0.5)))
            high[a] = min(first.shape[a] - 1, int(np.ceil((upper - origin[a]) / cell - 0.5)))
        for i in range(low[0], high[0] + 1):
            x = origin[0] + (i + 0.5) * cell
            for j in range(low[1], high[1] + 1):
                y = origin[1] + (j + 0.5) * cell
                for k in range(low[2], high[2] + 1):
                    number = first[i, j, k]
                    if number < 0:
                        continue
                    z = origin[2] + (k + 0.5) * cell
                    _, a0, a1, a2 = _closest(table[t], x, y, z)
                    length = np.sqrt((a0 - x) ** 2 + (a1 - y) ** 2 + (a2 - z) ** 2)
                    if length > reach[number]:
                        continue
                    if len(place):
                        near[place[number] + counts[number]] = t
                        away[place[number] + counts[number]] = length
                    counts[number] += 1
    return counts


@njit(cache=False)
def _bend(t: Array, row: int, n: Array, length: float, D: Array) -> None:
    """Hessian D (3, 3) of the distance from the point of triangle t that `row` names, `length` away along n (3,)."""
    D[:] = 0.0
    if row == 3:
        return
    edge = np.zeros(3)
    if row < 7:  # along an edge there is no curvature
        edge[:] = t[(row - 3) % 3] - t[row - 4]
        edge /= np.sqrt((edge**2).sum())
    for a in range(3):
        for b in range(3):
            D[a, b] = ((a == b) - n[a] * n[b] - edge[a] * edge[b]) / length


@njit(cache=False)
def _is_lowest(t: Array, row: int, n: Array) -> bool:
    """Whether the point of triangle t that `row` names, from which n (3,) leads to a point outside, is closest to that
    of all the surface around it. A corner is taken for one that is not."""
    if row > 6 or n[0] * t[row, 0] + n[1] * t[row, 1] + n[2] * t[row, 2] <= 0:
        return False
    if row == 3:
        return True
    edge, beyond = t[(row - 3) % 3] - t[row - 4], t[row] - t[3] / np.sqrt((t[3] ** 2).sum())  # the other face's normal
    # the edge runs against that face's orientation, so its cross product points from the edge into the face
    inward = (
        n[0] * (edge[1] * beyond[2] - edge[2] * beyond[1])
        + n[1] * (edge[2] * beyond[0] - edge[0] * beyond[2])
        + n[2] * (edge[0] * beyond[1] - edge[1] * beyond[0])
    )
    return bool(inward <= 0.0)


@njit(cache=False)
def _exact(
    table: Array, body: Array, near: Array, away: Array, x: float, y: float, z: float, gap: float, radius: float,
    n: Array, D: Array, work: Array,
) -> tuple[float, bool]:  # fmt: skip
    """Smallest distance from the opened bodies at a point that is `gap` [mm] from the middle of its cell; whether
    contact may act there, and if so its gradient, into n (3,), and Hessian, into D (3, 3)."""
    c, best = work[0], work[1]
    least, length, which, row = np.inf, np.inf, near[0], 3
    t, found = near[0], 3
    alone = body[near[0]] == body[near[-1]]
    for m in range(len(near)):
        if away[m] - gap < least:  # else it is farther than one before
            one, a0, a1, a2 = _closest(table[near[m]], x, y, z)
            far = np.sqrt((a0 - x) ** 2 + (a1 - y) ** 2 + (a2 - z) ** 2)
            if far < least:
                least, t, found = far, near[m], one
                c[0], c[1], c[2] = a0, a1, a2
        end = m + 1 == len(near) or (alone and away[m + 1] - gap >= least)  # lists are in order of their bodies
        if not end and (alone or body[near[m + 1]] == body[near[m]]):
            continue
        outward = (x - c[0]) * table[t, found, 0] + (y - c[1]) * table[t, found, 1] + (z - c[2]) * table[t, found, 2]
        signed = least if outward >= 0 else -least
        if signed < length:
            length, which, row = signed, t, found
            best[:] = c
        if end:
            break
        least = np.inf
    if length > (1 + MAX_CONTACT_RADII) * radius:
        return length - radius, False
    n[0], n[1], n[2] = x - best[0], y - best[1], z - best[2]
    D[:] = 0.0
    if abs(length) < MIN_CORE_DISTANCE_MM:  # the direction outward
        n[:] = table[which, row] / np.sqrt((table[which, row] ** 2).sum())
        return length - radius, True
    n /= length
    _bend(table[which], row, n, length, D)
    if length > 0:
        length = _rounded(table, near, away, x, y, z, gap, radius, n, D, length, work)
    return length - radius, True


@njit(cache=False)
def _rounded(
    table: Array, near: Array, away: Array, x: float, y: float, z: float, gap: float, radius: float, n: Array,
    D: Array, low: float, work: Array,
) -> float:  # fmt: skip
    """The smallest distance `low`, gradient n and Hessian D where others are nearly as small, above a crease: the
    normal would jump from one face to the other. Each other distance that is lowest on its part of the surface, larger
    by u < k, lowers it by

        (k - u)^3 / (6 k^2),    k = radius (1 - cosine of the angle between the normals),

    which is C2, and zero where a face ends at the crease (there u >= k).
    """
    first, m, slope, v, bend, E, known = work[2], work[3], work[4], work[5], work[6:9], work[9:12], work[12:]
    out, count = low, 1
    first[:], bend[:], known[0] = n, D, work[1]  # work[1]: the nearest point
    for i in range(len(near)):
        if away[i] - gap > low + 2 * radius or count == len(known):
            continue
        t = near[i]
        row, a0, a1, a2 = _closest(table[t], x, y, z)
        m[0], m[1], m[2] = x - a0, y - a1, z - a2
        length = np.sqrt(m[0] ** 2 + m[1] ** 2 + m[2] ** 2)
        cosine = (first[0] * m[0] + first[1] * m[1] + first[2] * m[2]) / length
        k, u = radius * (1 - cosine), length - low
        if u >= k:
            continue
        m /= length
        if not _is_lowest(table[t], row, m):
            continue
        again = False
        for j in range(count):
            again |= (known[j, 0] - a0) ** 2 + (known[j, 1] - a1) ** 2 + (
                known[j, 2] - a2
            ) ** 2 < MIN_CORE_DISTANCE_MM**2
        if again:  # an edge of two triangles
            continue
        known[count, 0], known[count, 1], known[count, 2] = a0, a1, a2
        count += 1
        _bend(table[t], row, m, length, E)
        part = (k - u) / k
        out -= k * part**3 / 6
        for a in range(3):
            slope[a] = 0.0
            for b in range(3):
                slope[a] -= radius * (bend[a, b] * m[b] + E[a, b] * first[b])
        v[:] = m - first - (u / k) * slope
        n += part**2 / 2 * (m - first) - (part**2 / 2 - part**3 / 3) * slope
        for a in range(3):
            for b in range(3):
                D[a, b] += part**2 / 2 * (E[a, b] - bend[a, b]) - part / k * v[a] * v[b]
    return out


@njit(cache=False)
def _slopes(share: Array, index: Array, w: Array, s: Array, S: Array) -> None:
    """Slopes s (3,) and bends S (3, 3), above its diagonal, of the spline `share` in a cell with these weights."""
    s[:], S[:] = 0.0, 0.0
    for i in range(4):
        for j in range(4):
            for k in range(4):
                q = share[index[0] - 1 + i, index[1] - 1 + j, index[2] - 1 + k]
                if q == 0:
                    continue
                x0, y0, z0 = w[0, 0, i], w[1, 0, j], w[2, 0, k]
                x1, y1, z1 = w[0, 1, i], w[1, 1, j], w[2, 1, k]
                s[0] += q * x1 * y0 * z0
                s[1] += q * x0 * y1 * z0
                s[2] += q * x0 * y0 * z1
                S[0, 0] += q * w[0, 2, i] * y0 * z0
                S[1, 1] += q * x0 * w[1, 2, j] * z0
                S[2, 2] += q * x0 * y0 * w[2, 2, k]
                S[0, 1] += q * x1 * y1 * z0
                S[0, 2] += q * x1 * y0 * z1
                S[1, 2] += q * x0 * y1 * z1


@njit(cache=True)
def correct(
    p: Array, origin: Array, cell: float, radius: float, share: Array, first: Array, start: Array, near: Array,
    away: Array, table: Array, body: Array, d: Array, g: Array, H: Array,
) -> None:  # fmt: skip
    """The distances d (n,) of a spline at p (n, 3), their gradients g and Hessians H pass into the exact ones; see
    exact_edges.SharpField."""
    w, n, D = np.empty((3, 3, 4)), np.empty(3), np.empty((3, 3))
    s, S, index, work = np.empty(3), np.empty((3, 3)), np.empty(3, np.int64), np.empty((12 + MAX_TIED_DISTANCES, 3))
    for m in range(len(p)):
        inner = True
        for a in range(3):
            x = (p[m, a] - origin[a]) / cell
            inner &= 1.0 <= x <= first.shape[a] - 2.0
            index[a] = min(int(x), first.shape[a] - 3) if inner else 0
            if inner:
                spline_weights(x - index[a], w[a])
        number = first[index[0], index[1], index[2]] if inner else -1
        if number < 0:
            continue
        part = 0.0
        for i in range(4):
            for j in range(4):
                for k in range(4):
                    q = share[index[0] - 1 + i, index[1] - 1 + j, index[2] - 1 + k]
                    part += q * w[0, 0, i] * w[1, 0, j] * w[2, 0, k]
        gap = 0.0
        for a in range(3):
            gap += (p[m, a] - origin[a] - (index[a] + 0.5) * cell) ** 2
        i, j = start[number], start[number + 1]
        some, gap = (near[i:j], away[i:j]), np.sqrt(gap) + SINGLE_PRECISION_MM
        exact, acts = _exact(table, body, *some, p[m, 0], p[m, 1], p[m, 2], gap, radius, n, D, work)
        more = exact - d[m]
        d[m] += part * more
        if not acts:
            continue
        _slopes(share, index, w, s, S)
        S[1, 0], S[2, 0], S[2, 1] = S[0, 1], S[0, 2], S[1, 2]
        for a in range(3):
            for b in range(3):
                cross = s[a] * (n[b] - g[m, b]) + s[b] * (n[a] - g[m, a])
                H[m, a, b] += part * (D[a, b] - H[m, a, b]) + cross / cell + more * S[a, b] / cell**2
        for a in range(3):
            g[m, a] += part * (n[a] - g[m, a]) + more * s[a] / cell
