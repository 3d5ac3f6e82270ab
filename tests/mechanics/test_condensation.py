"""The bulk condensed to the contact says what the whole says, wherever the whole is stable with the contact."""

import numpy as np
import pytest
from helpers.small import block, full, hexes, standing, stiff

from tacgen.mechanics import condensation
from tacgen.mechanics.condensation import DAMPING_FACTOR, Condensation, Schur, more
from tacgen.mechanics.linear_solvers import NotPositiveDefinite

Array = np.ndarray


class Bulk:
    """A bonded block condensed to some of its upper face, two of whose nodes are held in part, and its matrix."""

    def __init__(self) -> None:
        points, cells = block(4, 0.1)
        self.free, self.top = standing(points), cells[:, 4:][(points[cells[:, 4:], 2] == 1).all(1)]
        self.free[self.top[5, 0], 1] = self.free[self.top[6, 1]] = False
        self.pattern, self.data = stiff(points, cells, self.free)
        self.rest = self.data.copy()
        self.condensed = Condensation(self.pattern, lambda: self.rest)
        self.condensed.cover(self.top[[5, 6, 9]])
        self.near = np.isin(self.pattern.free // 3, self.top[[5, 6, 9]])  # among the free dofs

    @property
    def K(self) -> Array:
        return full(self.pattern, self.data)

    def shift(self, which: Array, by: float) -> None:
        """Add to the diagonal of some free dofs (m,) bool."""
        self.data[self.pattern.indptr[:-1][which]] += by

    def schur(self) -> Array:
        return complement(self.K, self.near)


def complement(K: Array, c: Array) -> Array:
    """The Schur complement on some unknowns (m,) bool by dense matrices."""
    return np.asarray(K[np.ix_(c, c)] - K[np.ix_(c, ~c)] @ np.linalg.solve(K[np.ix_(~c, ~c)], K[np.ix_(~c, c)]))


@pytest.fixture
def bulk() -> Bulk:
    return Bulk()


def test_it_is_the_schur_complement_where_some_condensed_nodes_have_no_others_beside_them() -> None:
    """A plate one cell thick, bonded below; condensed to the middle and, beyond nodes that are not, to a corner."""
    points, cells = hexes(np.arange(9.0), np.arange(9.0), [0.0, 1.0])
    pat, data = stiff(points, cells, standing(points))
    K = full(pat, data)
    for where in (slice(2, 7), slice(0, 5), slice(4, 9)):
        on = np.arange(len(points)).reshape(9, 9, 2)[where, where, 1]
        condensed = Condensation(pat, lambda: data)
        condensed.cover(on.ravel()[None])
        condensed.factor(data)
        exact = complement(K, np.isin(pat.free // 3, on))
        assert condensed.schur.undamped == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize(("softer", "every"), [(0.0, 1), (0.02, 1), (0.05, 1), (0.3, 3)])
def test_it_is_the_schur_complement_even_of_what_contact_alone_keeps_stable(
    bulk: Bulk, softer: float, every: int
) -> None:
    """Of a matrix with less on the diagonal of some condensed dofs, from a little to far below 0."""
    assert 0.06 < np.diag(bulk.K)[bulk.near].min() < 0.09
    bulk.shift(bulk.near & (np.arange(len(bulk.near)) % every == 0), -softer)
    stable = np.linalg.eigvalsh(bulk.K)[0] > 0
    assert stable == (softer == 0)
    kept = bulk.data.copy()
    assert not bulk.condensed.usable
    bulk.condensed.factor(bulk.data)
    assert bulk.condensed.usable
    assert bulk.condensed.factored == 1
    assert (bulk.data == kept).all()
    S = bulk.condensed.schur.S
    expected = bulk.schur()
    assert pytest.approx(expected, abs=1e-11 * np.abs(expected).max()) == S
    assert (np.linalg.eigvalsh(S)[0] > 0) == stable
    assert (bulk.condensed.schur.undamped == S).all()


def test_what_is_unstable_away_from_the_contact_is_reported(bulk: Bulk) -> None:
    bulk.condensed.factor(bulk.data)
    bulk.shift(~bulk.near, -0.05)
    bulk.shift(bulk.near, 100.0)
    with pytest.raises(NotPositiveDefinite):
        bulk.condensed.factor(bulk.data)
    assert not bulk.condensed.usable
    bulk.shift(~bulk.near, 0.05)
    bulk.shift(bulk.near, -100.0)
    bulk.condensed.factor(bulk.data)
    assert bulk.condensed.usable
    assert pytest.approx(bulk.schur(), abs=1e-10) == bulk.condensed.schur.S


@pytest.mark.parametrize("softer", [0.0, 0.05])
def test_a_push_at_the_contact_moves_everything_as_the_whole_equations_do(bulk: Bulk, softer: float) -> None:
    """K p = -g + push, also where K is not positive."""
    rng = np.random.default_rng(1)
    bulk.shift(bulk.near, -softer)
    bulk.condensed.factor(bulk.data)
    g = rng.normal(size=bulk.free.shape)  # of held dofs too, where it says nothing
    push = rng.normal(size=bulk.condensed.size)
    y = bulk.condensed.forward(g)
    u = np.linalg.solve(bulk.condensed.schur.S, push - bulk.condensed.load(y))
    p = bulk.condensed.expand(u, y)
    assert p.shape == bulk.free.shape
    assert not p[~bulk.free].any()
    expected = -g.ravel()[bulk.pattern.free]
    expected[bulk.near] += push
    found = p.ravel()[bulk.pattern.free]
    assert bulk.K @ found == pytest.approx(expected, abs=1e-9 * np.abs(found).max())
    assert found[bulk.near] == pytest.approx(u)
    # what is left of a gradient there is what holds those dofs still
    still = bulk.condensed.expand(0 * u, y).ravel()[bulk.pattern.free]
    assert not still[bulk.near].any()
    missing = bulk.K @ still + g.ravel()[bulk.pattern.free]
    assert missing[~bulk.near] == pytest.approx(np.zeros((~bulk.near).sum()), abs=1e-9)
    assert missing[bulk.near] == pytest.approx(bulk.condensed.load(y))


def stiffness(size: int = 12, seed: int = 0) -> Array:
    """A positive definite matrix, eigenvalues from 1 to 5."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(size, size)))
    return np.asarray(q @ np.diag(np.linspace(1, 5, size)) @ q.T)


REST = stiffness(seed=5)  # what damping multiplies


def schur_of(S: Array, active: Array | None = None) -> Schur:
    made = Schur(S, lambda: REST)
    if active is not None:
        made.activate(active)
    return made


def solved(schur: Schur, added: Array, b: Array, symmetric: bool) -> Array:
    """With `added` on the active unknowns."""
    return schur.solver(schur.reduced + added, symmetric)(b)


def with_added(S: Array, some: Array, added: Array) -> Array:
    """S with `added` on some unknowns (m,) bool."""
    whole = S.copy()
    whole[np.ix_(some, some)] += added
    return whole


@pytest.mark.parametrize("symmetric", [False, True])
def test_while_contact_acts_on_more_and_more_the_answer_is_the_dense_one(symmetric: bool) -> None:
    rng, S, acted = np.random.default_rng(0), stiffness(), np.zeros(12, bool)
    schur, b = schur_of(S.copy()), rng.normal(size=12)
    for which in ([], [3], [3, 8], [8], [1, 2, 11], range(12)):
        now = np.isin(np.arange(12), list(which))
        schur.activate(now)
        acted |= now
        assert (schur.active == acted).all()
        added = rng.normal(size=(acted.sum(), acted.sum()))
        added = added @ added.T if symmetric else 0.3 * added
        exact = np.linalg.solve(with_added(S, acted, added), b)
        assert solved(schur, added, b, symmetric) == pytest.approx(exact, abs=1e-10)
        alone = np.linalg.inv(np.linalg.inv(S)[np.ix_(acted, acted)])
        assert schur.reduced == pytest.approx(alone, abs=1e-10)
    assert (schur.S == S).all()
    assert schur.damping == 0


def test_an_indefinite_symmetric_sum_is_reported_and_solved_as_it_is_otherwise() -> None:
    S, b, some, added = stiffness(), np.random.default_rng(3).normal(size=12), np.arange(12) < 5, -4 * np.eye(5)
    schur, whole = schur_of(S, some), with_added(S, some, added)
    assert np.linalg.eigvalsh(whole)[0] < -0.1
    assert solved(schur, added, b, False) == pytest.approx(np.linalg.solve(whole, b), abs=1e-10)
    with pytest.raises(np.linalg.LinAlgError):
        solved(schur, added, b, True)
    with pytest.raises(np.linalg.LinAlgError):  # singular
        solved(schur, -schur.reduced, b, False)


def test_damping_adds_to_the_stiffness_at_rest_and_shortens_the_step() -> None:
    S, b = stiffness(), np.ones(12)
    lengths = []
    for damping in (0.0, 1.0, 100.0):
        schur = schur_of(S).damped(damping)
        assert schur.damping == damping
        assert (schur.undamped == S).all()
        schur.activate(np.arange(12) < 3)
        assert pytest.approx(S + damping * REST) == schur.S
        assert schur.times(b) == pytest.approx(schur.S @ b)
        x = solved(schur, np.zeros((3, 3)), b, True)
        assert x == pytest.approx(np.linalg.solve(S + damping * REST, b))
        lengths.append(float(np.linalg.norm(x)))
    assert lengths[0] > 1.2 * lengths[1] > 10 * lengths[2]
    assert 0 < more(0.0) < more(more(0.0))


def test_the_schur_complement_at_rest_is_computed_once_and_disturbs_nothing(bulk: Bulk) -> None:
    rest = bulk.schur()
    bulk.shift(bulk.near, 0.3)
    bulk.condensed.factor(bulk.data)
    y = bulk.condensed.forward(np.ones(bulk.free.shape))
    exact = bulk.schur()
    for damping in (0.5, 2.0):
        assert pytest.approx(exact + damping * rest, abs=1e-10) == bulk.condensed.schur.damped(damping).S
    assert bulk.condensed.factored == 2
    assert (bulk.condensed.forward(np.ones(bulk.free.shape)) == y).all()
    bulk.condensed.cover(bulk.top[[0, 15]])
    assert not bulk.condensed.usable
    bulk.near = np.isin(bulk.pattern.free // 3, bulk.top[[0, 15]])
    bulk.condensed.factor(bulk.data)
    exact = bulk.schur()
    bulk.data = bulk.rest
    assert pytest.approx(exact + 3 * bulk.schur(), abs=1e-10) == bulk.condensed.schur.damped(3.0).S


def test_what_is_eliminated_is_damped_until_it_is_stable_by_itself() -> None:
    """Those that contact acts on need not be: it may keep them."""
    S = stiffness()
    S[:3, :3] -= 9 * np.eye(3)  # the first ones are unstable
    b, added = np.random.default_rng(2).normal(size=12), 20 * np.eye(3)
    first, last = np.arange(12) < 3, np.arange(12) >= 9
    kept, damped = schur_of(S, first), schur_of(S, last)
    assert kept.damping == 0
    assert solved(kept, added, b, True) == pytest.approx(np.linalg.solve(with_added(S, first, added), b), abs=1e-10)
    part = np.ix_(range(9), range(9))
    before = S + damped.damping / DAMPING_FACTOR * REST
    assert np.linalg.eigvalsh(before[part])[0] < 0 < np.linalg.eigvalsh(damped.S[part])[0]
    assert pytest.approx(S + damped.damping * REST) == damped.S
    assert (damped.undamped == S).all()
    exact = np.linalg.solve(with_added(damped.S, last, added), b)
    assert solved(damped, added, b, True) == pytest.approx(exact, abs=1e-10)


def test_facets_add_their_stiffness_once_and_what_a_solver_uses_up_is_its_own() -> None:
    """Two solvers in turn, of more unknowns than a block of the copied triangle has."""
    rng, size = np.random.default_rng(4), 150
    S, b = stiffness(size), rng.normal(size=size)
    dofs = rng.permutation(size)[:120].reshape(10, 4, 3)
    dofs[2, 1, 0] = -1  # held
    N, D = np.full((1, 4), 0.25), rng.normal(size=(10, 1, 3, 3))
    whole = np.zeros((size + 1,) * 2)
    for own, tangent in zip(dofs, D[:, 0], strict=True):
        whole[np.ix_(own.ravel(), own.ravel())] += np.tile(tangent / 16, (4, 4))
    exact = np.linalg.solve(S + whole[:-1, :-1], b)
    schur = schur_of(S.copy())
    for _ in range(2):
        assert schur.solver(schur.stiffness(D, N, dofs))(b) == pytest.approx(exact, abs=1e-9)
    assert (schur.S == S).all()
    assert (schur.reduced == schur.reduced.T).all()


@pytest.mark.parametrize("columns", [(), (3,)])
def test_large_ones_are_solved_to_double_precision(columns: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """With eigenvalues of S from 1 to 5 and contact a thousand times stiffer; from single precision's factors alone the
    error would be 1e-5."""
    rng, size = np.random.default_rng(6), condensation.MIN_SINGLE_PRECISION_DOFS + 20
    S, b = stiffness(size), rng.normal(size=(size, *columns))
    added = np.diag(np.exp(rng.uniform(0, np.log(5e3), size))) + rng.normal(size=(size, size)) / 40
    exact = np.linalg.solve(S + added, b)

    def error() -> float:
        found = solved(schur_of(S, np.ones(size, bool)), added, b, False)
        return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))

    assert error() < 1e-12
    monkeypatch.setattr(condensation, "REFINED_SOLUTION_TOL", 1.0)
    monkeypatch.setattr(condensation, "dgetrf", None)  # not needed
    assert error() < 1e-10  # refined once


def test_a_large_one_too_ill_conditioned_for_single_precision_is_solved_in_double() -> None:
    rng, size = np.random.default_rng(7), condensation.MIN_SINGLE_PRECISION_DOFS
    S = stiffness(size)
    q, _ = np.linalg.qr(rng.normal(size=(size, size)))
    added = q @ np.diag(np.geomspace(1e-10, 1, size)) @ q.T - S
    K = S + added
    b = K @ rng.normal(size=size)
    solve = schur_of(S, np.ones(size, bool)).solver(K.copy())
    found = [solve(b), solve(b)]
    assert (found[0] == found[1]).all()
    assert K @ found[0] == pytest.approx(b, abs=1e-13)
    assert found[0] == pytest.approx(np.linalg.solve(K, b), rel=1e-3)
