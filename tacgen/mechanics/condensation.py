"""The bulk's tangent, factorised with the nodes near the contact eliminated last. Contact is solved on the remaining
Schur complement (static condensation, Guyan 1965), which is small and dense.

With K = L L^T and the contact's dofs c last, the Schur complement is S = L_cc L_cc^T, and a load on all other dofs
reaches c through one forward substitution.

Levenberg-Marquardt damping adds a multiple of the Schur complement at rest, S_0: like a viscosity of the gel it resists
strain, and so the short waves of a fold, far more than a motion of the whole contact.
"""

from collections.abc import Callable
from functools import cache, partial

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, lu_solve, solve_triangular
from scipy.linalg.blas import dsymv, dsyrk
from scipy.linalg.lapack import dgetrf, dlauum, sgetrf, sgetrs

from tacgen.fem.assembly import Pattern, add_dense_blocks
from tacgen.mechanics.linear_solvers import Cholmod, dissection
from tacgen.physics import assembly
from tacgen.physics.runtime import call

Array = np.ndarray
MIN_DAMPING = 0.02  # smallest Levenberg-Marquardt damping that is worth trying, over the stiffness at rest [-]
DAMPING_FACTOR = 4.0  # by which damping is increased where it does not suffice [-]
# Diagonal shift of the condensed dofs over the largest diagonal entry [-]: added before the factorisation and
# subtracted from S, so that only the part of the gel away from the contact must be stable by itself
CONDENSED_DIAGONAL_SHIFT = 10.0
# unknowns from which LU in single precision, refined to double, is faster than in double
MIN_SINGLE_PRECISION_DOFS = 400
REFINED_SOLUTION_TOL = 1e-11  # error of a refined solution over its size [-]
MAX_REFINEMENTS = 8  # most refinements; the contact's stiffness takes one or two


def more(damping: float) -> float:
    """The next larger damping, over the stiffness at rest [-]."""
    return max(DAMPING_FACTOR * damping, MIN_DAMPING)


