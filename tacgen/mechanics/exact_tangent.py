"""Linear equations with the exact tangent at an equilibrium, for several right-hand sides at once.

No other tangent will do: in a nearly incompressible gel the bulk modulus multiplies its error. With one taken at a
Newton iterate .5 % of the load step away from the equilibrium, derivatives by friction were up to 10 % off.
"""

from collections.abc import Callable

import numpy as np

from tacgen.mechanics.barrier import Faces
from tacgen.mechanics.bulk import Bulk, Tangent
from tacgen.mechanics.failures import Failure, NotConverged
from tacgen.mechanics.full_newton import exact_factor
from tacgen.mechanics.problem import Problem

Array = np.ndarray
Solve = Callable[[Array], Array]


def free_columns(problem: Problem, V: Array) -> Array:
    """(m, k) on the free dofs of V (k, n, 3)."""
    return np.ascontiguousarray(V.reshape(len(V), -1)[:, problem.pattern.free].T)


def everywhere(problem: Problem, v: Array) -> Array:
    """(k, n, 3) of v (m, k) on the free dofs, 0 on the others."""
    out = np.zeros((v.shape[1], 3 * problem.pattern.nodes))
    out[:, problem.pattern.free] = v.T
    return out.reshape(len(out), -1, 3)


def solver(problem: Problem, tangent: Tangent, x: Array, D: Array, on: Array) -> Solve:
    """V of (K + D) V = B (k, n, 3), with K at x (n, 3) and stiffnesses D (f, q, 3, 3) at the points of facets `on`.

    `tangent` is used if it is the exact one at x; otherwise K is factorised.

    Raises NotConverged: singular.
    """
    faces, at_x = problem.contact.faces.only(on), tangent.condensation
    exact = tangent.usable and tangent.exact_at is x
    if not exact or at_x.schur.damping or not at_x.covers(faces.conn):
        return _direct(problem, x, D, faces)
    K = at_x.schur.stiffness(D, faces.N, at_x.dofs[at_x.local[faces.conn]])
    try:
        contact = at_x.schur.solver(K)
    except np.linalg.LinAlgError:
        raise NotConverged(Failure.singular) from None
    return lambda B: everywhere(problem, at_x.solve(free_columns(problem, B), contact))


def _direct(problem: Problem, x: Array, D: Array, faces: Faces) -> Solve:
    data = Bulk(problem.elastic, problem.folding).at(x).stiffness(problem.pattern)
    try:
        lu = exact_factor(problem.pattern, data, faces, D)
    except RuntimeError:
        raise NotConverged(Failure.singular) from None
    return lambda B: everywhere(problem, lu.solve(free_columns(problem, B)))
