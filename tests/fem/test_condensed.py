"""The bulk condensed to the face says what the whole says, learns from gradients, and leads to Newton's answer."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from physics.presses import gel, poses, scene

from tacgen import mesh
from tacgen.fem.assembly import pattern
from tacgen.fem.condensed import Condensed
from tacgen.fem.elements import hexes
from tacgen.fem.linear import Cholmod, NotPositiveDefinite, dissection, readable
from tacgen.fem.materials import NeoHooke
from tacgen.fem.potentials import LAST, Elastic
from tacgen.fem.shapes import Cylinder, Shape, Sphere
from tacgen.solve import State, states
from tacgen.step import advance
from tacgen.step.problem import Problem

from .small import block, dense

Array = np.ndarray


@pytest.fixture
def bulk() -> tuple[Condensed, Elastic, Array, Array]:
    """A bonded block condensed to the middle of its upper face, its elasticity, positions and whole stiffness."""
    points, cells = block(4, 0.1)
    free = np.ones((len(points), 3), bool)
    free[points[:, 2] == 0] = False
    whole = pattern([cells], free)
    elastic = Elastic.on(whole, hexes(points, cells), NeoHooke(0.05, 1.0), lazy=0.0)
    top = cells[:, 4:][(points[cells[:, 4:], 2] == 1).all(1)]
    condensed = Condensed(whole)
    condensed.cover(top[[5, 6, 9]])
    condensed.renew(elastic, points, True)
    return condensed, elastic, points, dense(elastic, points, whole)


def test_the_end_of_cholmods_factor_is_the_end_of_the_factor() -> None:
    rng = np.random.default_rng(0)
    assert readable()
    points, cells = block(3, 0.1)
    whole = pattern([cells], np.ones((len(points), 3), bool))
    A, b = rng.normal(size=(2, whole.size))
    data = np.zeros(len(whole.indices))
    Elastic.on(whole, hexes(points, cells), NeoHooke(0.05, 1.0)).add_hessian(points, data, 0)
    data[whole.indptr[:-1]] += 0.1
    solver = Cholmod(whole, rng.permutation(whole.size))
    solver.factor(data)
    full = np.zeros((whole.size, whole.size))
    full[np.repeat(np.arange(whole.size), np.diff(whole.indptr)), whole.indices] = data
    full += np.triu(full, 1).T
    L = np.linalg.cholesky(full[np.ix_(solver.order, solver.order)])
    for k in (1, 7, 100, whole.size):
        assert solver.trailing(k) == pytest.approx(L[-k:, -k:], abs=1e-12)
    assert L @ solver.forward(b) == pytest.approx(b[solver.order], abs=1e-10)
    assert L.T @ solver.backward(A)[solver.order] == pytest.approx(A, abs=1e-10)


def test_the_bulk_pulled_at_its_face_is_that_of_all_equations(bulk: tuple[Condensed, Elastic, Array, Array]) -> None:
    condensed, _, points, K = bulk
    rng = np.random.default_rng(1)
    size, free = condensed.size, condensed.pattern.free
    springs, b = np.zeros(len(condensed.pattern.indices)), rng.normal(size=size)
    springs[condensed.pattern.indptr[:-1]] = rng.random(size)
    at = np.searchsorted(condensed.whole.free, free)
    K, load = K.copy(), np.zeros(len(K))
    K[at, at] += springs[condensed.pattern.indptr[:-1]]
    load[at] = b
    found = condensed.pulled(springs, b)
    assert found.shape == points.shape
    assert found.ravel()[condensed.whole.free] == pytest.approx(np.linalg.solve(K, load), abs=1e-8)


def test_an_order_that_is_asked_for_is_kept_even_where_another_is_better() -> None:
    points, cells = block(4, 0.1)
    whole = pattern([cells], np.ones((len(points), 3), bool))
    order = dissection(whole)
    order = np.concatenate([np.delete(order, np.s_[3:33]), order[3:33]])
    assert set(Cholmod(whole, order).order[-30:]) == set(order[-30:])


def test_the_condensed_stiffness_is_the_schur_complement(bulk: tuple[Condensed, Elastic, Array, Array]) -> None:
    rng = np.random.default_rng(0)
    condensed, _, points, A = bulk
    whole = condensed.whole
    near = np.isin(whole.free, condensed.pattern.free)
    assert 3 * condensed.nodes.sum() == condensed.size == near.sum() > 20
    far = ~near
    schur = A[np.ix_(near, near)] - A[np.ix_(near, far)] @ np.linalg.solve(A[np.ix_(far, far)], A[np.ix_(far, near)])
    assert condensed.stiffness == pytest.approx(schur, abs=1e-12)
    g = rng.normal(size=points.shape)
    y, push = condensed.begin(g), rng.normal(size=condensed.size)
    u = np.linalg.solve(condensed.stiffness, push - condensed.force(y))
    p, q = condensed.end(u, y)
    expected = -g.ravel()[whole.free]
    expected[near] += push
    assert A @ p.ravel()[whole.free] == pytest.approx(expected, abs=1e-10)
    assert q @ q == pytest.approx(p.ravel()[whole.free] @ A @ p.ravel()[whole.free])
    held = np.ones(p.size, bool)
    held[whole.free] = False
    assert (p.ravel()[held] == 0).all()


def test_it_learns_how_the_gradient_changes(bulk: tuple[Condensed, Elastic, Array, Array]) -> None:
    """Of another quadratic, steps along its error are taught until it is known; the last one is always met."""
    rng = np.random.default_rng(0)
    condensed, _, points, A = bulk
    whole, n = condensed.whole, condensed.whole.size
    V = 0.04 * rng.normal(size=(n, 2)) / np.sqrt(n)
    other, b = A + V @ V.T, rng.normal(size=n)
    x, wrong = np.zeros(n), []
    last: tuple[Array, Array, Array] | None = None
    for _ in range(20):
        g = np.zeros(points.size)
        g[whole.free] = other @ x - b
        y = condensed.begin(g.reshape(points.shape))
        if last is not None:
            p, q, before = last
            if not wrong:
                assert condensed.curvature(q) == pytest.approx(q @ q)
            assert p @ other @ p == pytest.approx(q @ (y - before))
            wrong.append(condensed.learn(q, y - before))
            assert condensed.learn(q, y - before) < 1e-9  # said again, it is no news
            assert condensed.curvature(q) == pytest.approx(q @ (y - before))
        u = np.linalg.solve(condensed.stiffness, -condensed.force(y))
        step, q = condensed.end(u, y)
        last = step.ravel()[whole.free], q, y
        x += last[0]
        if np.abs(last[0]).max() < 1e-9 * np.abs(x).max():
            break
    assert wrong[0] > 0.1
    assert other @ x == pytest.approx(b, abs=1e-8)


def test_it_learns_nothing_from_where_it_is_all_wrong(bulk: tuple[Condensed, Elastic, Array, Array]) -> None:
    """A step on which the gradient changed by half as much again tells of that way, not of the stiffness."""
    condensed = bulk[0]
    q = np.random.default_rng(0).normal(size=condensed.whole.size)
    assert condensed.learn(q, 1.5 * q) == pytest.approx(0.5)
    assert condensed.curvature(q) == pytest.approx(q @ q)
    assert condensed.learn(q, 1.2 * q) == pytest.approx(0.2)
    assert condensed.curvature(q) == pytest.approx(1.2 * (q @ q))


def test_what_contact_never_acted_on_is_eliminated_once(bulk: tuple[Condensed, Elastic, Array, Array]) -> None:
    """The step is that of the whole, while contact begins to act on more and more unknowns, and where it ends."""
    rng = np.random.default_rng(0)
    condensed = bulk[0]
    size, pat = condensed.size, condensed.pattern
    b, splits = rng.normal(size=size), []
    for acted in (0, 6, 3, size // 2, size, 0):
        data = np.zeros(len(pat.indices))
        data[pat.indptr[:-1][:acted]] = 0.3
        condensed.factor(data)
        splits.append(condensed._split)
        K = condensed.stiffness + np.diag(np.where(np.arange(size) < acted, 0.3, 0.0))
        assert condensed.solve(b) == pytest.approx(np.linalg.solve(K, b), abs=1e-10)
    assert [a is not b for a, b in pairwise(splits)] == [True, False, True, True, False]


def test_an_indefinite_contact_is_told(bulk: tuple[Condensed, Elastic, Array, Array]) -> None:
    condensed = bulk[0]
    condensed.factor(np.full(len(condensed.pattern.indices), -100.0))
    with pytest.raises(NotPositiveDefinite):
        condensed.solve(np.ones(condensed.size))


def solved(shape: Shape, path: list[tuple[float, float, float]], condensed: bool) -> tuple[list[State], Problem]:
    s = scene(shape, poses(path), pad=gel(8, 8, 2.0), friction=0.6, edge=0.5)
    problem = Problem.of(s, mesh.build(s.gel, (-2, 2, -2, 2), s.edge))
    if not condensed:
        problem.__dict__["condensed"] = None
    with pytest.MonkeyPatch.context() as patch:  # what is carried along hangs on the stiffness: the same for all, none
        patch.setattr(advance, "carried", lambda *_: None)
        return list(states(s, problem)), problem


PATH = [(0.0, 0.0, -0.2), (0.0, 0.0, -0.4), (0.2, 0.0, -0.4), (0.4, 0.1, -0.3)]


@pytest.mark.parametrize("shape", [Sphere(2.5), Cylinder(1.2, 0.4)], ids=lambda shape: type(shape).__name__)
def test_the_answer_is_that_of_newtons_method_in_fewer_iterations(
    shape: Shape, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("XTOL", "RESIDUAL", "LAG"):
        monkeypatch.setattr(advance, name, getattr(advance, name) / 30)
    (one, first), (two, second) = (solved(shape, PATH, condensed) for condensed in (False, True))
    assert first.factored == first.linear.factored > 0
    assert second.linear.factored == 0
    assert 0 < second.factored <= 3 * sum(state.substeps for state in two)
    assert sum(state.iterations for state in two) < 0.34 * sum(state.iterations for state in one)
    for a, b in zip(one, two, strict=True):
        size = np.linalg.norm(a.traction_force.sum((0, 1)))
        assert np.abs(a.traction_force.sum((0, 1)) - b.traction_force.sum((0, 1))).max() < 1e-4 * size
        assert np.linalg.norm(a.normal_force - b.normal_force) < 1e-3 * np.linalg.norm(a.normal_force)
        assert a.friction is not None
        assert b.friction is not None
        assert np.linalg.norm(a.friction - b.friction) < 5e-3 * np.linalg.norm(a.friction)
        assert b.x == pytest.approx(a.x, abs=2e-4)


def test_contact_that_leaves_the_condensed_nodes_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    covered: list[int] = []
    true = Condensed.cover

    def counted(self: Condensed, facets: Array) -> None:
        true(self, facets)
        covered.append(self.size)

    monkeypatch.setattr(Condensed, "cover", counted)
    path = [(-1.2, 0.0, -0.3), (-0.4, 0.0, -0.3), (1.2, 0.0, -0.3)]
    there, problem = solved(Sphere(1.0), path, True)
    assert 2 <= len(covered) <= 6
    assert max(covered) < problem.pattern.size / 3
    usual, _ = solved(Sphere(1.0), path, False)
    for a, b in zip(usual, there, strict=True):
        assert b.substeps == 1
        assert b.residual < 1e-3
        assert b.normal_force.sum() == pytest.approx(a.normal_force.sum(), rel=2e-3)


def test_too_wide_a_contact_is_left_to_newtons_method(monkeypatch: pytest.MonkeyPatch) -> None:
    usual, _ = solved(Sphere(2.5), PATH[:2], True)
    monkeypatch.setattr(advance, "MOST", 10)
    plain, problem = solved(Sphere(2.5), PATH[:2], True)
    assert problem.condensed is not None
    assert problem.condensed.factored == 0
    assert plain[-1].x == pytest.approx(usual[-1].x, abs=1e-3)


def test_without_factors_that_can_be_read_newtons_method_does_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tacgen.step.problem.linear.readable", lambda: False)
    found, problem = solved(Sphere(2.5), PATH[:1], True)
    assert problem.condensed is None
    assert found[0].residual < 1e-3
    assert replace(problem).factored == problem.factored == problem.linear.factored > 0  # type: ignore[attr-defined]


def test_a_bulk_that_no_quadratic_stands_for_is_left_to_newtons_method(monkeypatch: pytest.MonkeyPatch) -> None:
    usual, kept = solved(Sphere(2.5), PATH[:3], True)
    assert kept.linear.factored == 0  # type: ignore[attr-defined]
    monkeypatch.setattr("tacgen.fem.condensed.STEPS", 1)
    found, problem = solved(Sphere(2.5), PATH[:3], True)
    assert problem.linear.factored > 0  # type: ignore[attr-defined]
    for a, b in zip(usual, found, strict=True):
        assert b.x == pytest.approx(a.x, abs=1e-3)


def test_it_learns_from_the_way_between_answers(bulk: tuple[Condensed, Elastic, Array, Array]) -> None:
    """A little further it learns how the gradient changes, but not from where the block is bent, nor with no answer."""
    condensed, elastic, points, _ = bulk
    way = points[:, 2:] ** 2 * [1.0, 0.0, 0.0]
    g = elastic.gradient(points)

    def learnt(far: float) -> bool:
        before = len(condensed._pairs)
        x = points + far * way
        condensed.carry(x, condensed.begin(elastic.gradient(x)))
        return len(condensed._pairs) > before

    assert not learnt(1e-3)
    condensed.answer = points, condensed.begin(g)
    assert learnt(1e-3)
    assert not learnt(0.6)
    assert not learnt(0.0)
    condensed.cover(elastic.elements.conn[:1, 4:])
    assert not condensed.usable
    assert condensed.answer is None


def test_what_is_not_definite_is_projected_and_far_from_an_answer_at_once_from_then_on(
    bulk: tuple[Condensed, Elastic, Array, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    """From then on, too, where little changes, the pressure of the last answer is tried before all else."""
    condensed, elastic, points, _ = bulk
    usual, asked, bad = elastic.add_hessian, list[int](), {0}

    def indefinite(x: Array, data: Array, project: int) -> None:
        asked.append(project)
        usual(x, data, project)
        data *= -1 if project in bad else 1

    def tried(far: bool, little: bool) -> list[int]:
        asked.clear()
        condensed.renew(elastic, points, far, little)
        assert condensed.usable
        return asked

    monkeypatch.setattr(type(elastic), "add_hessian", lambda self, *args: indefinite(*args))
    assert tried(False, True) == [0, 1]
    assert tried(True, True) == [0, 1]
    assert tried(True, False) == [1]
    assert tried(False, False) == [0, 1]
    assert tried(True, True) == tried(False, True) == [LAST]
    bad.add(LAST)
    assert tried(True, True) == [LAST, 1]
    assert tried(False, True) == [LAST, 0, 1]
