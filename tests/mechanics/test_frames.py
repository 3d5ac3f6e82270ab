"""Stepping frames: how a frame that cannot be had ends, substeps, the footprint, and what each frame records."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.load_steps import watched
from helpers.presses import force, gel, poses, problem_of, run, scene
from helpers.solves import equilibrium

from tacgen.fem.elasticity import Elastic
from tacgen.fem.jacobian import least_jacobian
from tacgen.geometry.analytic_sdf import BoxSdf, CylinderSdf, Shape, SphereSdf
from tacgen.geometry.pose import Pose
from tacgen.mechanics import (
    Failure,
    NotConverged,
    Problem,
    SolverOptions,
    admission,
    load_stepping,
    mesh,
    one_scene,
    short_steps,
    states,
)
from tacgen.mechanics.course import Course
from tacgen.mechanics.scene import Forced, Scene

Array = np.ndarray
USUAL = SolverOptions()
SMALL = 1.8  # half of what is fine [mm]
PATH = [(0.0, 0.0, -0.2), (0.0, 0.0, -0.4), (0.3, 0.0, -0.4)]


def made(friction: float = 0.0, options: SolverOptions = USUAL) -> tuple[Scene, Problem]:
    s = scene(SphereSdf(2.5), poses(PATH), pad=gel(8, 8, 2.0), friction=friction, edge=0.6)
    return s, problem_of(s, SMALL, options)


def test_frames_come_in_order_at_the_poses_asked_for() -> None:
    s, problem = made(0.3)
    found = list(states(s, problem))
    assert [state.index for state in found] == [0, 1, 2]
    assert all(0.3 < state.least_J < 0.99 for state in found)
    for state, pose in zip(found, s.poses, strict=True):
        assert (state.pose == pose).all()
        assert state.least_J == least_jacobian(problem.mesh.points, state.x, problem.mesh.cells)
        assert state.substeps == 1
        assert 1 <= state.iterations < 20
        assert state.residual < 1e-3
        assert state.balance < 1e-3
        assert 0 < state.min_gap <= state.mean_gap < s.dhat
        assert state.mean_gap == pytest.approx(state.offset, abs=1e-3)
        held = np.unique(problem.mesh.facets["bonded"])
        assert (state.x[held] == problem.mesh.points[held]).all()
        inside = s.shape.distance(Pose.of(pose).local(problem.contact.faces.at(state.x)).reshape(-1, 3))[0]
        assert inside.min() > -state.offset
    assert -force(found[1])[2] > -2 * force(found[0])[2]  # stiffens
    assert force(found[2])[0] > 0


@pytest.mark.parametrize("asked", [0.02, 0.05, 0.2])
def test_a_punch_reaches_forces_that_are_light_beside_the_solvers_tolerances(asked: float) -> None:
    one = np.ones(1)
    s = scene(CylinderSdf(3.0, 0.4), poses([(0, 0, -0.05)]), pad=gel(8, 8, 2.0, nu=0.4995), friction=1.0, edge=1.0)
    s = replace(s, dhat=0.1, forced=Forced(asked * one, one, one, -1.6 * one, 1.5 * one))
    (state,) = states(s, problem_of(s, 3.5))
    assert -force(state)[2] == pytest.approx(asked, rel=USUAL.force_tol)


def flat(body: Elastic, *args: Any) -> Any:
    """The state of elements that are squeezed to 3 % of their volume there."""
    at = EVALUATE(body, *args)
    return replace(at, J=0.03 * at.J)


EVALUATE = Elastic.evaluate
SQUEEZED = r"in 1 steps, the gel squeezed to [23]\.\d% of its volume; try less depth"


@pytest.mark.parametrize(
    ("options", "spoil", "says"),
    [
        ({"max_newton": 1}, {}, "Newton did not converge in 1 steps; try less depth, less friction or a"),
        ({"max_newton": 1, "mixed_pressure": False}, {(Elastic, "evaluate"): flat}, SQUEEZED),
        ({"residual_max": 1e-300}, {}, r"^residual \d\.\de-\d+ and balance \d\.\de-\d+ of the contact force, sm"),
        ({}, {(one_scene, "least_jacobian"): lambda *_: -0.2},
         r"an element is turned inside out, to -0\.2 of its volume; try less depth"),
    ],
)  # fmt: skip
def test_a_frame_without_an_answer_is_refused_with_its_reason(
    options: dict[str, Any], spoil: dict[tuple[Any, str], Any], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for (owner, name), by in spoil.items():
        monkeypatch.setattr(owner, name, by)
    with pytest.raises(NotConverged, match=says):
        next(states(*made(options=SolverOptions(halvings=0, **options))))


def test_a_point_inside_the_indenter_stiffens_the_barrier_or_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gel far stiffer than its contact was made for is overrun by the indenter."""
    s, problem = made(options=SolverOptions(halvings=0))
    usual = force(next(states(s, problem)))[2]
    soft = replace(problem, contact=replace(problem.contact, kappa=1e-3 * problem.contact.kappa))
    mended = next(states(s, soft))
    assert mended.min_gap > 0
    assert force(mended)[2] == pytest.approx(usual, rel=0.05)
    monkeypatch.setattr(one_scene, "BARRIER_STIFFENING_FACTOR", 1.0)
    with pytest.raises(NotConverged, match="smallest gap -"):
        next(states(s, soft))


