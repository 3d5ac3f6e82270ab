"""Elements of many scenes that share their numbering: deformation, energy, stresses and nodal forces, as Warp kernels.

Arrays have the scene first: positions (s, n), F (s, e, q); conn (e, a). What belongs to a scene for good (dN/dX B,
weights, laws) may hold more scenes than a call has: `slots` (s,) are their rows there. Weights are volumes [mm^3], 0
in void cells. `local` is the share of U that is a function of J at each point, not of the cell's mean J [-].
`memory` (s, e, q): M [MPa] of the additional energy J^-2/3 (M : F^T F)/2 of a viscoelastic gel; no row: elastic.
"""

import warp as wp

from tacgen.physics.laws import J0, TWO_THIRDS, Coefficients, clamped_log, isochoric, volumetric
from tacgen.physics.types import Ints, Ints2, Matrices3, Reals, Reals2, Reals3, Vectors2, Vectors3, Vectors4, real

SMALLEST_J = 1e-9  # J below which the energy is infinite, so that divisions by J do not overflow [-]
MAX_PREDICTED_RATIO = 2.0  # of the predicted J to the true one, and of the true one to the predicted [-]
MAX_CORNERS = 10  # nodes of the largest element, the quadratic tet
Corners = wp.types.matrix(shape=(MAX_CORNERS, 3), dtype=real)  # positions [mm]
LEAST = wp.constant(real(SMALLEST_J))
MOST = wp.constant(real(MAX_PREDICTED_RATIO))


@wp.func
def cofactor(F: wp.mat33d) -> wp.mat33d:
    """J F^-T, also where J is 0."""
    return wp.matrix_from_rows(wp.cross(F[1], F[2]), wp.cross(F[2], F[0]), wp.cross(F[0], F[1]))


@wp.func
def positive_J(F: wp.mat33d) -> real:
    """J, 1 where it is not positive."""
    J = wp.determinant(F)
    return wp.where(J > LEAST, J, real(1.0))


@wp.func
def near(predicted: real, J: real) -> real:
    """The predicted J, kept near the true one."""
    return wp.clamp(predicted, J / MOST, MOST * J)


@wp.func
def means(F: Matrices3, weights: Reals3, predicted: Reals3, s: int, slot: int, e: int) -> wp.vec3d:
    """Volume of a cell, its mean J and the mean of the predicted J, 1 in void cells; without rows in `predicted` the
    two are equal."""
    volume, mean, ahead = real(0.0), real(0.0), real(0.0)
    for q in range(weights.shape[2]):
        w = weights[slot, e, q]
        J = positive_J(F[s, e, q])
        volume += w
        mean += w * J
        if predicted.shape[0] > 0:
            ahead += w * near(predicted[slot, e, q], J)
        else:
            ahead += w * J
    if volume <= real(0.0):
        return wp.vec3d(volume, real(1.0), real(1.0))
    return wp.vec3d(volume, mean / volume, ahead / volume)


@wp.func
def piola(F: wp.mat33d, I1: real, w1: real, w2: real, w3: real) -> wp.mat33d:
    """P = 2 w1 F + 2 w2 (I1 F - F F^T F) + w3 cof F."""
    P = real(2.0) * (w1 + w2 * I1) * F + w3 * cofactor(F)
    if w2 != real(0.0):
        P -= real(2.0) * w2 * (F * (wp.transpose(F) * F))
    return P


@wp.func
def corners_of(x: Vectors2, conn: Ints2, s: int, e: int) -> Corners:
    """Positions of the corners of a cell."""
    at = Corners()
    for a in range(conn.shape[1]):
        at[a] = x[s, conn[e, a]]
    return at


@wp.kernel(enable_backward=False, module="tacgen.physics")
def deformation(x: Vectors2, conn: Ints2, B: Vectors4, slots: Ints, step: int, F: Matrices3):
    """F (s, e, q), by `step` threads for each cell: one on a core, one for each point on a GPU."""
    s, e, start = wp.tid()
    at = corners_of(x, conn, s, e)
    for q in range(start, B.shape[2], step):
        total = wp.mat33d()
        for a in range(conn.shape[1]):
            total += wp.outer(at[a], B[slots[s], e, q, a])
        F[s, e, q] = total


