"""Compiled loops of the element tangents: exact, or projected to be positive semi-definite.

The kernels see the material law only through its derivatives in the invariants. The projected tangent clamps the
analytic eigenvalues of an isotropic energy in the principal stretches (Smith, de Goes & Kim 2019, "Analytic
eigensystems for isotropic distortion energies").
"""

import numpy as np

from tacgen.compiled import njit
from tacgen.fem.assembly import cofactor

Array = np.ndarray
MILD = 0.1  # |F^T F - I| below which the exact tangent is not projected: it is positive definite near rest [-]


@njit(cache=False, fastmath=True)
def _eigen3(A: Array, V: Array) -> None:
    """Eigenvalues (on the diagonal of A) and eigenvectors (columns of V) of the symmetric A, by cyclic Jacobi."""
    for i in range(3):
        for j in range(3):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(12):
        off = A[0, 1] ** 2 + A[0, 2] ** 2 + A[1, 2] ** 2
        if off < 1e-22 * (A[0, 0] ** 2 + A[1, 1] ** 2 + A[2, 2] ** 2):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                a = A[p, q]
                if a == 0.0:
                    continue
                h = (A[q, q] - A[p, p]) / (2 * a)
                t = 1.0 / (abs(h) + np.sqrt(h * h + 1.0))
                if h < 0:
                    t = -t
                c = 1 / np.sqrt(t * t + 1)
                s = t * c
                A[p, p] -= t * a
                A[q, q] += t * a
                A[p, q] = 0.0
                A[q, p] = 0.0
                r = 3 - p - q
                u, v = A[r, p], A[r, q]
                A[r, p] = A[p, r] = c * u - s * v
                A[r, q] = A[q, r] = s * u + c * v
                for k in range(3):
                    u, v = V[k, p], V[k, q]
                    V[k, p] = c * u - s * v
                    V[k, q] = s * u + c * v


@njit(cache=False, fastmath=True)
def _exact(F: Array, C: Array, f: Array, s2: Array, G: Array, D: Array) -> None:
    """D (9, 9) = dP/dF, index 3 i + J, from the derivatives f (3,) and s2 (6,) of W in (I1, I2, J); C = cof F."""
    I1 = 0.0
    for i in range(3):
        for j in range(3):
            G[0, 3 * i + j] = 2 * F[i, j]
            G[2, 3 * i + j] = C[i, j]
            I1 += F[i, j] ** 2
    quadratic = f[1] != 0.0
    for i in range(3):
        for j in range(3):
            t = 0.0
            if quadratic:
                for k in range(3):
                    for m in range(3):
                        t += F[i, k] * F[m, k] * F[m, j]
            G[1, 3 * i + j] = 2 * (I1 * F[i, j] - t) if quadratic else 0.0
    for b in range(9):
        x, y, z = G[0, b], G[1, b], G[2, b]
        h1 = s2[0] * x + s2[3] * y + s2[4] * z
        h2 = s2[3] * x + s2[1] * y + s2[5] * z
        h3 = s2[4] * x + s2[5] * y + s2[2] * z
        for a in range(9):
            D[b, a] = G[0, a] * h1 + G[1, a] * h2 + G[2, a] * h3
        D[b, b] += 2 * (f[0] + f[1] * I1)
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            D[3 * i + j, 3 * i1 + j1] += f[2] * F[i2, j2]
            D[3 * i + j, 3 * i2 + j2] += f[2] * F[i1, j1]
            D[3 * i + j, 3 * i1 + j2] -= f[2] * F[i2, j1]
            D[3 * i + j, 3 * i2 + j1] -= f[2] * F[i1, j2]
    if quadratic:
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    c = F[0, k] * F[0, j] + F[1, k] * F[1, j] + F[2, k] * F[2, j]
                    D[3 * i + j, 3 * i + k] -= 2 * f[1] * c
                    b = F[i, 0] * F[k, 0] + F[i, 1] * F[k, 1] + F[i, 2] * F[k, 2]
                    D[3 * i + j, 3 * k + j] -= 2 * f[1] * b
                    for m in range(3):
                        D[3 * i + j, 3 * k + m] += f[1] * (4 * F[i, j] * F[k, m] - 2 * F[i, m] * F[k, j])