class Condensation:
    """A factorised tangent condensed to the nodes of some facets; `at_rest` computes the entries of that at rest."""

    def __init__(self, whole: Pattern, at_rest: Callable[[], Array]) -> None:
        self.whole, self._order, self._at_rest = whole, dissection(whole), at_rest
        self._free = np.zeros((whole.nodes, 3), bool)
        self._free.ravel()[whole.free] = True
        # condensed nodes; their numbers
        self.nodes, self.local = np.zeros(0, np.int64), np.full(whole.nodes, -1, np.int32)
        self._factored = 0  # number of factorisations, except that at rest
        self.usable = False

    def cover(self, facets: Array) -> None:
        """Condense to the nodes of these facets (f, a) from now on."""
        self._factored = self.factored
        self.nodes = np.unique(facets)
        self.local = np.full(self.whole.nodes, -1, np.int32)
        self.local[self.nodes] = np.arange(len(self.nodes))
        free = self._free[self.nodes]
        self.dofs = np.full(free.shape, -1)  # (k, 3) number among the condensed unknowns, -1 where held
        self.dofs[free] = np.arange(free.sum())
        self.size = int(free.sum())
        last = (self.local >= 0)[self.whole.free // 3][self._order]
        condensed = np.isin(self.whole.free // 3, self.nodes)
        ordered = partial(Cholmod, self.whole, np.concatenate([self._order[~last], self._order[last]]))
        self._factor = ordered()
        if not condensed[self._factor.order[-self.size :]].all():  # as where the gel is one cell thick
            ordered = partial(ordered, postorder=False)
            self._factor = ordered()
        self._diagonal = self.whole.indptr[:-1][condensed]  # entries, each the first of its row
        self._rows = np.argsort(self._factor.order[-self.size :])  # the factor has an order of its own
        parts = ordered, self._at_rest, self._diagonal, self._rows
        self._rest = cache(partial(_schur_at_rest, *parts))  # not a method: a cycle would outlive the scene
        self.usable = False

    def covers(self, facets: Array) -> bool:
        """Whether it is condensed to all nodes of these facets (f, a)."""
        return bool((self.local[facets] >= 0).all())

    def factor(self, data: Array) -> None:
        """Raises NotPositiveDefinite."""
        self.usable = False
        self._factored += 1
        self._L, S = _condensed(self._factor, data, self._diagonal, self._rows)
        self.schur = Schur(S, self._rest)
        self.usable = True

    @property
    def factored(self) -> int:
        """Number of factorisations so far."""
        return self._factored + (self._rest.cache_info().currsize if self.nodes.size else 0)

    def forward(self, g: Array) -> Array:
        """L^-1 of a gradient (n, 3)."""
        return self._factor.forward(g.ravel()[self.whole.free])

    def load(self, y: Array) -> Array:
        """The condensed gradient (k,)."""
        return np.asarray(self._L @ y[-self.size :])

    def solve(self, b: Array, contact: Callable[[Array], Array]) -> Array:
        """x (m, k) of K x = b on the free dofs, where `contact` solves for what is condensed."""
        y = self._factor.forward(b)
        y[-self.size :] = self._L.T @ contact(self._L @ y[-self.size :])
        return self._factor.backward(y)

    def expand(self, u: Array, y: Array) -> Array:
        """The step (n, 3) of all nodes for the condensed step u (k,) and the gradient L y."""
        q = np.concatenate([-y[: -self.size], u @ self._L])
        p = np.zeros(self._free.shape)
        p.ravel()[self.whole.free] = self._factor.backward(q)
        return p


def _lu(K: Array) -> Callable[[Array], Array]:
    """K^-1, to whose solver K belongs from now on. Raises LinAlgError: singular."""
    return _refined(K) if len(K) >= MIN_SINGLE_PRECISION_DOFS else _double(K)


def _double(K: Array) -> Callable[[Array], Array]:
    """K^-1; overwrites K. LAPACK keeps columns where NumPy keeps rows: the transpose is factorised, without a copy.

    Raises LinAlgError: singular.
    """
    if not len(K):
        return lambda b: b
    lu, pivots, info = dgetrf(K.T, overwrite_a=1)
    if info > 0:
        raise np.linalg.LinAlgError("singular")
    return partial(lu_solve, (lu, pivots), trans=1, check_finite=False)


def _refined(K: Array) -> Callable[[Array], Array]:
    """K^-1 by LU in single precision, half the work of double, with iterative refinement to double precision: Langou et
    al. (2006), "Exploiting the performance of 32 bit floating point arithmetic". In double where that does not
    converge.

    Raises LinAlgError: singular.
    """
    lu, pivots, info = sgetrf(K.astype(np.float32).T, overwrite_a=1)
    if info > 0:
        return _double(K)

    def rough(b: Array) -> Array:
        return np.asarray(sgetrs(lu, pivots, b.astype(np.float32), trans=1)[0], float).reshape(b.shape)

    def solve(b: Array) -> Array:
        x = rough(b)
        size = float(np.linalg.norm(x))
        for _ in range(MAX_REFINEMENTS):
            step = rough(b - K @ x)
            x += step
            before, size = size, float(np.linalg.norm(step))
            # steps shrink by the same factor each
            if size**2 <= REFINED_SOLUTION_TOL * float(np.linalg.norm(x)) * before:
                return x
            if not size < before:
                break
        return _double(K.copy())(b)

    return solve


def _cholesky(K: Array) -> Callable[[Array], Array]:
    """K^-1 of a symmetric K, of which it reads and overwrites the upper triangle. Raises LinAlgError: not positive
    definite."""
    return partial(cho_solve, cho_factor(K.T, lower=True, overwrite_a=True, check_finite=False), check_finite=False)


def _condensed(factor: Cholmod, data: Array, diagonal: Array, rows: Array) -> tuple[Array, Array]:
    """Factorises a matrix of entries `data`, shifted at those of the condensed `diagonal`: the condensed rows of the
    factor, which are its last ones at `rows`, and the Schur complement."""
    size, data = len(rows), data.copy()
    shift = CONDENSED_DIAGONAL_SHIFT * float(np.abs(data[diagonal]).max())
    data[diagonal] += shift
    factor.factor(data)
    L = factor.trailing(size)
    # L L^T, a third of the work of a product: LAPACK has U U^T of triangles, and L backwards is upper triangular
    upper = dlauum(np.asfortranarray(L[::-1, ::-1]), overwrite_c=1)[0]
    _mirror(upper.T)
    backwards = size - 1 - rows
    S = upper.T[np.ix_(backwards, backwards)]  # a third of the time of two calls of take
    S[np.diag_indices(size)] -= shift
    return L[rows], S


def _mirror(A: Array) -> None:
    """Copy the lower triangle of A (k, k) to the upper one."""
    call(assembly.mirror, (-(-len(A) // int(assembly.MIRRORED_ROWS)),), A)


def _schur_at_rest(
    new_factor: Callable[[], Cholmod], entries: Callable[[], Array], diagonal: Array, rows: Array
) -> Array:
    """S_0 (k, k), by a factor of its own as the other stays in use."""
    return _condensed(new_factor(), entries(), diagonal, rows)[1]


class Schur:
    """The Schur complement S (k, k), a dense symmetric stiffness, with `damping` times that at rest added.

    Contact acts on few of its unknowns. The others are eliminated once; the set of `active` ones, on which contact has
    acted, only grows. The eliminated part must be positive definite: damping is increased until it is.
    """

    def __init__(self, S: Array, at_rest: Callable[[], Array], damping: float = 0.0) -> None:
        self.undamped, self._at_rest, self.damping = S, at_rest, damping
        self.S = S + damping * at_rest() if damping else S
        self.active = np.zeros(len(S), bool)
        self._reduced: tuple[Array, Array, Array] | None = None

    def damped(self, damping: float) -> "Schur":
        """This Schur complement with another damping."""
        return self if damping == self.damping else Schur(self.undamped, self._at_rest, damping)

    def times(self, u: Array) -> Array:
        """S u (k,); reads half of S."""
        return np.asarray(dsymv(1.0, self.S.T, u, lower=1)) if len(u) else u

    def activate(self, which: Array) -> None:
        """Make these unknowns (k,) bool active too."""
        if self._reduced is not None and not (which & ~self.active).any():
            return
        self.active = self.active | which
        o, a = np.flatnonzero(~self.active), np.flatnonzero(self.active)
        while True:
            try:
                L = cholesky(self._part(o, o), lower=True, overwrite_a=True, check_finite=False)
                break
            except np.linalg.LinAlgError:
                harder = self.damped(more(self.damping))
                self.damping, self.S = harder.damping, harder.S
        W = solve_triangular(L, self._part(o, a), lower=True, overwrite_b=True, check_finite=False)
        K = self._part(a, a)
        if W.size:
            K = dsyrk(-1.0, W, beta=1.0, c=K, trans=1, overwrite_c=1)
            _mirror(K.T)
        self._reduced = L, W, K.T

    def _part(self, rows: Array, columns: Array) -> Array:
        """S[rows, columns], a copy column by column as LAPACK has it."""
        return np.asarray(self.S[np.ix_(columns, rows)].T)

    @property
    def reduced(self) -> Array:
        """The stiffness (a, a) of the bulk on the active unknowns."""
        assert self._reduced is not None
        return self._reduced[2]

    def stiffness(self, D: Array, N: Array, dofs: Array) -> Array:
        """Stiffness (a, a) on the active unknowns of the bulk and of tangents D (f, q, 3, 3) [N/mm] at the points of
        facets; the unknowns of these facets become active.

        N (q, a): shape functions; dofs (f, a, 3): numbers of the condensed unknowns, -1 where held.
        """
        which = np.zeros(len(self.S), bool)
        which[dofs[dofs >= 0]] = True
        self.activate(which)
        place = np.append(np.where(self.active, np.cumsum(self.active) - 1, -1), -1)
        K = self.reduced.copy()
        add_dense_blocks(D, N, place[dofs], K)
        return K

    def solver(self, K: Array, symmetric: bool = False) -> Callable[[Array], Array]:
        """x of (S + contact) x = b for right-hand sides b (k,) or (k, m), where K (a, a) is the stiffness of both on
        the active unknowns, not symmetric unless said so. K belongs to the solver from now on.

        Raises LinAlgError: singular or, if symmetric, not positive definite.
        """
        assert self._reduced is not None
        L, W, _ = self._reduced
        a, o = np.flatnonzero(self.active), np.flatnonzero(~self.active)
        inner = _cholesky(K) if symmetric and a.size else _lu(K)

        def solve(b: Array) -> Array:
            x = np.empty_like(b)
            y = solve_triangular(L, b[o], lower=True, check_finite=False)
            x[a] = inner(b[a] - W.T @ y)
            x[o] = solve_triangular(L, y - W @ x[a], lower=True, trans=1, check_finite=False)
            return x

        return solve
