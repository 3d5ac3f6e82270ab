"""Newton's method on all unknowns at once: the reference solver, also used where CHOLMOD's factors cannot be read.

The same equations, merit function and steps as in contact_newton, with the bulk itself instead of its Schur complement:
a new exact tangent in each step, and one sparse LU factorisation of bulk and contact together.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tacgen.fem.assembly import Pattern
from tacgen.fem.projection import Projection
from tacgen.mechanics.barrier import Faces
from tacgen.mechanics.bulk import Bulk, BulkPoint
from tacgen.mechanics.coupled import CoupledContact
from tacgen.mechanics.linear_solvers import NotPositiveDefinite
from tacgen.mechanics.problem import Problem

Array = np.ndarray


@dataclass(frozen=True)
class WholeBulk:
    """The bulk for contact_newton.solve_contact."""

    problem: Problem
    bulk: Bulk

    def at(self, x: Array) -> BulkPoint:
        return self.bulk.at(x)

    def along(self, here: BulkPoint, x: Array, p: Array) -> Callable[[float], float]:
        return lambda fraction: self.bulk.at(x + fraction * p).energy

    def solve(self, here: BulkPoint, contact: CoupledContact, D: Array, g: Array, symmetric: bool) -> Array | None:
        pattern, p = self.problem.pattern, np.zeros(g.size)
        data = here.stiffness(pattern, Projection.FULL if symmetric else Projection.NONE)
        b = -g.ravel()[pattern.free]
        if symmetric:
            contact.contact.faces.add_blocks(np.arange(len(D)), D, data)
            try:
                self.problem.linear.factor(data)
            except NotPositiveDefinite:
                return None
            p[pattern.free] = self.problem.linear.solve(b)
            return p.reshape(g.shape)
        try:
            p[pattern.free] = exact_factor(pattern, data, contact.contact.faces, D).solve(b)
        except RuntimeError:  # singular
            return None
        return p.reshape(g.shape) if np.isfinite(p).all() else None


def exact_factor(pattern: Pattern, data: Array, faces: Faces, D: Array) -> "sp.linalg.SuperLU":
    """LU on the free dofs of the bulk's tangent `data` and stiffnesses D (f, q, 3, 3) of the faces' points.

    Raises RuntimeError: singular.
    """
    upper = sp.csr_matrix((data, pattern.indices, pattern.indptr), shape=(pattern.size,) * 2)
    K = upper + sp.triu(upper, 1).T + _sparse(pattern, faces, D)
    options = {"SymmetricMode": True}
    return sp.linalg.splu(K.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01, options=options)


def _sparse(pattern: Pattern, faces: Faces, D: Array) -> sp.csr_matrix:
    """The contact's tangent on the free dofs."""
    loaded, dofs = np.flatnonzero(D.any((1, 2, 3))), 3 * pattern.nodes
    blocks = np.einsum("qa,qb,fqij->faibj", faces.N, faces.N, D[loaded])
    size = 3 * faces.conn.shape[1]
    number = (3 * faces.conn[loaded][..., None] + np.arange(3)).reshape(len(loaded), size)
    rows, columns = np.repeat(number, size, 1).ravel(), np.tile(number, (1, size)).ravel()
    whole = sp.coo_matrix((blocks.ravel(), (rows, columns)), shape=(dofs, dofs)).tocsr()
    return whole[pattern.free][:, pattern.free]
