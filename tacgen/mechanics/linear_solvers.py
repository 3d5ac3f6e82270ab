"""Direct solvers for the symmetric positive definite systems of Newton's method, behind one small interface.

Each takes the upper triangle in CSR with a pattern that never changes: the ordering and symbolic factorisation are done
once, `factor` then takes new numbers. `best()` picks the fastest one installed; SuperLU, part of SciPy, always works.
"""

import ctypes
import importlib.util
from collections.abc import Callable
from functools import cache, cached_property
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from tacgen.fem import assembly
from tacgen.fem.assembly import Pattern
from tacgen.mechanics import blas_kernels

Array = np.ndarray


class NotPositiveDefinite(ArithmeticError):
    """The matrix has no Cholesky factor."""


class Solver(Protocol):
    """A direct solver: factorise once, solve many times."""

    name: str
    factored: int  # number of factorisations so far

    def factor(self, data: Array) -> None:
        """Raises NotPositiveDefinite, where the method can tell."""

    def solve(self, b: Array) -> Array: ...


def dissection(pattern: Pattern) -> Array:
    """Fill-reducing elimination order of the free dofs by METIS nested dissection of the nodes."""
    import pymetis

    n = pattern.nodes
    i, j = pattern.pairs // n, pattern.pairs % n
    off = i != j
    starts = np.searchsorted(i[off], np.arange(n + 1))
    order, _ = pymetis.nested_dissection(pymetis.CSRAdjacency(starts, j[off]))
    number = np.full(3 * n, -1)
    number[pattern.free] = np.arange(pattern.size)
    dofs = number.reshape(n, 3)[np.asarray(order)].ravel()
    return np.asarray(dofs[dofs >= 0])


class Cholmod:
    """CHOLMOD's supernodal Cholesky through cvxopt, ordered by METIS."""

    name = "cholmod"
    factored = 0

    def __init__(self, pattern: Pattern, order: Array | None = None, postorder: bool = True) -> None:
        """With `postorder`, independent parts of `order` are eliminated in the order that makes larger supernodes."""
        cvxopt = blas_kernels.cvxopt()
        cholmod = cvxopt.cholmod
        cholmod.options["supernodal"], cholmod.options["nmethods"] = 2, 1  # supernodal, in the given order alone
        n = pattern.size
        # the upper triangle by rows is the lower triangle by columns, which is what cvxopt keeps
        columns = np.repeat(np.arange(n), np.diff(pattern.indptr))
        as_list = cvxopt.matrix(pattern.indices.astype(np.int64)), cvxopt.matrix(columns)
        self._cvxopt, self._cholmod = cvxopt, cholmod
        self._A = cvxopt.spmatrix(1.0, *as_list, (n, n))
        self._pattern, self._order, self._postorder = pattern, order, postorder

    @cached_property
    def _F(self) -> Any:
        """The factor, at first symbolic only; made when it is needed, as the analysis takes as long as a solve."""
        order = dissection(self._pattern) if self._order is None else self._order
        self._cholmod.options["postorder"] = self._postorder
        return self._cholmod.symbolic(self._A, p=self._cvxopt.matrix(order.astype(np.int64)))

    def factor(self, data: Array) -> None:
        self.factored += 1
        self._A.V = self._cvxopt.matrix(data)
        try:
            self._cholmod.numeric(self._A, self._F)
        except ArithmeticError as e:
            raise NotPositiveDefinite from e

    def solve(self, b: Array) -> Array:
        x = self._cvxopt.matrix(b)
        self._cholmod.solve(self._F, x)
        return np.asarray(x).ravel()

    def forward(self, b: Array) -> Array:
        """L^-1 P b, in the order of elimination, of b (n,) or (n, k)."""
        return self._triangular(CHOLMOD_L, b[self.order])

    def backward(self, y: Array) -> Array:
        """P^T L^-T y."""
        x = np.empty_like(y)
        x[self.order] = self._triangular(CHOLMOD_LT, y)
        return x

    def _triangular(self, system: int, b: Array) -> Array:
        """All columns of b at once: cvxopt would solve for one after the other, and read the factor for each."""
        library, common = _library()
        columns = np.asfortranarray(b.reshape(len(b), -1))
        B = _Dense(*columns.shape, columns.size, len(b), columns.ctypes.data, 0, CHOLMOD_REAL, CHOLMOD_DOUBLE)
        X = library.cholmod_l_solve(system, ctypes.c_void_p(_address(self._F)), ctypes.byref(B), common)
        if not X:
            raise MemoryError
        out = _view(X.contents.x, columns.size, ctypes.c_double).reshape(columns.shape, order="F").copy()
        library.cholmod_l_free_dense(ctypes.byref(X), common)
        return out.reshape(b.shape)

    @cached_property
    def order(self) -> Array:
        """The dofs (n,) in the order of elimination: the given one, postordered unless `postorder` is False."""
        F = _Factor.of(self._F)
        return _view(F.Perm, F.n, ctypes.c_int64).copy()

    def trailing(self, k: int) -> Array:
        """The last k rows and columns of L (k, k)."""
        F = _Factor.of(self._F)
        first, start, at = (_view(address, F.nsuper + 1, ctypes.c_int64) for address in (F.super, F.pi, F.px))
        numbers, values = _view(F.s, F.ssize, ctypes.c_int64), _view(F.x, F.xsize, ctypes.c_double)
        transposed = np.zeros((k, k))
        for s in range(int(np.searchsorted(first, F.n - k, side="right")) - 1, F.nsuper):  # columns of equal pattern
            rows = numbers[start[s] : start[s + 1]] - (F.n - k)
            width, before = first[s + 1] - first[s], max(0, F.n - k - first[s])
            block = values[at[s] : at[s] + width * len(rows)].reshape(width, len(rows))[before:, before:]  # L^T
            own, others = slice(rows[before], rows[width - 1] + 1), rows[width:]
            transposed[own, own] = block[:, : width - before]
            transposed[own, others] = block[:, width - before :]
        for column in range(1, k):
            transposed[column, :column] = 0  # undefined in the factor
        return transposed.T


