"""The sparsity pattern of the stiffness matrix, and sums over the quadrature points of facets."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacgen.physics import assembly
from tacgen.physics.runtime import call

Array = np.ndarray


def at_points(x: Array, conn: Array, N: Array) -> Array:
    """Positions (f, q, 3) of the quadrature points of facets conn (f, a); N (q, a)."""
    out = np.empty((len(conn), len(N), 3))
    call(assembly.at_points, (1, *out.shape[:2]), x[None], np.asarray(conn, np.int32)[None], N, out[None])
    return out


def add_point_forces(forces: Array, conn: Array, N: Array, out: Array) -> None:
    """Add forces (f, q, c) at the quadrature points of facets conn (f, a) to their nodes in out (n, c)."""
    (f, q, c), conn = forces.shape, np.asarray(conn, np.int32)
    if c % 3 == 0:
        call(assembly.add_forces, (1,), forces.reshape(f, q, c // 3, 3), conn, N, out.reshape(-1, c // 3, 3))
        return
    triples = np.zeros((len(out), c + -c % 3))
    add_point_forces(np.pad(forces, ((0, 0), (0, 0), (0, -c % 3))), conn, N, triples)
    out += triples[:, :c]


def add_dense_blocks(D: Array, N: Array, dofs: Array, K: Array) -> None:
    """Add stiffnesses D (f, q, 3, 3) of quadrature points to the dense K (k, k) at `dofs` (f, a, 3); -1: fixed."""
    call(assembly.add_dense_blocks, (1,), D, N, dofs, K)


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