@wp.kernel(enable_backward=False, module="tacgen.physics")
def states(
    F: Matrices3, weights: Reals3, laws: wp.array2d(dtype=Coefficients), slots: Ints, local: real, memory: Matrices3,
    predicted: Reals3, taken: Matrices3, energy: Reals2, J: Reals3, stress: Matrices3,
):  # fmt: skip
    """Energies (s, e) [N mm], inf where a cell is inverted; J (s, e, q), 1 there; weights times P (s, e, q) [N mm].

    `stress` without rows: energies alone. With rows in `predicted` and `taken` (rows as `weights`): P with the pressure
    at the predicted J, plus the difference to the true pressure acting on the cofactor of `taken`, see fem.elasticity.
    """
    s, e = wp.tid()
    slot = slots[s]
    law = laws[slot, e]
    mixed = predicted.shape[0] > 0
    inverted = bool(False)
    mean = means(F, weights, predicted, s, slot, e)
    U = volumetric(law, mean[1])
    change = real(0.0)  # of the pressure, from the true mean J to the predicted one
    if mixed:
        change = volumetric(law, mean[2])[1] - U[1]
    total = (real(1.0) - local) * mean[0] * U[0]
    for q in range(weights.shape[2]):
        w = weights[slot, e, q]
        Fq = F[s, e, q]
        C = cofactor(Fq)
        Jq = wp.dot(Fq[0], C[0])
        if not Jq > LEAST:
            inverted = inverted or w != real(0.0)
            Jq = real(1.0)
        I1 = wp.ddot(Fq, Fq)
        d = isochoric(law, I1, wp.ddot(C, C), Jq)
        total += w * d.value
        pressure, turned = (real(1.0) - local) * U[1], (real(1.0) - local) * change
        if local > real(0.0):
            here = volumetric(law, Jq)
            total += local * w * here[0]
            pressure += local * here[1]
            if mixed:
                turned += local * (volumetric(law, near(predicted[slot, e, q], Jq))[1] - here[1])
        P = piola(Fq, I1, d.w1, d.w2, d.w3 + pressure + turned)
        if memory.shape[0] > 0:
            M = wp.exp(-TWO_THIRDS * wp.log(Jq)) * memory[slot, e, q]
            stretched = Fq * M
            total += real(0.5) * w * (wp.ddot(stretched, Fq) - wp.trace(memory[slot, e, q]))
            P += stretched - wp.ddot(stretched, Fq) / (real(3.0) * Jq) * C
        if stress.shape[0] > 0:
            if mixed:
                P -= turned * cofactor(taken[slot, e, q])
            J[s, e, q] = Jq
            stress[s, e, q] = w * P
    if inverted:
        total = real(wp.inf)
    energy[s, e] = total


@wp.kernel(enable_backward=False, module="tacgen.physics")
def isochoric_stresses(F: Matrices3, laws: wp.array2d(dtype=Coefficients), slots: Ints, out: Matrices3):
    """J^2/3 F^-1 P (s, e, q) [MPa] of the laws without U, see fem.viscoelasticity."""
    s, e, q = wp.tid()
    Fq = F[s, e, q]
    C, J, I1 = cofactor(Fq), positive_J(Fq), wp.ddot(Fq, Fq)
    d = isochoric(laws[slots[s], e], I1, wp.ddot(C, C), J)
    out[s, e, q] = wp.exp(TWO_THIRDS * wp.log(J)) / J * (wp.transpose(C) * piola(Fq, I1, d.w1, d.w2, d.w3))


@wp.kernel(enable_backward=False, module="tacgen.physics")
def corner_forces(stress: Matrices3, B: Vectors4, slots: Ints, step: int, forces: Vectors3):
    """Forces (s, e, a) [N] on the corners of cells of weights times P, by `step` threads for each cell."""
    s, e, start = wp.tid()
    for a in range(start, B.shape[3], step):
        total = wp.vec3d()
        for q in range(stress.shape[2]):
            total += stress[s, e, q] * B[slots[s], e, q, a]
        forces[s, e, a] = total


@wp.kernel(enable_backward=False, module="tacgen.physics")
def at_nodes(forces: Vectors3, first: Ints, around: Ints2, out: Vectors2):
    """The sums (s, n) of what the corners of cells have (s, e, a).

    The cells and corners of node n are rows first[n] to first[n + 1] of `around` (k, 2), in a fixed order, so that sums
    repeat.
    """
    s, n = wp.tid()
    total = wp.vec3d()
    for k in range(first[n], first[n + 1]):
        total += forces[s, around[k, 0], around[k, 1]]
    out[s, n] = total


@wp.kernel(enable_backward=False, module="tacgen.physics")
def predictions(F: Matrices3, to: Matrices3, taken: Matrices3, slots: Ints, J: Reals3):
    """J (s, e, q) at F = `to`, to first order from J at F, linearised at `taken` (rows as `slots` say)."""
    s, e, q = wp.tid()
    here, C = F[s, e, q], cofactor(taken[slots[s], e, q])
    J[s, e, q] = wp.determinant(here) + wp.ddot(C, to[s, e, q] - here)


