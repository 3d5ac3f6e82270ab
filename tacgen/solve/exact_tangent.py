"""Linear equations with the exact tangent at an equilibrium, for several right-hand sides at once.

The factor that is kept is that of the exact tangent at the last equilibrium. At those before, in the same frame, it
preconditions an iteration; if that does not converge, the exact tangent is factorised.
"""

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix

from tacgen.contact.barrier import Faces
from tacgen.solve.bulk import Bulk
from tacgen.solve.full_newton import exact_factor
from tacgen.solve.problem import Problem
from tacgen.solve.state import NotConverged

Array = np.ndarray
Solve = Callable[[Array], Array]
RTOL = 1e-3  # residual over load [-]
MOST = 8  # most iterations
SINGULAR = "no sensitivity: the tangent is singular"


def free_columns(problem: Problem, V: Array) -> Array:
    """(m, k) on the free dofs of V (k, n, 3)."""
    return np.ascontiguousarray(V.reshape(len(V), -1)[:, problem.pattern.free].T)


def everywhere(problem: Problem, v: Array) -> Array:
    """(k, n, 3) of v (m, k) on the free dofs, 0 on the others."""
    out = np.zeros((v.shape[1], 3 * problem.pattern.nodes))
    out[:, problem.pattern.free] = v.T
    return out.reshape(len(out), -1, 3)


class ExactTangent:
    """The tangent of the bulk at x (n, 3); vectors are (k, n, 3), and 0 on the held dofs."""

    def __init__(self, problem: Problem, x: Array) -> None:
        self._problem, pattern = problem, problem.pattern
        data = Bulk(problem.elastic, problem.folding, ()).at(x).stiffness(pattern)
        self._upper = csr_matrix((data, pattern.indices, pattern.indptr), shape=(pattern.size,) * 2)
        self._diagonal = self._upper.diagonal()[:, None]

    def times(self, V: Array) -> Array:
        """K V."""
        v = free_columns(self._problem, V)
        return everywhere(self._problem, self._upper @ v + self._upper.T @ v - self._diagonal * v)

    def iteration(self, D: Array, faces: Faces, near: Solve) -> Solve:
        """V of (K + D) V = B, for several B at once: they share one basis. `near` is an approximate inverse."""
        problem = self._problem

        def times(V: Array) -> Array:
            pushed = [faces.scatter(np.einsum("fqij,fqj->fqi", D, faces.at(v)), len(v)) for v in V]
            return free_columns(problem, self.times(V) + np.stack(pushed))

        def solve(B: Array) -> Array:
            """Block Galerkin iteration: the residual is orthogonal to all vectors found so far."""
            b = free_columns(problem, B)
            V = KV = np.zeros((len(b), 0))
            r, size = b, np.linalg.norm(b, axis=0)
            for _ in range(MOST):
                more = near(everywhere(problem, r))
                V, KV = np.hstack([V, free_columns(problem, more)]), np.hstack([KV, times(more)])
                y = _without_residual(V, KV, b)
                r = b - KV @ y
                if (np.linalg.norm(r, axis=0) <= RTOL * size).all():
                    return everywhere(problem, V @ y)
            return self.direct(D, faces)(B)

        return solve

    def direct(self, D: Array, faces: Faces) -> Solve:
        """The same by a factor of K + D. Raises NotConverged: singular."""
        try:
            lu = exact_factor(self._problem.pattern, self._upper.data, faces, D)
        except RuntimeError:
            raise NotConverged(SINGULAR) from None
        return lambda B: everywhere(self._problem, lu.solve(free_columns(self._problem, B)))


def solver(problem: Problem, x: Array, D: Array, on: Array) -> Solve:
    """V of (K + D) V = B (k, n, 3), with K at x (n, 3) and stiffnesses D (f, q, 3, 3) at the points of facets `on`.

    Raises NotConverged: singular.
    """
    faces, tangent = problem.contact.faces.only(on), problem.tangent
    if not (problem.condensed and tangent.usable and tangent.condensation.covers(faces.conn)):
        return ExactTangent(problem, x).direct(D, faces)
    condensed = tangent.condensation
    added = condensed.schur.stiffness(D, faces.N, condensed.dofs[condensed.local[faces.conn]])
    try:
        contact = condensed.schur.factored(added)
    except np.linalg.LinAlgError:
        raise NotConverged(SINGULAR) from None

    def solve(B: Array) -> Array:
        return everywhere(problem, condensed.solve(free_columns(problem, B), contact))

    exact = tangent.exact_at is x and condensed.schur.damping == 0
    return solve if exact else ExactTangent(problem, x).iteration(D, faces, solve)


def _without_residual(V: Array, KV: Array, b: Array) -> Array:
    """y of V^T (K V y - b) = 0, with the columns of V normalised."""
    size = np.maximum(np.linalg.norm(V, axis=0), 1e-300)
    V, KV = V / size, KV / size
    return np.asarray(np.linalg.lstsq(V.T @ KV, V.T @ b, rcond=None)[0] / size[:, None])