def longer(now: Course, than: float) -> bool:
    return bool(np.linalg.norm(now.legs[0].b[:3, 3] - now.history.pose.position) > than)


@pytest.mark.parametrize(("kind", "halvings"), [(Failure.singular, 2), (Failure.too_far, 0)])
def test_a_step_that_fails_is_halved_and_its_parts_counted(
    kind: Failure, halvings: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any of more than .09 mm is made to: .2 mm need four, and .3 mm too. Going too far does not use up halvings."""
    s, problem = made(options=SolverOptions(halvings=halvings))
    direct = list(states(s, problem))
    done = watched(monkeypatch, lambda now: NotConverged(kind) if longer(now, 0.09) else None)
    found = list(states(s, problem))
    assert [state.substeps for state in found] == [4, 4, 4]
    assert [leg.b[2, 3] for leg in done] == pytest.approx([*(-0.05 * k for k in range(1, 9)), *[-0.4] * 4])
    assert [leg.b[0, 3] for leg in done[-4:]] == pytest.approx([0.075, 0.15, 0.225, 0.3])
    assert [state.index for state in found] == [0, 1, 2]
    assert all((state.pose == pose).all() for state, pose in zip(found, s.poses, strict=True))
    for a, b in zip(direct, found, strict=True):
        assert b.iterations > a.iterations
        assert force(b) == pytest.approx(force(a), abs=2e-3)


@pytest.mark.parametrize(
    ("kind", "times"), [(Failure.singular, 3), (Failure.too_far, load_stepping.MAX_TUNNELLING_HALVINGS)]
)
def test_halving_ends(kind: Failure, times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def never(now: Course) -> NotConverged:
        tried.append(now.legs[0].b[2, 3])
        return NotConverged(kind)

    watched(monkeypatch, never)
    with pytest.raises(NotConverged, match=kind):
        next(states(*made(options=SolverOptions(halvings=3))))
    assert tried == pytest.approx([-0.2 / 2**k for k in range(times + 1)])


def test_a_frames_effort_is_bounded_and_the_next_has_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorter load steps would only take more."""
    s, problem = made(0.3)
    most = max(state.iterations for state in states(s, problem))
    options = SolverOptions(max_effort=most)
    assert sum(state.iterations for state in states(*made(0.3, options))) > most
    tried = watched(monkeypatch)
    with pytest.raises(NotConverged, match="did not converge in 2 steps"):
        list(states(*made(0.3, SolverOptions(max_effort=2, residual_tol=1e-9, step_tol=1e-6))))
    assert [leg.b[2, 3] for leg in tried] == [-0.2]


def test_a_step_that_failed_leaves_nothing_behind() -> None:
    """What it did to the kept tangent is not in the next answer, which is the same to the last bit."""
    s, problem = made(0.3)
    rest = problem.rest(Pose.of(s.start))
    _, usual = equilibrium(problem, rest, s.poses[0], 0).reached()
    s, problem = made(0.3)
    options = replace(problem.options, max_newton=2, keep_tangent=False, residual_tol=1e-14, step_tol=1e-9)
    hasty = replace(problem, options=options)
    hasty.__dict__["tangent"] = problem.tangent  # the same one
    with pytest.raises(NotConverged):
        equilibrium(hasty, rest, s.poses[0], 0).reached()
    assert problem.factored > 0
    _, again = equilibrium(problem, rest, s.poses[0], 0).reached()
    assert (again.x == usual.x).all()


def test_the_footprint_covers_all_that_is_touched_and_little_more() -> None:
    path = poses([(-2, -1, -0.5), (2, 0.5, -0.5), (2, 0.5, 0.3)])
    s = scene(SphereSdf(3.0), path, pad=gel(20, 20, 3))
    x0, x1, y0, y1 = mesh.footprint(s)
    rim = np.sqrt(3.0**2 - 2.5**2)
    margin = np.array([-2 - rim - x0, x1 - 2 - rim, -1 - rim - y0, y1 - 0.5 - rim])
    assert margin.min() > 0
    assert margin.max() < 1.5 * s.edge


def test_an_indenter_that_never_touches_has_a_footprint_and_no_force() -> None:
    s = scene(SphereSdf(2.0), poses([(1.0, 0, 0.5), (1.0, 0, 0.2)]), pad=gel(8, 8, 2), friction=0.5)
    x0, x1, y0, y1 = mesh.footprint(s)
    assert x0 < 1.0 < x1
    assert y0 < 0.0 < y1
    assert max(x1 - x0, y1 - y0) < 2.5 * s.edge
    found = run(s)
    assert np.abs(found.forces).max() == 0
    for state in found.states:
        assert state.x == pytest.approx(found.problem.mesh.points, abs=1e-12)
    assert max(state.balance for state in found.states) < 1e-7
    assert max(state.iterations for state in found.states) <= 1


AT_ONCE = SolverOptions(sink=np.inf, slide=np.inf, slide_sharp=np.inf, fold_halvings=0, fold_tol=2e-4, fold_max=2e-4)


@pytest.mark.slow
def test_a_deep_press_at_once_goes_in_load_steps_to_the_same_force() -> None:
    """Without friction the way there does not matter: half the tangents, the same answer."""
    made = scene(SphereSdf(4.0), poses([(0, 0, -1.0)]), pad=gel(12, 12, 4.0), edge=0.6)
    problems = [problem_of(made, 3.0, options) for options in (SolverOptions(), AT_ONCE)]
    (split,), (whole,) = (list(states(made, problem)) for problem in problems)
    assert (split.substeps, whole.substeps) == (2, 1)
    assert force(split)[2] == pytest.approx(force(whole)[2], rel=1e-3)
    assert problems[0].factored < 0.8 * problems[1].factored


def test_friction_taken_round_a_sharp_edge_in_one_step_is_recorded() -> None:
    """A box with edges of a quarter of a cell, slid by a cell at once and in sixty steps; a ball has none."""
    path = [(0.0, 0.0, -0.4), (0.6, 0.1, -0.4)]

    def slid(shape: Shape, friction: float, times: int) -> float:
        made = scene(shape, poses(path), pad=gel(8, 8, 2.0), friction=friction, edge=0.6)
        options = short_steps(SolverOptions(sink=9.0, slide=9.0, slide_sharp=9.0, fold_halvings=0), times)
        found = list(states(made, problem_of(made, SMALL, options)))
        assert found[1].substeps == (1 if times == 1 or not friction else 7)
        return found[1].rounded

    box = BoxSdf(1.6, 1.6, 0.15)
    whole = slid(box, 0.6, 1)
    assert whole > 0.05
    assert slid(box, 0.6, 60) < 0.5 * whole
    assert slid(box, 0.0, 1) == slid(SphereSdf(2.5), 0.6, 1) == 0


def test_friction_round_an_edge_is_that_of_the_points_whose_normal_turns() -> None:
    made = scene(BoxSdf(1.0, 1.0, 0.05), poses(PATH), pad=gel(8, 8, 2.0), friction=0.6, edge=0.6)
    problem = problem_of(made, SMALL)
    after, _ = equilibrium(problem, problem.rest(Pose.of(made.start)), made.poses[0], 0).reached()
    one = np.unravel_index(after.normal_force.argmax(), after.normal_force.shape)
    share = after.normal_force[one] / after.normal_force.sum()
    for angle, part in ((0.25, 0.0), (0.4, 0.6 * share)):
        normal = after.normal.copy()
        normal[one] = [np.sin(angle), 0, -np.cos(angle)]
        assert after.normal[one] == pytest.approx([0, 0, -1])
        assert admission.rounded(problem, replace(after, normal=normal), after) == pytest.approx(part)
    released = replace(after, normal=-after.normal, normal_force=np.zeros_like(after.normal_force))
    assert admission.rounded(problem, after, released) == pytest.approx(0.6)
