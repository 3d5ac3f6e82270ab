"""The positive semi-definite part of the second derivative of an isotropic energy, by its eigenmatrices.

They are known in the principal stretches: three scalings, three flips, three twists. Smith, de Goes & Kim (2019),
"Analytic eigensystems for isotropic distortion energies".
"""

import warp as wp

from tacgen.physics.laws import Derivatives
from tacgen.physics.types import real

MILD_STRAIN = 0.1  # |F^T F - 1| below which the exact tangent is not projected: it is positive definite near rest [-]
MILD = wp.constant(real(MILD_STRAIN**2))
HALF_ROOT = wp.constant(real(0.5**0.5))


@wp.func
def slopes_in_stretches(d: Derivatives, s: wp.vec3d) -> wp.mat33d:
    """d2W/ds2 of the principal stretches s."""
    I1, J = wp.dot(s, s), s[0] * s[1] * s[2]
    H = wp.mat33d()
    for i in range(3):
        i1, i2, i3 = real(2.0) * s[i], real(2.0) * s[i] * (I1 - s[i] * s[i]), J / s[i]
        for j in range(3):
            j1, j2, j3 = real(2.0) * s[j], real(2.0) * s[j] * (I1 - s[j] * s[j]), J / s[j]
            v = d.w11 * i1 * j1 + d.w22 * i2 * j2 + d.w33 * i3 * j3 + d.w12 * (i1 * j2 + i2 * j1)
            v += d.w13 * (i1 * j3 + i3 * j1) + d.w23 * (i2 * j3 + i3 * j2)
            if i == j:
                v += real(2.0) * d.w1 + real(2.0) * d.w2 * (I1 - s[i] * s[i])
            else:
                v += real(4.0) * d.w2 * s[i] * s[j] + d.w3 * s[3 - i - j]
            H[i, j] = v
    return H


@wp.func
def rotated(A: wp.mat33d, V: wp.mat33d, p: int, q: int):
    """A and V after the Jacobi rotation that makes A[p, q] zero."""
    if A[p, q] != real(0.0):
        r = 3 - p - q
        h = (A[q, q] - A[p, p]) / (real(2.0) * A[p, q])
        t = wp.where(h < real(0.0), real(-1.0), real(1.0)) / (wp.abs(h) + wp.sqrt(h * h + real(1.0)))
        c = real(1.0) / wp.sqrt(t * t + real(1.0))
        s = t * c
        A[p, p] -= t * A[p, q]
        A[q, q] += t * A[p, q]
        A[p, q] = real(0.0)
        u, v = A[wp.min(r, p), wp.max(r, p)], A[wp.min(r, q), wp.max(r, q)]
        A[wp.min(r, p), wp.max(r, p)] = c * u - s * v
        A[wp.min(r, q), wp.max(r, q)] = s * u + c * v
        for k in range(3):
            x, y = V[k, p], V[k, q]
            V[k, p] = c * x - s * y
            V[k, q] = s * x + c * y
    return A, V


@wp.func
def eigensystem(A: wp.mat33d):
    """Eigenvectors, in columns, and eigenvalues of the symmetric A, of which the upper triangle is used.

    By cyclic Jacobi: with wp.eig3 projected tangents take half as long again.
    """
    V = wp.identity(n=3, dtype=real)
    for _ in range(12):
        off = A[0, 1] * A[0, 1] + A[0, 2] * A[0, 2] + A[1, 2] * A[1, 2]
        if off < real(1e-22) * (A[0, 0] * A[0, 0] + A[1, 1] * A[1, 1] + A[2, 2] * A[2, 2]):
            break
        A, V = rotated(A, V, 0, 1)
        A, V = rotated(A, V, 0, 2)
        A, V = rotated(A, V, 1, 2)
    return V, wp.vec3d(A[0, 0], A[1, 1], A[2, 2])


@wp.struct
class Stretches:
    """F = U diag(s) V^T; eigenvectors and eigenvalues of d2W/ds2."""

    U: wp.mat33d
    V: wp.mat33d
    s: wp.vec3d
    scaling: wp.mat33d
    values: wp.vec3d


@wp.func
def stretches(F: wp.mat33d, d: Derivatives) -> Stretches:
    o = Stretches()
    V, squared = eigensystem(wp.transpose(F) * F)
    o.V = V
    o.s = wp.vec3d(wp.sqrt(squared[0]), wp.sqrt(squared[1]), wp.sqrt(squared[2]))
    U = F * V
    for i in range(3):
        for j in range(3):
            U[i, j] = U[i, j] / o.s[j]
    o.U = U
    scaling, values = eigensystem(slopes_in_stretches(d, o.s))
    o.scaling = scaling
    o.values = values
    return o


@wp.func
def eigenvalue(o: Stretches, d: Derivatives, n: int) -> real:
    """One of the nine of d2W/dF2: of scalings, flips and twists."""
    k = n % 3
    if n < 3:
        return o.values[k]
    sign = wp.where(n < 6, real(-1.0), real(1.0))
    c, others = o.s[k], o.s[(k + 1) % 3] * o.s[(k + 2) % 3]
    return real(2.0) * d.w1 + real(2.0) * d.w2 * (c * c + sign * others) + sign * d.w3 * c


@wp.func
def eigenmatrix(o: Stretches, n: int) -> wp.mat33d:
    """That of `eigenvalue`, of norm 1."""
    k = n % 3
    if n < 3:
        Q = wp.mat33d()
        for j in range(3):
            Q += o.scaling[j, k] * wp.outer(column(o.U, j), column(o.V, j))
        return Q
    a, b = (k + 1) % 3, (k + 2) % 3
    sign = wp.where(n < 6, real(-1.0), real(1.0))
    return HALF_ROOT * (wp.outer(column(o.U, a), column(o.V, b)) - sign * wp.outer(column(o.U, b), column(o.V, a)))


@wp.func
def column(A: wp.mat33d, j: int) -> wp.vec3d:
    return wp.vec3d(A[0, j], A[1, j], A[2, j])


@wp.func
def strained(F: wp.mat33d) -> bool:
    E = wp.transpose(F) * F - wp.identity(n=3, dtype=real)
    return wp.ddot(E, E) > MILD
