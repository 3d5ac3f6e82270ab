"""Sums over the quadrature points of facets, and into the stiffness matrix, as Warp kernels; sums for one scene.

Facets conn (f, a) with shape functions N (q, a) at their points. One thread adds all facets, in their order, so that
sums repeat. Loops are by `while`: those by `range` over a number that is not known take two to three times as long on a
core.
"""

import warp as wp

from tacgen.physics.types import Ints2, Ints3, Longs3, Matrices2, Reals, Reals2, Vectors2, Vectors3

MIRRORED_ROWS = wp.constant(32)  # rows and columns of blocks that fit into the processor's cache


@wp.func
def point(x: Vectors2, conn: Ints3, N: Reals2, s: int, f: int, q: int) -> wp.vec3d:
    """A quadrature point of a facet of one of several scenes, with nodes x (s, n) and facets conn (s, f, a)."""
    at = wp.vec3d()
    a = int(0)
    while a < N.shape[1]:
        at += N[q, a] * x[s, conn[s, f, a]]
        a += 1
    return at


@wp.kernel(enable_backward=False, module="tacgen.physics")
def at_points(x: Vectors2, conn: Ints3, N: Reals2, out: Vectors3):
    """Positions (s, f, q) of the points of facets."""
    s, f, q = wp.tid()
    out[s, f, q] = point(x, conn, N, s, f, q)


@wp.kernel(enable_backward=False, module="tacgen.physics")
def add_forces(forces: Vectors3, conn: Ints2, N: Reals2, out: Vectors2):
    """Add forces (f, q, c) at points to the nodes in out (n, c)."""
    f = int(0)
    while f < forces.shape[0]:
        c = int(0)
        while c < forces.shape[2]:
            a = int(0)
            while a < N.shape[1]:
                n = conn[f, a]
                total = out[n, c]
                q = int(0)
                while q < N.shape[0]:
                    total += N[q, a] * forces[f, q, c]
                    q += 1
                out[n, c] = total
                a += 1
            c += 1
        f += 1


@wp.func
def block(D: Matrices2, N: Reals2, f: int, a: int, b: int) -> wp.mat33d:
    """The stiffness between two nodes of a facet of those D (f, q) at its points."""
    total = wp.mat33d()
    q = int(0)
    while q < N.shape[0]:
        total += N[q, a] * N[q, b] * D[f, q]
        q += 1
    return total


@wp.kernel(enable_backward=False, module="tacgen.physics")
def add_sparse_blocks(D: Matrices2, N: Reals2, slots: Ints2, data: Reals):
    """Add stiffnesses D (f, q) of points to the entries `data` of a sparse matrix at `slots` (f, 3a*3a), rows and
    columns 3 a + direction; -1: not stored."""
    for f in range(D.shape[0]):
        for a in range(N.shape[1]):
            for b in range(N.shape[1]):
                K = block(D, N, f, a, b)
                for i in range(3):
                    for j in range(3):
                        slot = slots[f, (3 * a + i) * 3 * N.shape[1] + 3 * b + j]
                        if slot >= 0:
                            data[slot] = data[slot] + K[i, j]


@wp.kernel(enable_backward=False, module="tacgen.physics")
def add_dense_blocks(D: Matrices2, N: Reals2, dofs: Longs3, K: Reals2):
    """Add stiffnesses D (f, q) of points to the dense K (k, k) at `dofs` (f, a, 3); -1: fixed."""
    f = int(0)
    while f < D.shape[0]:
        a = int(0)
        while a < N.shape[1]:
            b = int(0)
            while b < N.shape[1]:
                add = block(D, N, f, a, b)
                for i in range(3):
                    r = dofs[f, a, i]
                    for j in range(3):
                        c = dofs[f, b, j]
                        if r >= wp.int64(0) and c >= wp.int64(0):
                            K[r, c] = K[r, c] + add[i, j]
                b += 1
            a += 1
        f += 1


@wp.kernel(enable_backward=False, module="tacgen.physics")
def mirror(A: Reals2):
    """Copy the lower triangle of A (k, k) to the upper one, a row of blocks with each thread."""
    first = wp.tid() * MIRRORED_ROWS
    last = wp.min(first + MIRRORED_ROWS, A.shape[0])
    column = int(0)
    while column < last:
        i = int(first)
        while i < last:
            j, end = int(column), wp.min(column + MIRRORED_ROWS, i)
            while j < end:
                A[j, i] = A[i, j]
                j += 1
            i += 1
        column += MIRRORED_ROWS