@njit(cache=False, fastmath=True)
def _projected(
    F: Array, f: Array, s2: Array, A: Array, V: Array, W: Array, Hs: Array, U: Array, Q: Array, D: Array
) -> None:
    """The positive semi-definite part of dP/dF: its eigenvalues in the principal stretches clamped at zero."""
    for i in range(3):
        for j in range(3):
            A[i, j] = F[0, i] * F[0, j] + F[1, i] * F[1, j] + F[2, i] * F[2, j]
    _eigen3(A, V)
    s = np.empty(3)
    for i in range(3):
        s[i] = np.sqrt(A[i, i])
    for i in range(3):
        for j in range(3):
            U[i, j] = (F[i, 0] * V[0, j] + F[i, 1] * V[1, j] + F[i, 2] * V[2, j]) / s[j]
    I1 = A[0, 0] + A[1, 1] + A[2, 2]
    J = s[0] * s[1] * s[2]
    for i in range(3):  # second derivatives in the stretches
        d1i, d2i, d3i = 2 * s[i], 2 * s[i] * (I1 - s[i] ** 2), J / s[i]
        for j in range(3):
            d1j, d2j, d3j = 2 * s[j], 2 * s[j] * (I1 - s[j] ** 2), J / s[j]
            v = s2[0] * d1i * d1j + s2[1] * d2i * d2j + s2[2] * d3i * d3j
            v += s2[3] * (d1i * d2j + d2i * d1j) + s2[4] * (d1i * d3j + d3i * d1j) + s2[5] * (d2i * d3j + d3i * d2j)
            if i == j:
                v += 2 * f[0] + 2 * f[1] * (I1 - s[i] ** 2)
            else:
                v += 4 * f[1] * s[i] * s[j] + f[2] * s[3 - i - j]
            Hs[i, j] = v
    _eigen3(Hs, W)
    lam = np.empty(9)
    for k in range(3):
        lam[k] = Hs[k, k]
        for i in range(3):
            for j in range(3):
                t = W[0, k] * U[i, 0] * V[j, 0]
                t += W[1, k] * U[i, 1] * V[j, 1]
                Q[k, 3 * i + j] = t + W[2, k] * U[i, 2] * V[j, 2]
    n, r2 = 3, np.sqrt(0.5)
    for a in range(2):
        for b in range(a + 1, 3):
            c = s[3 - a - b]
            lam[n] = 2 * f[0] + 2 * f[1] * (c * c - s[a] * s[b]) - f[2] * c  # flip
            lam[n + 1] = 2 * f[0] + 2 * f[1] * (c * c + s[a] * s[b]) + f[2] * c  # twist
            for i in range(3):
                for j in range(3):
                    Q[n, 3 * i + j] = r2 * (U[i, a] * V[j, b] + U[i, b] * V[j, a])
                    Q[n + 1, 3 * i + j] = r2 * (U[i, a] * V[j, b] - U[i, b] * V[j, a])
            n += 2
    for a in range(9):
        for b in range(9):
            D[a, b] = 0.0
    for k in range(9):
        v = lam[k]
        if v > 0.0:
            for a in range(9):
                t = v * Q[k, a]
                for b in range(9):
                    D[a, b] += t * Q[k, b]


@njit(cache=False, fastmath=True)
def _add_memory(F: Array, C: Array, M: Array, G: Array, D: Array) -> None:
    """Add the second derivatives of J^-2/3 (M : F^T F)/2 to D (9, 9), without those in J alone, which are in s2.

    M (3, 3) includes J^-2/3.
    """
    for i in range(3):
        for j in range(3):
            G[0, 3 * i + j] = F[i, 0] * M[0, j] + F[i, 1] * M[1, j] + F[i, 2] * M[2, j]
            G[2, 3 * i + j] = C[i, j]
            for k in range(3):
                D[3 * i + j, 3 * i + k] += M[j, k]
    mixed = -2 / 3 / (F[0, 0] * C[0, 0] + F[0, 1] * C[0, 1] + F[0, 2] * C[0, 2])
    for a in range(9):
        for b in range(9):
            D[a, b] += mixed * (G[0, a] * G[2, b] + G[2, a] * G[0, b])


