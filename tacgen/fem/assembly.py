"""The sparsity pattern of the stiffness matrix, and sums over the quadrature points of facets."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacgen.base.compiled import njit

Array = np.ndarray


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
