"""The linear solvers agree, say when there is no Cholesky factor, and a kept factor answers like a fresh one."""

import numpy as np
import pytest

from tacgen.fem.assembly import Pattern, pattern
from tacgen.fem.elements import hexes
from tacgen.fem.linear import SOLVERS, Cholmod, NotPositiveDefinite, Stale, available, best, dissection
from tacgen.fem.materials import NeoHooke
from tacgen.fem.potentials import Elastic

from .small import block, full

Array = np.ndarray


def system(n: int = 4) -> tuple[Pattern, Array, Array, Array]:
    """Pattern and stiffness of a bonded block, its dense matrix, and a right-hand side."""
    points, cells = block(n, 0.2)
    free = np.ones((len(points), 3), bool)
    free[points[:, 2] == 0] = False
    pat = pattern([cells], free)
    data = np.zeros(len(pat.indices))
    Elastic.on(pat, hexes(points, cells), NeoHooke(0.05, 1.0)).add_hessian(points, data, 0)
    return pat, data, full(pat, data), np.random.default_rng(0).normal(size=pat.size)


def test_the_best_one_is_installed_and_one_always_is() -> None:
    assert available()[-1] == "superlu"
    assert "cholmod" in available()  # a dependency
    assert best(system(1)[0]).name == available()[0]
    assert set(available()) <= set(SOLVERS)


@pytest.mark.parametrize("name", available())
def test_every_solver_solves(name: str) -> None:
    pat, data, A, b = system()
    assert np.linalg.eigvalsh(A).min() > 0
    solver = SOLVERS[name][0](pat)
    assert solver.name == name
    for scale in (1.0, 3.0):  # new numbers on the old pattern
        solver.factor(scale * data)
        x = solver.solve(b)
        assert np.abs(x).max() > 1
        assert scale * A @ x == pytest.approx(b, abs=1e-9)
        assert solver.solve(2 * b) == pytest.approx(2 * x, rel=1e-9)


def test_cholmod_tells_an_indefinite_matrix_and_goes_on_after_it() -> None:
    pat, data, A, b = system()
    solver = Cholmod(pat)
    broken = data.copy()
    broken[pat.indptr[7]] *= -1
    with pytest.raises(NotPositiveDefinite):
        solver.factor(broken)
    solver.factor(data)
    assert A @ solver.solve(b) == pytest.approx(b, abs=1e-9)


def test_superlu_tells_a_singular_matrix() -> None:
    pat, data, _, _ = system(1)
    with pytest.raises(NotPositiveDefinite):
        SOLVERS["superlu"][0](pat).factor(0 * data)


def test_dissection_is_a_permutation_that_saves_fill() -> None:
    pat, _, A, _ = system(7)
    order = dissection(pat)
    assert sorted(order) == list(range(pat.size))

    def fill(p: Array) -> int:
        return int((np.abs(np.linalg.cholesky(A[np.ix_(p, p)])) > 1e-14).sum())

    rows = np.arange(pat.size)
    assert fill(order) < 0.9 * fill(rows)
    assert fill(order) < 0.7 * fill(np.random.default_rng(0).permutation(rows))


def error(A: Array, x: Array, b: Array) -> float:
    """In the energy norm, as a part of the answer's."""
    exact = np.linalg.solve(A, b)
    return float(np.sqrt((x - exact) @ A @ (x - exact) / (exact @ A @ exact)))


def test_a_kept_factor_answers_like_a_fresh_one() -> None:
    pat, data, A, b = system()
    solver = Stale(Cholmod(pat), pat, rtol=1e-3, most=12)
    solver.factor(data)
    assert solver.solve(b) == pytest.approx(np.linalg.solve(A, b), rel=1e-8)
    assert (solver.factored, solver.stepped) == (1, 0)
    spread = np.random.default_rng(1).uniform(0, 0.05, pat.size)
    changed = data.copy()
    changed[pat.indptr[:-1]] *= 1 + spread
    near = A + np.diag(np.diag(A) * spread)
    solver.factor(changed)
    x = solver.solve(b)
    assert solver.factored == 1  # the old factor did
    assert 2 <= solver.stepped <= 12
    assert error(near, np.linalg.solve(A, b), b) > 0.1  # which alone is far off
    assert error(near, x, b) < 3e-3


def test_a_useless_factor_is_renewed() -> None:
    pat, data, A, b = system()
    solver = Stale(Cholmod(pat), pat, rtol=1e-3, most=3)
    solver.factor(data)
    solver.solve(b)
    spread = 10 ** np.random.default_rng(1).uniform(0, 4, pat.size)
    far = data.copy()
    far[pat.indptr[:-1]] *= spread
    solver.factor(far)
    assert error(A + np.diag(np.diag(A) * (spread - 1)), solver.solve(b), b) < 1e-9
    assert solver.factored == 2
    solver.factor(1.01 * data)  # and the new one is now the kept one, useless for the first
    assert error(1.01 * A, solver.solve(b), b) < 3e-3


def test_an_indefinite_matrix_is_told_through_a_kept_factor() -> None:
    pat, data, A, b = system()
    solver = Stale(Cholmod(pat), pat, rtol=1e-3, most=12)
    solver.factor(data)
    solver.solve(b)
    solver.factor(-data)
    with pytest.raises(NotPositiveDefinite):
        solver.solve(b)
    solver.factor(data)  # the failed factor is not used again
    assert A @ solver.solve(b) == pytest.approx(b, abs=1e-9)


def test_the_choice_follows_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert available() == ["superlu"]
    pat, data, A, b = system(2)
    solver = best(pat)
    solver.factor(data)
    assert A @ solver.solve(b) == pytest.approx(b, abs=1e-9)