@njit(cache=False)
def _clamp(D: Array) -> None:
    """The positive semi-definite part of the symmetric D (9, 9), by its numerical eigenvalues."""
    values, vectors = np.linalg.eigh(D)
    D[:] = 0.0
    for k in range(9):  # an array expression takes three seconds longer to compile
        if values[k] > 0.0:
            for a in range(9):
                for b in range(9):
                    D[a, b] += values[k] * vectors[a, k] * vectors[b, k]


@njit(cache=False, fastmath=True)
def _strained(F: Array) -> bool:
    """Whether |F^T F - I| exceeds MILD."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            c = F[0, i] * F[0, j] + F[1, i] * F[1, j] + F[2, i] * F[2, j] - (1.0 if i == j else 0.0)
            total += c * c
    return total > MILD * MILD


@njit(cache=True, fastmath=True)
def add_tangent(
    F: Array,
    B: Array,
    weights: Array,
    first: Array,
    second: Array,
    dilatation: Array,
    memory: Array | None,
    project: int,
    slots: Array,
    data: Array,
) -> None:
    """Add d2E/dx2 of all elements to `data` at `slots` (e, 3a*3a).

    `slots`: -1 where an entry is not stored. dilatation (e,): U''(mean J)/volume of elements with mean dilatation, a
    rank-one term; 0 for others. memory: see elasticity.Point; without it, its code is not compiled. project: see
    potential.Projection.
    """
    ne, nq, na, _ = B.shape
    nd = 3 * na
    A, V, W, Hs, U = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    C, G, Q, D = np.empty((3, 3)), np.empty((3, 9)), np.empty((9, 9)), np.empty((9, 9))
    # K[k, r, a] is the entry (r, 3a+k) and b[j, a] = dN_a/dX_j: inner loops run over nodes, contiguous in memory
    K, BD, g, b = np.empty((3, nd, na)), np.empty((nd, 9)), np.empty(nd), np.empty((3, na))
    for e in range(ne):
        K[:] = 0.0
        g[:] = 0.0
        for q in range(nq):
            w = weights[e, q]
            cofactor(F[e, q], C)
            clamped = project == 2 or (project == 1 and _strained(F[e, q]))
            if memory is not None:
                _exact(F[e, q], C, first[e, q], second[e, q], G, D)
                _add_memory(F[e, q], C, memory[e, q], G, D)
                if clamped:
                    _clamp(D)
            elif clamped:
                _projected(F[e, q], first[e, q], second[e, q], A, V, W, Hs, U, Q, D)
            else:
                _exact(F[e, q], C, first[e, q], second[e, q], G, D)
            for a in range(na):
                for j in range(3):
                    b[j, a] = B[e, q, a, j]
                for i in range(3):
                    for c in range(9):
                        t = b[0, a] * D[3 * i, c] + b[1, a] * D[3 * i + 1, c] + b[2, a] * D[3 * i + 2, c]
                        BD[3 * a + i, c] = w * t
            for k in range(3):
                for r in range(nd):
                    x, y, z = BD[r, 3 * k], BD[r, 3 * k + 1], BD[r, 3 * k + 2]
                    for a in range(na):
                        K[k, r, a] += x * b[0, a] + y * b[1, a] + z * b[2, a]
            if dilatation[e] != 0.0:
                for a in range(na):
                    for i in range(3):
                        g[3 * a + i] += w * (C[i, 0] * b[0, a] + C[i, 1] * b[1, a] + C[i, 2] * b[2, a])
        for r in range(nd):
            for a in range(na):
                for k in range(3):
                    slot = slots[e, r * nd + 3 * a + k]
                    if slot >= 0:
                        data[slot] += K[k, r, a] + dilatation[e] * g[r] * g[3 * a + k]
