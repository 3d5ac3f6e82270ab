"""A certified lower bound of the Jacobian of elements of many scenes, as Warp kernels; see fem.jacobian for the theory.

Arrays have the scene first, cells are conn (e, a). Tables of an element type: columns (3, p, b), dN/dxi at the places
between which columns of dx/dxi are linear, of the nodes (3, p, b) where it is not 0; monomial (p, p, p), the number of
the coefficient of a triple of them; share (k,), 1 over how many triples it has; pieces (c, k, k), the coefficients on
each part of a divided element.
"""

import warp as wp

from tacgen.physics.types import Flags2, Ints2, Ints3, Reals, Reals2, Reals3, Vectors2, real

MAX_COEFFICIENTS = 27  # of the Jacobian determinant of an element, which the hex has
MAX_PLACES = wp.constant(4)  # between which a column is linear
Bernstein = wp.types.vector(length=MAX_COEFFICIENTS, dtype=real)  # coefficients [mm^3] or, over a volume, [-]
Columns = wp.types.matrix(shape=(3 * MAX_PLACES, 3), dtype=real)  # dx/dxi at the places [mm]


@wp.func
def coefficients(
    x: Vectors2, conn: Ints2, nodes: Ints3, columns: Reals3, monomial: Ints3, share: Reals, s: int, e: int
) -> Bernstein:
    """Bernstein coefficients of the determinant of the map from the reference element."""
    at, out = Columns(), Bernstein()
    for k in range(3):
        p = int(0)
        while p < columns.shape[1]:
            total = wp.vec3d()
            a = int(0)
            while a < columns.shape[2]:
                total += columns[k, p, a] * x[s, conn[e, nodes[k, p, a]]]
                a += 1
            at[MAX_PLACES * k + p] = total
            p += 1
    i = int(0)
    while i < columns.shape[1]:
        j = int(0)
        while j < columns.shape[1]:
            normal = wp.cross(at[i], at[MAX_PLACES + j])
            p = int(0)
            while p < columns.shape[1]:
                m = monomial[i, j, p]
                out[m] = out[m] + wp.dot(normal, at[2 * MAX_PLACES + p])
                p += 1
            j += 1
        i += 1
    p = int(0)
    while p < share.shape[0]:
        out[p] = out[p] * share[p]
        p += 1
    return out


@wp.func
def least(values: Bernstein, share: Reals) -> wp.vec2d:
    """The smallest coefficient, -inf if one is not finite; and the smallest at a corner, which is a value there."""
    low, corner = real(wp.inf), real(wp.inf)
    k = int(0)
    while k < share.shape[0]:
        value = values[k]
        if not wp.isfinite(value):
            value = -real(wp.inf)
        low = wp.min(low, value)
        if share[k] == real(1.0):
            corner = wp.min(corner, value)
        k += 1
    return wp.vec2d(low, corner)


@wp.func
def divided(whole: Bernstein, pieces: Reals3, path: int, depth: int) -> Bernstein:
    """Coefficients on a piece of a piece of an element, `depth` deep; digits of `path` say which, the first first."""
    count, size = pieces.shape[0], pieces.shape[1]
    values = whole
    unit = int(1)
    level = int(1)
    while level < depth:
        unit = unit * count
        level += 1
    while unit > 0 and depth > 0:
        piece = (path / unit) % count
        new = Bernstein()
        i = int(0)
        while i < size:
            total = real(0.0)
            j = int(0)
            while j < size:
                total += pieces[piece, i, j] * values[j]
                j += 1
            new[i] = total
            i += 1
        values = new
        unit = unit / count
    return values


@wp.kernel(enable_backward=False, module="tacgen.physics")
def whole_bounds(
    rest: Vectors2, x: Vectors2, conn: Ints2, exists: Flags2, nodes: Ints3, columns: Reals3, monomial: Ints3,
    share: Reals, volume: Reals2, low: Reals2, attained: Reals2,
):  # fmt: skip
    """Volumes (s, e) [mm^3] at rest (s, n); the smallest coefficient of J at x (s, n), -inf where it is not finite, and
    the smallest value at a corner. In cells that do not `exist` (s, e), inf; without rows there all do."""
    s, e = wp.tid()
    low[s, e] = real(wp.inf)
    attained[s, e] = real(wp.inf)
    if exists.shape[0] > 0 and not exists[s, e]:
        return
    before, total = coefficients(rest, conn, nodes, columns, monomial, share, s, e), real(0.0)
    for k in range(share.shape[0]):  # each Bernstein polynomial has the same integral
        total += before[k]
    total /= real(share.shape[0])
    found = least(coefficients(x, conn, nodes, columns, monomial, share, s, e) / total, share)
    volume[s, e] = total
    low[s, e] = found[0]
    attained[s, e] = found[1]


@wp.kernel(enable_backward=False, module="tacgen.physics")
def divided_bounds(
    x: Vectors2, conn: Ints2, nodes: Ints3, columns: Reals3, monomial: Ints3, share: Reals, pieces: Reals3,
    volume: Reals2, attained: Reals, tol: real, deepest: int, most: int, low: Reals2,
):  # fmt: skip
    """Raise the bounds `low` (s, e) of cells that are more than `tol` below the least value `attained` (s,) in a scene,
    by dividing cells until those of their pieces are not; at most `deepest` times, and not at all those that would have
    more than `most` pieces.

    Pieces are visited in the order of a search in depth, and each is computed from the whole: nothing is kept.
    """
    s, e = wp.tid()
    reached = attained[s]
    if not low[s, e] < reached - tol or deepest == 0 or low[s, e] == -real(wp.inf):
        return
    whole = coefficients(x, conn, nodes, columns, monomial, share, s, e) / volume[s, e]
    count = pieces.shape[0]
    bound = real(wp.inf)
    depth, path, visited = int(1), int(0), int(0)
    while depth > 0:
        if visited == most:
            return
        found = least(divided(whole, pieces, path, depth), share)
        visited += 1
        reached = wp.min(reached, found[1])
        if found[0] < reached - tol and depth < deepest:
            path, depth = path * count, depth + 1
        else:
            bound = wp.min(bound, found[0])
            while depth > 0 and path % count == count - 1:
                path, depth = path / count, depth - 1
            path += 1
    low[s, e] = bound
