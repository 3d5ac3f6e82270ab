"""Newton's method whose steps take contact and friction to their end, on a bulk condensed to the nodes they act on.

What changes fast from one iteration to the next, where contact begins and how hard it is there, is felt by the face
alone; the bulk hardly changes. So the bulk is taken for a quadratic, and its minimum with the true contact and friction
is found, what is lagged in them included, on the few hundred unknowns near the contact (static condensation, Guyan
1965). The gradient of the bulk is exact at the answer, which is that of `newton.minimise`; on the way it is taken with
the pressure that steps were meant to give (fem/meant), or a stiffness of some time ago would lead astray where volume
hardly changes.

The quadratic is the stiffness factorised some time ago, mended by what gradients have told since (BFGS; limited memory,
Nocedal 1980), and factorised anew where it no longer says how they change. With the factor L of the stiffness, and the
contact's unknowns eliminated last, all of that is cheap in q = L^T p: the old stiffness is 1 there, and the contact's
part of it the end of the vector.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_triangular

from tacgen.fem.assembly import Pattern, pattern
from tacgen.fem.last import Last
from tacgen.fem.linear import Cholmod, NotPositiveDefinite, dissection
from tacgen.fem.newton import ROUNDING, Solution, Status, Step, backtrack, minimise
from tacgen.fem.potentials import LAST, Elastic, Potential, Total

Array = np.ndarray
MOST = 2000  # unknowns of the condensed problem: beyond, its dense factors cost more than they save
PAIRS = 10  # of steps and changes of the gradient that are remembered
LEFT = 2.0  # steps that may be left at the present rate: a new factor costs as much as some three
KNOWN = 0.3  # part of a step by which the quadratic may be wrong: more tells of that way, not of the stiffness
LITTLE = 15.0  # times `near`: a first step of no more leads where the pressure is much as it was
SAG = 0.3  # of the curvature along a step: how far above the quadratic the bulk's energy may end
PART = 0.2  # of xtol: the next step may be that long
LOOSE = 0.2  # of the error expected of the bulk is what contact and friction may be off by on the way,
LOOSEST = 50.0  # but no more than this many times what they may be in the end
STEPS = 25  # of those that converge few take more than ten


class Condensed:
    """A bulk's factorised stiffness, with the nodes near the contact eliminated last; also the linear.Solver of the
    problem that is left there, whose Pattern is `pattern`."""

    name = "condensed"

    def __init__(self, whole: Pattern) -> None:
        self.whole, self._order = whole, dissection(whole)
        entries = np.zeros(len(whole.indices)), whole.indices, whole.indptr
        self._upper = sp.csr_matrix(entries, shape=(whole.size, whole.size))  # of what was factorised
        self._free = np.zeros((whole.nodes, 3), bool)
        self._free.ravel()[whole.free] = True
        self.nodes = np.zeros(whole.nodes, bool)
        self.error, self.length = 0.0, np.inf  # of the first step of the last solution [mm]
        self.usable = False
        self.answer: tuple[Array, Array] | None = None  # the last x (n, 3) and its gradient's y
        self._shy = False  # of exact stiffnesses far from an answer: one was not definite
        self.factored = self.stepped = 0

    def cover(self, facets: Array) -> None:
        """Condense to the nodes of these facets (f, a) from now on."""
        self.nodes[:] = False
        self.nodes[facets] = True
        self.pattern = pattern([facets], self._free & self.nodes[:, None])
        self.size = self.pattern.size
        last = self.nodes[self.whole.free // 3][self._order]
        self._factor = Cholmod(self.whole, np.concatenate([self._order[~last], self._order[last]]))
        self._rows = np.argsort(self._factor.order[-self.size :])  # the factor has an order of its own
        self._columns = np.repeat(np.arange(self.size), np.diff(self.pattern.indptr))
        self._acted = np.zeros(self.size, bool)  # of these unknowns, which contact has acted on so far
        self.usable, self.answer = False, None

    def renew(self, bulk: Potential, x: Array, far: bool, little: bool = False) -> None:
        """Take the stiffness at x (n, 3): exact, or projected where that is not definite, and `far` from an answer
        wherever one was not before.

        What a long step meant the pressure to be is off by several shear moduli under the rim of a ball that is pressed
        into a soft gel with a skin, and the stiffness indefinite by it. A projected one then leaves .4 of the error in
        each step; where `little` changes since the last answer, one with the pressure there is definite and leaves .1.
        With projected ones for all that is far the default Mini takes 23 factors for 15 frames, not 15.
        """
        self.usable, self.answer = False, None
        ways = (1, 2) if far and self._shy else (0, 1, 2)
        for way in (LAST, *ways) if little and self._shy else ways:
            data = np.zeros(len(self.whole.indices))
            bulk.add_hessian(x, data, way)
            try:
                self._factor.factor(data)
                break
            except NotPositiveDefinite:
                self._shy |= far
                if way == 2:
                    raise
        self.factored += 1
        self._upper.data = data
        self._L = self._factor.trailing(self.size)[self._rows]
        self._first = (self._L @ self._L.T).T  # by columns, as LAPACK wants it
        self._pairs: deque[tuple[Array, Array]] = deque(maxlen=PAIRS)
        self._update()
        self.usable = True

    def learn(self, q: Array, change: Array) -> float:
        """Along q the gradient changed by L `change`: by which part the quadratic was wrong, which then is right."""
        wrong = np.linalg.norm(change - q - (self._D * (self._W @ q)) @ self._W) / np.linalg.norm(q)
        if wrong <= KNOWN and q @ change > 0.1 * (q @ q):
            self._pairs.append((q, change))
            self._update()
        return float(wrong)

    def carry(self, x: Array, y: Array) -> None:
        """Learn what the way from the last answer to x (n, 3), where the gradient is L `y`, tells; after a new factor
        there is none."""
        if self.answer is None:
            return
        (last, before), U = self.answer, self._upper
        p = (x - last).ravel()[self.whole.free]
        q = self._factor.forward(U @ p + U.T @ p - U.diagonal() * p)
        if q.any():
            self.learn(q, y - before)

    def curvature(self, q: Array) -> float:
        """Of the quadratic along q: q . B q."""
        return float(q @ q + self._D @ (self._W @ q) ** 2)

    def _update(self) -> None:
        """The quadratic in q, B = 1 + W^T D W, and what is left of it on the contact's unknowns."""
        n = self.whole.size
        W, D = np.zeros((0, n)), np.zeros(0)
        for q, change in self._pairs:
            Bq = q + (D * (W @ q)) @ W
            W = np.vstack([W, Bq, change])
            D = np.concatenate([D, [-1 / (q @ Bq), 1 / (q @ change)]])
        self._D, self._W, self._Wf, self._Wc = D, W, W[:, : n - self.size], W[:, n - self.size :]
        self._T = np.linalg.inv(np.diag(1 / D) + self._Wf @ self._Wf.T)
        added = self._L @ self._Wc.T
        self.stiffness = self._first + added @ self._T @ added.T if len(D) else self._first
        self._split: _Split | None = None

    def begin(self, g: Array) -> Array:
        """y = L^-1 of a gradient (n, 3)."""
        return self._factor.forward(g.ravel()[self.whole.free])

    def force(self, y: Array) -> Array:
        """What is left of that gradient on the contact's unknowns (k,)."""
        f, c = y[: -self.size], y[-self.size :]
        return np.asarray(self._L @ (c - (self._T @ (self._Wf @ f)) @ self._Wc))

    def end(self, u: Array, y: Array) -> tuple[Array, Array]:
        """The step p (n, 3) that goes with that of the contact's unknowns (k,), and q = L^T p."""
        f, c = y[: -self.size], u @ self._L
        t = self._T @ (self._Wc @ c - self._Wf @ f)
        q = np.concatenate([-f - t @ self._Wf, c])
        p = np.zeros(self._free.shape)
        p.ravel()[self.whole.free] = self._factor.backward(q)
        return p, q

    def pulled(self, data: Array, b: Array) -> Array:
        """The step p (n, 3) of the bulk, stiffened by `data` on the contact's unknowns, by forces b (k,) there."""
        self.factor(data)
        return self.end(self.solve(b), np.zeros(self.whole.size))[0]

    def factor(self, data: Array) -> None:
        felt = np.flatnonzero(data)
        rows, columns = self.pattern.indices[felt], self._columns[felt]
        acted = self._acted.copy()
        acted[rows] = acted[columns] = True
        if self._split is None or acted.sum() > self._acted.sum():
            self._acted = acted
            try:
                self._split = _Split.of(self.stiffness, acted)
            except LinAlgError as e:
                raise NotPositiveDefinite from e
        place = np.cumsum(acted) - 1
        self._K = self._split.rest.copy(order="F")
        self._K[place[rows], place[columns]] += data[felt]

    def solve(self, b: Array) -> Array:
        self.stepped += 1
        assert self._split is not None
        try:
            L = cho_factor(self._K, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError as e:
            raise NotPositiveDefinite from e
        return self._split.solve(b, lambda r: cho_solve(L, r, check_finite=False))


@dataclass(frozen=True)
class _Split:
    """A stiffness of which all is eliminated but the unknowns that contact acts on, `acted` (k,) of bool."""

    acted: Array
    L: Array  # of the others
    added: Array  # L^-1 of what couples them to those acted on
    rest: Array  # what is left on those

    @classmethod
    def of(cls, K: Array, acted: Array) -> "_Split":
        others = ~acted
        L = np.linalg.cholesky(K[np.ix_(others, others)])
        added = solve_triangular(L, K[np.ix_(others, acted)], lower=True, check_finite=False)
        return cls(acted, L, added, K[np.ix_(acted, acted)] - added.T @ added)

    def solve(self, b: Array, rest: Callable[[Array], Array]) -> Array:
        """Of the whole, by the solution of what is left."""
        x = np.empty_like(b)
        y = solve_triangular(self.L, b[~self.acted], lower=True, check_finite=False)
        x[self.acted] = u = rest(b[self.acted] - y @ self.added)
        x[~self.acted] = solve_triangular(self.L, y - self.added @ u, lower=True, trans=1, check_finite=False)
        return x


@dataclass(frozen=True)
class Quadratic:
    """What stands for the bulk: u . force + u . K u / 2 of the displacements u (k,) of some dofs from `start` (n, 3).

    Its stiffness is with the solver, not in the pattern.
    """

    start: Array
    dofs: Array  # among all 3n
    stiffness: Array
    force: Array
    _last: Last = field(default_factory=Last, init=False, compare=False, repr=False)

    def value(self, x: Array) -> float:
        u, Ku = self._of(x)
        return float(u @ (Ku / 2 + self.force))

    def gradient(self, x: Array) -> Array:
        out = np.zeros(x.size)
        out[self.dofs] = self._of(x)[1] + self.force
        return out.reshape(x.shape)

    def _of(self, x: Array) -> tuple[Array, Array]:
        """u and K u, which energy and gradient both want."""
        found: tuple[Array, Array] = self._last.of(x, self._moved)
        return found

    def _moved(self, x: Array) -> tuple[Array, Array]:
        u = x.ravel()[self.dofs] - self.start.ravel()[self.dofs]
        return u, self.stiffness @ u

    def add_hessian(self, x: Array, data: Array, project: int) -> None:
        pass

    def max_step(self, x: Array, p: Array) -> float:
        return 1.0


def settle(
    bulk: Total,
    loads: Callable[[], Potential],
    x: Array,
    condensed: Condensed,
    *,
    xtol: float,
    near: float,
    refresh: Callable[[Array, float], object],
    negligible: Callable[[Array], bool],
) -> Solution:
    """Lower bulk and loads until a step would move no node by PART of xtol [mm]; out of steps, it hands on its best x.

    Args:
        loads: what acts on the condensed nodes alone, as it is since the last `refresh`.
        near: after steps longer than this [mm] the stiffness of contact is projected, that of the bulk see `renew`.
        refresh: asked to take what is lagged from positions (n, 3) unless it is off by no more than a multiple of what
            it may be; then None. Not asked after a step that was cut short.
        negligible: see `minimise`.
    """
    steps: list[Step] = []
    pair: tuple[Array, Array] | None = None
    error, length, settled = condensed.error, condensed.length, False

    def renewed(x: Array, far: bool) -> Array:
        condensed.renew(bulk, x, far, condensed.length <= LITTLE * near)
        return condensed.begin(_unbalanced(bulk, x))

    try:
        while True:
            factored, g = condensed.factored, _unbalanced(bulk, x)  # which tells the stiffness what was meant, too
            y = condensed.begin(g) if condensed.usable else renewed(x, False)
            if pair is None:
                condensed.carry(x, y)
            else:
                wrong = condensed.learn(pair[0], y - pair[1])
                error = wrong * length
                if len(steps) == 1:
                    condensed.error, condensed.length = error, length
                if settled and error <= PART * xtol:
                    condensed.answer = x, y
                    return Solution(x, Status.converged, tuple(steps))
                if error > xtol and error * wrong**LEFT > PART * xtol:
                    y = renewed(x, length > near)
            if len(steps) == STEPS:
                return Solution(x, Status.out_of_steps, tuple(steps))
            close = not steps or steps[-1].fraction == 1.0
            loose = min(max(1.0, LOOSE * error / xtol), LOOSEST)
            there, done = _contact(condensed, loads, x, y, xtol, loose, near, close, refresh, negligible)
            p, q = condensed.end((there - x).ravel()[condensed.pattern.free], y)
            length, felt = float(np.abs(p).max()), loads()
            g = bulk.gradient(x)
            slope = float(((g + felt.gradient(x)) * p).sum())
            rise = float((g * p).sum()) + (0.5 + SAG) * condensed.curvature(q) if close else None
            fraction, x, energy = go(bulk, felt, x, p, slope, rise)
            steps.append(Step(energy, length, fraction, False))
            if fraction == 0.0 and (length <= PART * xtol or condensed.factored > factored):
                return Solution(x, Status.converged if length <= PART * xtol else Status.stalled, tuple(steps))
            pair, settled = (fraction * q, y) if fraction > 0.0 else None, False
            condensed.usable &= fraction > 0.0  # what was factorised elsewhere need not lead down
            if fraction == 1.0 and length <= near:
                settled = refresh(x, 1.0) is None and length <= 10 * xtol and done
    except NotPositiveDefinite:
        condensed.usable = False
        return Solution(x, Status.nonfinite, tuple(steps))


def _unbalanced(bulk: Total, x: Array) -> Array:
    """Of elastic parts what a step is to undo, of others the gradient (n, 3)."""
    return np.asarray(sum(p.unbalanced(x) if isinstance(p, Elastic) else p.gradient(x) for p in bulk.parts))


def go(
    bulk: Potential, felt: Potential, x: Array, p: Array, slope: float, rise: float | None
) -> tuple[float, Array, float]:
    """Fraction of p that is taken from x, where it leads and the energy at x: all of it if there the bulk's is no more
    than `rise` above that at x, and the sum of both no higher; else, and for a `rise` of None, by a line search."""
    most, here = felt.max_step(x, p), bulk.value(x)
    energy = here + felt.value(x)
    if most == 1.0 and rise is not None:
        ahead = x + p
        there = bulk.value(ahead)
        if there - here <= rise and there + felt.value(ahead) <= energy + ROUNDING * abs(energy):
            return 1.0, ahead, energy
    return *backtrack(Total((bulk, felt)).value, x, p, energy, slope, most)[:2], energy


def _contact(
    condensed: Condensed,
    loads: Callable[[], Potential],
    x: Array,
    y: Array,
    xtol: float,
    loose: float,
    near: float,
    close: bool,
    refresh: Callable[[Array, float], object],
    negligible: Callable[[Array], bool],
) -> tuple[Array, bool]:
    """Where contact and friction carry the condensed nodes from x, and whether they have come to their end."""
    bulk = Quadratic(x, condensed.pattern.free, condensed.stiffness, condensed.force(y))

    def again(there: Array) -> Potential | None:
        return Total((bulk, loads())) if close and refresh(there, loose) is not None else None

    start = Total((bulk, loads()))
    found = minimise(
        start, x, condensed.pattern, condensed, xtol=loose * xtol, near=near, refresh=again, negligible=negligible
    )  # fmt: skip
    return found.x, found.status == Status.converged
