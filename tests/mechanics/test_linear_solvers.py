"""The linear solvers agree and say when there is no Cholesky factor, and CHOLMOD's can be read."""

import numpy as np
import pytest
from helpers.small import block, full, standing, stiff

from tacgen.fem.assembly import Pattern
from tacgen.mechanics.linear_solvers import (
    LINEAR_SOLVERS,
    Cholmod,
    NotPositiveDefinite,
    available,
    best,
    dissection,
    readable,
)

Array = np.ndarray


def system(n: int = 4) -> tuple[Pattern, Array, Array, Array]:
    """Pattern and stiffness of a bonded block, its dense matrix, and a right-hand side."""
    points, cells = block(n, 0.2)
    pat, data = stiff(points, cells, standing(points))
    return pat, data, full(pat, data), np.random.default_rng(0).normal(size=pat.size)


def test_the_best_one_is_installed_and_one_always_is() -> None:
    assert available()[-1] == "superlu"
    assert "cholmod" in available()  # a dependency
    assert best(system(1)[0]).name == available()[0]
    assert set(available()) <= set(LINEAR_SOLVERS)


@pytest.mark.parametrize("name", available())
def test_every_solver_solves(name: str) -> None:
    pat, data, A, b = system()
    assert np.linalg.eigvalsh(A).min() > 0
    solver = LINEAR_SOLVERS[name][0](pat)
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
        LINEAR_SOLVERS["superlu"][0](pat).factor(0 * data)


def test_dissection_is_a_permutation_that_saves_fill() -> None:
    pat, _, A, _ = system(7)
    order = dissection(pat)
    assert sorted(order) == list(range(pat.size))

    def fill(p: Array) -> int:
        return int((np.abs(np.linalg.cholesky(A[np.ix_(p, p)])) > 1e-14).sum())

    rows = np.arange(pat.size)
    assert fill(order) < 0.9 * fill(rows)
    assert fill(order) < 0.7 * fill(np.random.default_rng(0).permutation(rows))


def test_the_end_of_cholmods_factor_is_the_end_of_the_factor() -> None:
    assert readable()
    rng = np.random.default_rng(0)
    pat, data, A, b = system()
    solver = Cholmod(pat, rng.permutation(pat.size))
    solver.factor(data)
    order = solver.order
    assert sorted(order) == list(range(pat.size))
    L = np.linalg.cholesky(A[np.ix_(order, order)])
    for k in (1, 7, 100, pat.size):
        assert solver.trailing(k) == pytest.approx(L[-k:, -k:], abs=1e-12)
    for right in (b, rng.normal(size=(pat.size, 5))):
        assert L @ solver.forward(right) == pytest.approx(right[order], abs=1e-10)
        assert L.T @ solver.backward(right)[order] == pytest.approx(right, abs=1e-10)


def test_an_order_that_is_asked_for_is_kept_even_where_another_is_better() -> None:
    pat, data, _, _ = system()
    best_order = dissection(pat)
    last = best_order[3:33]  # early ones, eliminated last instead
    solver = Cholmod(pat, np.concatenate([np.delete(best_order, np.s_[3:33]), last]))
    solver.factor(data)
    assert set(solver.order[-30:]) == set(last)


def test_factors_laid_out_otherwise_are_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    readable.cache_clear()
    with monkeypatch.context() as other:
        other.setattr(Cholmod, "trailing", lambda self, k: 2 * np.eye(k))
        assert not readable()
    readable.cache_clear()
    assert readable()


def test_the_choice_follows_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert available() == ["superlu"]
    pat, data, A, b = system(2)
    solver = best(pat)
    solver.factor(data)
    assert A @ solver.solve(b) == pytest.approx(b, abs=1e-9)