CHOLMOD_L, CHOLMOD_LT = 4, 5  # L x = b and L^T x = b, by CHOLMOD's numbers for them


class _Factor(ctypes.Structure):
    """The head of CHOLMOD's factor object, as its guide has documented it since version 2: cvxopt keeps a pointer to it
    and gives out none of the factor without destroying it."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in ("n", "minor", "Perm", "ColCount", "IPerm", "nzmax", "p", "i", "x", "z", "nz", "next", "prev",
                     "nsuper", "ssize", "xsize", "maxcsize", "maxesize", "super", "pi", "px", "s")
    ]  # fmt: skip

    @classmethod
    def of(cls, capsule: object) -> Any:
        return cls.from_address(_address(capsule))


class _Dense(ctypes.Structure):
    """CHOLMOD's dense matrix of doubles, column by column; `x` and `d` are its numbers and its leading dimension."""

    _fields_ = [
        *((name, ctypes.c_size_t) for name in ("nrow", "ncol", "nzmax", "d", "x", "z")),
        *((name, ctypes.c_int) for name in ("xtype", "dtype")),
    ]


CHOLMOD_REAL, CHOLMOD_DOUBLE = 1, 0  # xtype and dtype
CHOLMOD_COMMON_BYTES = 1 << 16  # [bytes], more than CHOLMOD's settings take in any version


@cache
def _library() -> tuple[ctypes.CDLL, Any]:
    """CHOLMOD as cvxopt has loaded it, and settings of our own."""
    library, common = (
        ctypes.CDLL(blas_kernels.cvxopt().cholmod.__file__),
        ctypes.create_string_buffer(CHOLMOD_COMMON_BYTES),
    )
    library.cholmod_l_solve.restype = ctypes.POINTER(_Dense)
    library.cholmod_l_start(common)
    return library, common


def _address(capsule: object) -> int:
    get = ctypes.pythonapi.PyCapsule_GetPointer
    get.restype, get.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return int(get(capsule, b"CHOLMOD FACTOR D L"))  # double precision, 64-bit numbers


def _view(address: int, size: int, kind: Any) -> Array:
    return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(kind)), (size,))


@cache
def readable() -> bool:
    """Whether CHOLMOD is installed, can be called and lays its factors out as _Factor says."""
    if "cholmod" not in available():
        return False
    A = np.array([[4.0, 1, 2], [1, 5, 3], [2, 3, 6]])
    solver = Cholmod(assembly.pattern([np.zeros((1, 1), int)], np.ones((1, 3), bool)), np.array([2, 0, 1]))
    solver.factor(A[np.triu_indices(3)])
    try:
        order, L, inverse = solver.order, solver.trailing(3), solver.backward(solver.forward(np.eye(3)))
    except (ValueError, AttributeError):  # another kind of factor, or a CHOLMOD inside cvxopt
        return False
    return (
        sorted(order) == [0, 1, 2]
        and np.allclose(L @ L.T, A[np.ix_(order, order)])
        and np.allclose(A @ inverse, np.eye(3))
    )


class SuperLU:
    """SciPy's SuperLU on the whole symmetric matrix; it does not detect an indefinite one."""

    name = "superlu"
    factored = 0

    def __init__(self, pattern: Pattern) -> None:
        n = pattern.size
        upper = sp.csr_matrix((np.arange(1, len(pattern.indices) + 1), pattern.indices, pattern.indptr), shape=(n, n))
        full = (upper + sp.triu(upper, 1).T).tocsc()
        self._slots = full.data - 1
        self._A = sp.csc_matrix((np.ones(full.nnz), full.indices, full.indptr), shape=(n, n))

    def factor(self, data: Array) -> None:
        self.factored += 1
        from scipy.sparse.linalg import splu

        self._A.data[:] = data[self._slots]
        try:
            self._lu = splu(self._A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError as e:  # exactly singular
            raise NotPositiveDefinite from e

    def solve(self, b: Array) -> Array:
        return np.asarray(self._lu.solve(b))


# fastest first, with the packages each needs
LINEAR_SOLVERS: dict[str, tuple[Callable[[Pattern], Solver], tuple[str, ...]]] = {
    "cholmod": (Cholmod, ("cvxopt", "pymetis")),
    "superlu": (SuperLU, ()),
}


def available() -> list[str]:
    """Names of the solvers that can be used here, fastest first."""
    return [name for name, (_, needs) in LINEAR_SOLVERS.items() if all(importlib.util.find_spec(m) for m in needs)]


def best(pattern: Pattern) -> Solver:
    """The fastest installed solver, prepared for this pattern."""
    return LINEAR_SOLVERS[available()[0]][0](pattern)
