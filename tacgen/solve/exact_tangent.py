"""Linear equations with the exact tangent at an equilibrium, for several right-hand sides at once.

The iteration is preconditioned by the factor of a nearby tangent, which Newton's method kept; if it does not converge,
the exact tangent is factorised.
"""

import math
from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix

from tacgen.contact.barrier import Faces
from tacgen.solve.bulk import Bulk
from tacgen.solve.full_newton import exact_factor
from tacgen.solve.problem import Problem
from tacgen.solve.state import NotConverged

Array = np.ndarray
RTOL = 1e-2  # residual over load [-]; the error of forces is of second order in it, about 1e-3
MOST = 8  # most iterations
SINGULAR = "no sensitivity: the tangent is singular"


class ExactTangent:
    """The tangent of the bulk at x (n, 3); vectors are (k, n, 3), and 0 on the held dofs."""

    def __init__(self, problem: Problem, x: Array) -> None:
        self._problem, self._shape, pattern = problem, x.shape, problem.pattern
        self._free = pattern.free
        data = Bulk(problem.elastic, problem.folding, ()).at(x).stiffness(pattern)
        self._upper = csr_matrix((data, pattern.indices, pattern.indptr), shape=(pattern.size,) * 2)
        self._diagonal = self._upper.diagonal()[:, None]

    def _columns(self, V: Array) -> Array:
        return np.ascontiguousarray(V.reshape(len(V), math.prod(self._shape))[:, self._free].T)

    def _wide(self, v: Array) -> Array:
        out = np.zeros((v.shape[1], math.prod(self._shape)))
        out[:, self._free] = v.T
        return out.reshape(-1, *self._shape)

    def times(self, V: Array) -> Array:
        """K V."""
        v = self._columns(V)
        return self._wide(self._upper @ v + self._upper.T @ v - self._diagonal * v)

    def approximate(self, D: Array, on: Array) -> Callable[[Array], Array]:
        """Approximate V of (K + D) V = B, with stiffnesses D (f, q, 3, 3) at the points of facets `on`, by the kept
        factor, which must be condensed to these facets.

        Raises LinAlgError: singular.
        """
        condensed, faces = self._problem.tangent.condensation, self._problem.contact.faces.only(on)
        added = condensed.schur.stiffness(D, faces.N, condensed.dofs[condensed.local[faces.conn]])
        contact = condensed.schur.factored(added)
        return lambda B: self._wide(condensed.solve(self._columns(B), contact))

    def solver(self, D: Array, on: Array) -> Callable[[Array], Array]:
        """V of (K + D) V = B, for several B at once: all solutions share one basis.

        Raises NotConverged: singular.
        """
        faces = self._problem.contact.faces.only(on)
        condensed = self._problem.tangent.condensation if self._problem.condensed else None
        if condensed is None or not condensed.usable or not condensed.covers(faces.conn):
            return self._direct(D, faces)
        try:
            approximate = self.approximate(D, on)
        except np.linalg.LinAlgError:
            raise NotConverged(SINGULAR) from None

        def times(V: Array) -> Array:
            pushed = [faces.scatter(np.einsum("fqij,fqj->fqi", D, faces.at(v)), len(v)) for v in V]
            return self._columns(self.times(V) + np.stack(pushed))

        def solve(B: Array) -> Array:
            """Block Galerkin iteration: the residual is orthogonal to all vectors found so far."""
            b = self._columns(B)
            V = KV = np.zeros((len(b), 0))
            r, size = b, np.linalg.norm(b, axis=0)
            for _ in range(MOST):
                more = approximate(self._wide(r))
                V, KV = np.hstack([V, self._columns(more)]), np.hstack([KV, times(more)])
                y = _without_residual(V, KV, b)
                r = b - KV @ y
                if (np.linalg.norm(r, axis=0) <= RTOL * size).all():
                    return self._wide(V @ y)
            return self._direct(D, faces)(B)

        return solve

    def _direct(self, D: Array, faces: Faces) -> Callable[[Array], Array]:
        try:
            lu = exact_factor(self._problem.pattern, self._upper.data, faces, D)
        except RuntimeError:
            raise NotConverged(SINGULAR) from None
        return lambda B: self._wide(lu.solve(self._columns(B)))


def _without_residual(V: Array, KV: Array, b: Array) -> Array:
    """y of V^T (K V y - b) = 0, with the columns of V normalised."""
    size = np.maximum(np.linalg.norm(V, axis=0), 1e-300)
    V, KV = V / size, KV / size
    return np.asarray(np.linalg.lstsq(V.T @ KV, V.T @ b, rcond=None)[0] / size[:, None])
