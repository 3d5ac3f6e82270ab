"""Element kernels and the sparsity pattern of the stiffness matrix: deformation, invariants and nodal forces.

The kernels see the material law only through its derivatives with respect to the invariants (see materials).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacgen.compiled import njit

Array = np.ndarray


@njit(cache=False, fastmath=True)
def cofactor(F: Array, C: Array) -> None:
    """Write the cofactors of F (3, 3) into C (3, 3): J F^-T, also where J is 0."""
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            C[i, j] = F[i1, j1] * F[i2, j2] - F[i1, j2] * F[i2, j1]


@njit(cache=True)
def deformation(x: Array, conn: Array, B: Array) -> Array:
    """F (e, q, 3, 3) at every integration point."""
    ne, nq, na, _ = B.shape
    F, at = np.empty((ne, nq, 3, 3)), np.empty((na, 3))
    for e in range(ne):
        for a in range(na):
            for i in range(3):
                at[a, i] = x[conn[e, a], i]
        for q in range(nq):
            for i in range(3):
                along_x = along_y = along_z = 0.0  # sums in registers: memory would be written for each node
                for a in range(na):
                    along_x += at[a, i] * B[e, q, a, 0]
                    along_y += at[a, i] * B[e, q, a, 1]
                    along_z += at[a, i] * B[e, q, a, 2]
                F[e, q, i, 0], F[e, q, i, 1], F[e, q, i, 2] = along_x, along_y, along_z
    return F


@njit(cache=True, fastmath=True)
def least_J(x: Array, conn: Array, dN: Array, rest: Array) -> Array:
    """The smallest J (e,) over each element's points: det(dx/dxi), with derivatives dN (a, 3, q), over that at rest
    (e, q). The innermost loops run over points, which are contiguous in memory."""
    (ne, na), nq = conn.shape, rest.shape[1]
    least, T = np.empty(ne), np.empty((3, 3, nq))
    for e in range(ne):
        T[:] = 0.0
        for a in range(na):
            for i in range(3):
                v = x[conn[e, a], i]
                for j in range(3):
                    for q in range(nq):
                        T[i, j, q] += v * dN[a, j, q]
        low = np.inf
        for q in range(nq):
            A = T[1, 1, q] * T[2, 2, q] - T[1, 2, q] * T[2, 1, q]
            B = T[1, 2, q] * T[2, 0, q] - T[1, 0, q] * T[2, 2, q]
            C = T[1, 0, q] * T[2, 1, q] - T[1, 1, q] * T[2, 0, q]
            low = min(low, (T[0, 0, q] * A + T[0, 1, q] * B + T[0, 2, q] * C) / rest[e, q])
        least[e] = low
    return least


@njit(cache=True)
def invariants(F: Array) -> tuple[Array, Array, Array]:
    """I1, I2, J, each (e, q)."""
    ne, nq = F.shape[:2]
    I1, I2, J = np.empty((ne, nq)), np.empty((ne, nq)), np.empty((ne, nq))
    C = np.empty((3, 3))
    for e in range(ne):
        for q in range(nq):
            cofactor(F[e, q], C)
            a = b = 0.0
            for i in range(3):
                for j in range(3):
                    a += F[e, q, i, j] ** 2
                    b += C[i, j] ** 2  # tr(cof F^T cof F) = I2
            I1[e, q] = a
            I2[e, q] = b
            J[e, q] = F[e, q, 0, 0] * C[0, 0] + F[e, q, 0, 1] * C[0, 1] + F[e, q, 0, 2] * C[0, 2]
    return I1, I2, J


@njit(cache=True)
def predicted(taken: Array, F: Array, J: Array, to: Array) -> Array:
    """J (e, q) at `to` (e, q, 3, 3), predicted from J at F (e, q, 3, 3) to first order, linearised at `taken`."""
    out, C = J.copy(), np.empty((3, 3))
    for e in range(F.shape[0]):
        for q in range(F.shape[1]):
            cofactor(taken[e, q], C)
            for i in range(3):
                for j in range(3):
                    out[e, q] += C[i, j] * (to[e, q, i, j] - F[e, q, i, j])
    return out


@njit(cache=False)
def _piola(F: Array, C: Array, I1: float, w1: float, w2: float, w3: float, P: Array) -> None:
    """P = 2 w1 F + 2 w2 (I1 F - F F^T F) + w3 cof F."""
    for i in range(3):
        for j in range(3):
            P[i, j] = 2 * (w1 + w2 * I1) * F[i, j] + w3 * C[i, j]
    if w2 != 0.0:
        for i in range(3):
            for j in range(3):
                t = 0.0
                for k in range(3):
                    for m in range(3):
                        t += F[i, k] * F[m, k] * F[m, j]
                P[i, j] -= 2 * w2 * t


@njit(cache=True)
def add_forces(
    F: Array, conn: Array, B: Array, weights: Array, I1: Array, first: Array, memory: Array | None, out: Array
) -> None:
    """Add dE/dx to out (n, 3); first (e, q, 3) holds dW/dI1, dW/dI2, dW/dJ. memory: see elasticity.Point."""
    ne, nq, na, _ = B.shape
    C, P = np.empty((3, 3)), np.empty((3, 3))
    for e in range(ne):
        for q in range(nq):
            cofactor(F[e, q], C)
            _piola(F[e, q], C, I1[e, q], first[e, q, 0], first[e, q, 1], first[e, q, 2], P)
            if memory is not None:
                for i in range(3):
                    for j in range(3):
                        for k in range(3):
                            P[i, j] += F[e, q, i, k] * memory[e, q, k, j]
            for a in range(na):
                node = conn[e, a]
                for i in range(3):
                    t = P[i, 0] * B[e, q, a, 0] + P[i, 1] * B[e, q, a, 1] + P[i, 2] * B[e, q, a, 2]
                    out[node, i] += weights[e, q] * t


@njit(cache=True)
def cauchy(F: Array, I1: Array, J: Array, first: Array, memory: Array | None) -> Array:
    """sigma = P F^T / J (e, q, 3, 3); first and memory as in add_forces."""
    out, C, P = np.empty(F.shape), np.empty((3, 3)), np.empty((3, 3))
    for e in range(F.shape[0]):
        for q in range(F.shape[1]):
            cofactor(F[e, q], C)
            _piola(F[e, q], C, I1[e, q], first[e, q, 0], first[e, q, 1], first[e, q, 2], P)
            if memory is not None:
                for i in range(3):
                    for j in range(3):
                        for k in range(3):
                            P[i, j] += F[e, q, i, k] * memory[e, q, k, j]
            share = 1 / J[e, q]
            for i in range(3):
                for j in range(3):
                    t = P[i, 0] * F[e, q, j, 0] + P[i, 1] * F[e, q, j, 1] + P[i, 2] * F[e, q, j, 2]
                    out[e, q, i, j] = share * t
    return out


@njit(cache=True)
def mean_stress(sigma: Array, F: Array, volume: Array, weights: Array) -> tuple[Array, Array]:
    """Element means (e, 3, 3): of sigma over the current volume, and of P = sigma cof F over the rest volume."""
    now, rest, C = np.zeros((len(F), 3, 3)), np.zeros((len(F), 3, 3)), np.empty((3, 3))
    for e in range(len(F)):
        current, initial = volume[e].sum(), weights[e].sum()
        for q in range(F.shape[1]):
            cofactor(F[e, q], C)
            share, part, S = volume[e, q] / current, weights[e, q] / initial, sigma[e, q]
            for i in range(3):
                for j in range(3):
                    now[e, i, j] += share * S[i, j]
                    rest[e, i, j] += part * (S[i, 0] * C[0, j] + S[i, 1] * C[1, j] + S[i, 2] * C[2, j])
    return now, rest


@njit(cache=True)
def add_pressures(F: Array, conn: Array, B: Array, weighted: Array, out: Array) -> None:
    """Add the nodal forces of pressures at deformation F to out (n, 3); `weighted` (e, q): pressure times volume."""
    ne, nq, na, _ = B.shape
    C = np.empty((3, 3))
    for e in range(ne):
        for q in range(nq):
            cofactor(F[e, q], C)
            for a in range(na):
                node = conn[e, a]
                for i in range(3):
                    t = C[i, 0] * B[e, q, a, 0] + C[i, 1] * B[e, q, a, 1] + C[i, 2] * B[e, q, a, 2]
                    out[node, i] += weighted[e, q] * t


@njit(cache=True)
def at_points(x: Array, conn: Array, N: Array) -> Array:
    """Positions (f, q, 3) of the quadrature points of facets conn (f, a); N (q, a)."""
    out = np.empty((len(conn), len(N), 3))
    for f in range(len(conn)):
        for q in range(len(N)):
            for i in range(3):
                along = 0.0
                for a in range(conn.shape[1]):
                    along += N[q, a] * x[conn[f, a], i]
                out[f, q, i] = along
    return out


@njit(cache=True)
def add_point_forces(forces: Array, conn: Array, N: Array, out: Array) -> None:
    """Add forces (f, q, c) at the quadrature points of facets conn (f, a) to their nodes in out (n, c)."""
    for f in range(len(conn)):
        for q in range(len(N)):
            for a in range(conn.shape[1]):
                for i in range(forces.shape[2]):
                    out[conn[f, a], i] += N[q, a] * forces[f, q, i]


@njit(cache=True)
def add_point_blocks(D: Array, N: Array, slots: Array, data: Array) -> None:
    """Add stiffnesses D (f, q, 3, 3) of the quadrature points of facets to the CSR `data` at `slots` (f, 3a*3a)."""
    for f in range(len(D)):
        k = 0
        for a in range(N.shape[1]):
            for i in range(3):
                for b in range(N.shape[1]):
                    for j in range(3):
                        if slots[f, k] >= 0:
                            for q in range(len(N)):
                                data[slots[f, k]] += N[q, a] * N[q, b] * D[f, q, i, j]
                        k += 1


@njit(cache=True)
def add_dense_blocks(D: Array, N: Array, dofs: Array, K: Array) -> None:
    """Add stiffnesses D (f, q, 3, 3) of quadrature points to the dense K (k, k) at `dofs` (f, a, 3); -1: fixed."""
    for f in range(len(D)):
        for q in range(len(N)):
            for a in range(N.shape[1]):
                for b in range(N.shape[1]):
                    w = N[q, a] * N[q, b]
                    for i in range(3):
                        r = dofs[f, a, i]
                        if r >= 0:
                            for j in range(3):
                                c = dofs[f, b, j]
                                if c >= 0:
                                    K[r, c] += w * D[f, q, i, j]


@dataclass(frozen=True)
class Pattern:
    """Upper triangle of the stiffness matrix on the free dofs, in CSR, fixed for a mesh.

    indptr (m+1,), indices (nnz,) int32; free (m,) numbers of the free dofs among all 3n; pairs: sorted keys of the
    node pairs present; blocks (pairs, 3, 3): slot of each entry of a pair's block, -1 if it is not stored.
    """

    indptr: Array
    indices: Array
    free: Array
    nodes: int
    pairs: Array
    blocks: Array

    def slots(self, conn: Array) -> Array:
        """Slots (e, 3a*3a) of the element blocks of conn (e, a), rows and columns in the order 3a+i."""
        e, a = conn.shape
        keys = conn[:, :, None].astype(np.int64) * self.nodes + conn[:, None, :]
        slots = np.searchsorted(self.pairs, keys.ravel()).reshape(e, a, a)
        return np.ascontiguousarray(self.blocks[slots].transpose(0, 1, 3, 2, 4).reshape(e, -1))

    @property
    def size(self) -> int:
        """Number of free dofs."""
        return len(self.free)


def pattern(conns: Sequence[Array], free: Array) -> Pattern:
    """The pattern with all blocks of the elements `conns` (e, a) between free dofs; free (n, 3) bool."""
    n = len(free)
    keys = [np.unique((c[:, :, None].astype(np.int64) * n + c[:, None, :]).ravel()) for c in conns]
    pairs = np.unique(np.concatenate(keys))
    number = np.full(3 * n, -1, dtype=np.int64)
    kept = np.flatnonzero(free.ravel())
    number[kept] = np.arange(len(kept))
    dof = number.reshape(n, 3)
    rows = np.broadcast_to(dof[pairs // n][:, :, None], (len(pairs), 3, 3)).ravel()
    cols = np.broadcast_to(dof[pairs % n][:, None, :], (len(pairs), 3, 3)).ravel()
    keep = np.flatnonzero((rows >= 0) & (cols >= rows))
    order = np.lexsort((cols[keep], rows[keep]))
    slot = np.full(len(rows), -1, dtype=np.int32)
    slot[keep[order]] = np.arange(len(keep), dtype=np.int32)
    indptr = np.searchsorted(rows[keep][order], np.arange(len(kept) + 1)).astype(np.int32)
    return Pattern(indptr, cols[keep][order].astype(np.int32), kept, n, pairs, slot.reshape(-1, 3, 3))