@wp.func
def mapped(at: Corners, dN: Vectors2, q: int) -> wp.mat33d:
    """dx/dxi at point q of a cell with corners `at`; dN (q, a)."""
    total = wp.mat33d()
    for a in range(dN.shape[1]):
        total += wp.outer(at[a], dN[q, a])
    return total


@wp.func
def item(items: Ints2, i: int, cells: int) -> wp.vec2i:
    """A scene (a row of x) and a cell: row i of `items` (k, 2); if it is empty, number i of all cells of all scenes."""
    if items.shape[0] > 0:
        return wp.vec2i(items[i, 0], items[i, 1])
    return wp.vec2i(i / cells, i % cells)


@wp.func
def hex_bound(at: Corners) -> real:
    """A lower bound of det(dx/dxi) in a trilinear hex: with dx/dxi = G at its middle and D the rest, it is at least
    det G (1 - |G^-1| |D|)^3."""
    g1, g2, g3, h1, h2, h3, h4 = wp.vec3d(), wp.vec3d(), wp.vec3d(), wp.vec3d(), wp.vec3d(), wp.vec3d(), wp.vec3d()
    for a in range(8):
        v = real(0.125) * at[a]
        i = wp.where((a + 1) & 2 != 0, real(1.0), real(-1.0))  # coordinates xi of the corner
        j = wp.where(a & 2 != 0, real(1.0), real(-1.0))
        k = wp.where(a & 4 != 0, real(1.0), real(-1.0))
        g1 += i * v
        g2 += j * v
        g3 += k * v
        h1 += j * k * v
        h2 += i * k * v
        h3 += i * j * v
        h4 += i * j * k * v
    C = cofactor(wp.matrix_from_rows(g1, g2, g3))
    whole = wp.dot(g1, C[0])
    l1, l2, l3, l4 = wp.length(h1), wp.length(h2), wp.length(h3), wp.length(h4)
    rest = wp.sqrt((l2 + l3 + l4) * (l2 + l3 + l4) + (l1 + l3 + l4) * (l1 + l3 + l4) + (l1 + l2 + l4) * (l1 + l2 + l4))
    r = real(1.0) - wp.sqrt(wp.ddot(C, C)) / whole * rest
    return wp.where(whole > real(0.0) and r > real(0.0), whole * r * r * r, real(0.0))


@wp.kernel(enable_backward=False, module="tacgen.physics")
def lowest(x: Vectors2, conn: Ints2, dN: Vectors2, rest: Reals3, most: Reals2, slots: Ints, low: Reals2):
    """The lowest J (s, e) of cells at the points of dN (q, a), or a bound of it that is at least J0.

    rest (s, e, q): det(dX/dxi); most (s, e): the largest.
    """
    s, e = wp.tid()
    at = corners_of(x, conn, s, e)
    if conn.shape[1] == 8:
        bound = hex_bound(at) / most[slots[s], e]
        if bound >= J0:
            low[s, e] = bound
            return
    least = real(wp.inf)
    for q in range(dN.shape[0]):
        least = wp.min(least, wp.determinant(mapped(at, dN, q)) / rest[slots[s], e, q])
    low[s, e] = least


@wp.kernel(enable_backward=False, module="tacgen.physics")
def folds(
    x: Vectors2, conn: Ints2, dN: Vectors2, rest: Reals3, most: Reals2, stiffness: Reals2, slots: Ints, items: Ints2,
    energy: Reals, forces: Vectors2,
):  # fmt: skip
    """The barrier against inversion on cells, see `item`.

    Energies (k,) [N mm] and forces on corners (k, a) [N], 0 where no point has a J below J0; without rows in `forces`
    energies alone. stiffness (s, e): that of the barrier times the volume of a point [N mm], 0 in void cells.
    """
    i = wp.tid()
    pair = item(items, i, conn.shape[0])
    s, e = pair[0], pair[1]
    slot = slots[s]
    k = stiffness[slot, e]
    total = real(0.0)
    if forces.shape[0] > 0:
        for a in range(conn.shape[1]):
            forces[i, a] = wp.vec3d()
    at = corners_of(x, conn, s, e)
    folded = k > real(0.0)
    if conn.shape[1] == 8:
        folded = folded and hex_bound(at) / most[slot, e] < J0
    if folded:
        for q in range(dN.shape[0]):
            F = mapped(at, dN, q)
            C = cofactor(F)
            J = wp.dot(F[0], C[0]) / rest[slot, e, q]
            if not J > LEAST:
                total = real(wp.inf)
                J = real(1.0)
            if J < J0:
                U = clamped_log(J)
                total += k * U[0]
                if forces.shape[0] > 0:
                    for a in range(conn.shape[1]):
                        forces[i, a] = forces[i, a] + (k * U[1] / rest[slot, e, q]) * (C * dN[q, a])
    energy[i] = total
