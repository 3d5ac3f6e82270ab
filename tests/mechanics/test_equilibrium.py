"""Contact solved on the condensed bulk leads to the answer of Newton's method on everything, at less cost."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.presses import force, gel, poses, problem_of, scene

from tacgen.geometry.analytic_sdf import CylinderSdf, Shape, SphereSdf
from tacgen.geometry.pose import Pose
from tacgen.mechanics import Problem, SolverOptions, State, plain, solver, states
from tacgen.mechanics.condensation import Condensation, Schur
from tacgen.mechanics.course import Course, Leg
from tacgen.mechanics.frames import UNIT_RISE
from tacgen.mechanics.numerics import Numerics
from tacgen.mechanics.one_scene import OneScene
from tacgen.mechanics.phases import Outcome, Phase
from tacgen.mechanics.predictor import predict
from tacgen.mechanics.solver import go_on

Array = np.ndarray
PATH = [(0.0, 0.0, -0.2), (0.0, 0.0, -0.4), (0.2, 0.0, -0.4), (0.4, 0.1, -0.3)]
USUAL = SolverOptions()
TIGHT = replace(USUAL, step_tol=3e-4, residual_tol=1e-6, fold_tol=1e-6, fold_max=1e-6)


def solved(
    shape: Shape,
    path: list[tuple[float, float, float]],
    options: SolverOptions = USUAL,
    friction: float = 0.6,
    edge: float = 0.5,
) -> tuple[list[State], Problem]:
    made = scene(shape, poses(path), pad=gel(8, 8, 2.0), friction=friction, edge=edge)
    problem = problem_of(made, 2.0, options)
    return list(states(made, problem)), problem


def alike(one: list[State], two: list[State], tol: float) -> None:
    """Forces and, point by point, what presses and rubs, within a part of the force."""
    for a, b in zip(one, two, strict=True):
        assert np.abs(force(a) - force(b)).max() < tol * np.linalg.norm(force(a))
        assert np.linalg.norm(a.normal_force - b.normal_force) < 5 * tol * np.linalg.norm(a.normal_force)
        assert b.x == pytest.approx(a.x, abs=tol)
        if a.friction is not None and b.friction is not None:
            assert np.linalg.norm(a.friction - b.friction) < 20 * tol * np.linalg.norm(a.friction)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [CylinderSdf(1.2, 0.4), SphereSdf(2.5)], ids=lambda shape: type(shape).__name__)
def test_the_answer_is_that_of_the_oracle_in_fewer_factorisations(shape: Shape) -> None:
    """Steps begin from the gel left behind in both: what is predicted says where new points first touch. Tolerances are
    alike too: under the sliding punch two equilibria are 1 % apart, and the last digits choose one."""
    both = (replace(options, step_tol=3e-4, residual_tol=1e-7) for options in (plain(), STILL))
    (one, first), (two, second) = (solved(shape, PATH, options) for options in both)
    assert not first.condensed
    assert second.condensed
    assert second.linear.factored == 0
    assert 0 < second.factored == second.tangent.condensation.factored
    assert sum(state.iterations for state in two) < 0.6 * sum(state.iterations for state in one)
    assert second.factored <= 4 * sum(state.substeps for state in two)
    alike(one, two, 2e-4)


STILL = replace(TIGHT, predict=False, fold_halvings=0)  # halves give friction another path


@pytest.fixture(scope="module")
def usual() -> list[State]:
    return solved(SphereSdf(2.5), PATH, STILL)[0]


@pytest.mark.parametrize(
    "change",
    [{"keep_tangent": False}, {"mixed_pressure": False}, {"patience": 20.0}, {"max_newton": 200}],
    ids=lambda change: next(iter(change)),
)
def test_how_it_is_found_does_not_show_in_the_answer(change: dict[str, float], usual: list[State]) -> None:
    """Nothing predicted: a prediction depends on where the tangent was taken, and says where new points first touch."""
    other, _ = solved(SphereSdf(2.5), PATH, replace(STILL, **change))  # type: ignore[arg-type]
    alike(usual, other, 1e-4)


def test_without_friction_what_is_predicted_does_not_show_either() -> None:
    usual, one = solved(SphereSdf(2.5), PATH, TIGHT, 0.0)
    other, two = solved(SphereSdf(2.5), PATH, replace(TIGHT, predict=False), 0.0)
    alike(usual, other, 1e-4)
    assert one.factored <= two.factored


def test_a_kept_tangent_saves_factorisations() -> None:
    usual, kept = solved(SphereSdf(2.5), PATH)
    _, fresh = solved(SphereSdf(2.5), PATH, replace(USUAL, keep_tangent=False))
    assert kept.factored < fresh.factored
    assert max(state.residual for state in usual) < 1e-3


def test_contact_that_leaves_the_condensed_nodes_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    covered: list[int] = []
    true = Condensation.cover

    def counted(self: Condensation, facets: Array) -> None:
        true(self, facets)
        covered.append(self.size)

    monkeypatch.setattr(Condensation, "cover", counted)
    there, problem = solved(SphereSdf(1.0), [(-1.2, 0.0, -0.2), (1.2, 0.0, -0.2)])
    assert len(covered) >= 3
    assert max(covered) < problem.pattern.size / 3
    conn, local = problem.contact.faces.conn, problem.tangent.condensation.local
    first, last = (conn[(state.normal_force > 0).any(1)] for state in there)
    assert (local[last] >= 0).all()
    assert (local[first] < 0).any()
    assert max(state.residual for state in there) < 1e-3  # of all nodes


def test_without_factors_that_can_be_read_newtons_method_does_it(monkeypatch: pytest.MonkeyPatch) -> None:
    usual, _ = solved(SphereSdf(2.5), PATH[:3])
    monkeypatch.setattr("tacgen.mechanics.linear_solvers.readable", lambda: False)
    found, problem = solved(SphereSdf(2.5), PATH[:3])
    assert not problem.condensed
    assert problem.factored == problem.linear.factored
    for a, b in zip(usual, found, strict=True):
        assert b.residual < 1e-3
        assert force(b) == pytest.approx(force(a), abs=5e-3 * np.linalg.norm(force(a)))


def test_nothing_is_predicted_where_the_tied_gel_is_unstable() -> None:
    (*_, last), problem = solved(SphereSdf(2.5), PATH, edge=1.0)
    assert last.after is not None
    contact = problem.contact.moved(Pose.of(last.pose + 0.1 * UNIT_RISE), last.offset)
    assert predict(contact, problem.tangent, last.after) is not None
    condensed = problem.tangent.condensation
    touched = np.zeros(condensed.size, bool)
    facets = contact.faces.conn[(last.normal_force > 0).any(1)]
    touched[condensed.dofs[condensed.local[facets]]] = True
    S = condensed.schur.undamped - 1e3 * np.diag(touched)
    condensed.schur = Schur(S, lambda: S)
    assert predict(contact, problem.tangent, last.after) is None


def test_a_step_too_long_away_from_the_contact_is_halved_and_not_damped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node in the corner of the pad is pushed almost through its element: Newton's step throws it out on the other
    side. Damping acts on the nodes at the contact and would not help."""
    (*_, last), problem = solved(SphereSdf(2.5), PATH, TIGHT)
    assert last.after is not None
    lower = last.pose - 0.05 * UNIT_RISE
    legs = (Leg(lower, lower, np.zeros(3), np.inf),)
    usual, answer = Course(0, last.after, legs), Course(0, last.after, legs)
    begun, other = OneScene(problem, usual), OneScene(problem, answer)
    for each in (begun, other):  # both by one tangent
        go_on(each, until=Phase.start)
    go_on(begun, until=Phase.step)
    x = begun.begins.x
    go_on(begun)
    far = np.flatnonzero(problem.mesh.points[:, 2] == problem.mesh.points[:, 2].max())
    far = far[problem.mesh.points[far, :2].sum(1).argmax()]
    pushed = x.copy()
    pushed[far, 2] -= 0.4
    parts: list[float] = []
    search = solver.PHASE_KERNELS[Phase.search]

    def seen(n: Numerics, rows: list[int]) -> list[Outcome]:
        (outcome,) = search(n, rows)
        assert isinstance(n, OneScene)
        if outcome is Outcome.ready:
            parts.append(n.courses[0].newton.part)
            assert n.there.energy < n.at.energy + 1e-3
        return [outcome]

    monkeypatch.setitem(solver.PHASE_KERNELS, Phase.search, seen)
    answer.near = replace(last, x=pushed)
    go_on(other)
    assert min(parts) < 1
    assert answer.state is not None
    assert answer.state.damped == 0
    assert answer.history.x == pytest.approx(usual.history.x, abs=1e-4)
