"""Stepping frames: how a frame that cannot be had ends, substeps, the footprint, and what each frame records."""

from dataclasses import replace

import numpy as np
import pytest
from physics.presses import gel, poses, run, scene

from tacgen import mesh, solve
from tacgen.fem.contact import Pose
from tacgen.fem.newton import Solution, Status
from tacgen.fem.shapes import Box, Sphere
from tacgen.scene import Scene
from tacgen.solve import NotConverged, Problem, states
from tacgen.step import advance, travel

SMALL = (-1.8, 1.8, -1.8, 1.8)
PATH = [(0.0, 0.0, -0.2), (0.0, 0.0, -0.4), (0.3, 0.0, -0.4)]


def made(friction: float = 0.0) -> tuple[Scene, Problem]:
    s = scene(Sphere(2.5), poses(PATH), pad=gel(8, 8, 2.0), friction=friction, edge=0.6)
    return s, Problem.of(s, mesh.build(s.gel, SMALL, s.edge))


def test_frames_come_in_order_at_the_poses_asked_for() -> None:
    s, problem = made(0.3)
    found = list(states(s, problem))
    assert [state.index for state in found] == [0, 1, 2]
    for state, pose in zip(found, s.poses, strict=True):
        assert (state.pose == pose).all()
        assert state.substeps == 1
        assert 1 < state.iterations < 30
        assert state.residual < 1e-3
        assert state.balance < 1e-3
        assert 0 < state.min_gap <= state.mean_gap < s.dhat
        assert state.mean_gap == pytest.approx(state.offset, abs=1e-3)
        held = np.unique(problem.mesh.facets["bonded"])
        assert (state.x[held] == problem.mesh.points[held]).all()
        inside = s.shape.distance(Pose.of(pose).local(problem.contact.faces.at(state.x)).reshape(-1, 3))[0]
        assert inside.min() > -state.offset
    assert -found[1].traction_force.sum((0, 1))[2] > -2 * found[0].traction_force.sum((0, 1))[2]  # stiffens
    assert found[2].traction_force.sum((0, 1))[0] > 0


def test_solving_again_gives_the_same_numbers() -> None:
    one, two = (list(states(*made(0.3))) for _ in range(2))
    assert all((a.x == b.x).all() and (a.normal_force == b.normal_force).all() for a, b in zip(one, two, strict=True))


def lost(monkeypatch: pytest.MonkeyPatch, height: float) -> None:
    """Newton ends without an answer, the gel flattened to a part of its height."""

    def condensed(bulk: object, felt: object, x: np.ndarray, *a: object, **k: object) -> Solution:
        return Solution(x * [1, 1, height], Status.out_of_steps, ())

    def whole(potential: object, x: np.ndarray, *a: object, **k: object) -> Solution:
        return Solution(x, Status.out_of_steps, ())

    monkeypatch.setattr(advance, "settle", condensed)
    monkeypatch.setattr(advance, "minimise", whole)


def test_a_frame_that_newton_cannot_reach_is_refused_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    lost(monkeypatch, 1.0)
    with pytest.raises(NotConverged, match="Newton out of steps after 0 iterations: less depth"):
        next(states(*made()))


def test_a_frame_without_an_answer_says_how_far_the_gel_is_squeezed(monkeypatch: pytest.MonkeyPatch) -> None:
    lost(monkeypatch, 0.03)
    with pytest.raises(NotConverged, match=r"0 iterations with gel squeezed to [23]\.\d% of its volume: less depth"):
        next(states(*made()))


def test_a_frame_out_of_balance_is_refused_with_the_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(advance, "RESIDUAL", 1e-300)
    monkeypatch.setattr(travel, "HALVINGS", 0)
    with pytest.raises(NotConverged, match=r"residual \d\.\de-\d+ and balance \d\.\de-\d+ of the contact"):
        next(states(*made()))


def test_a_point_inside_the_indenter_stiffens_the_barrier_or_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gel far stiffer than its contact was made for is overrun by the indenter."""
    s, problem = made()
    usual = next(states(s, problem)).traction_force.sum((0, 1))[2]
    monkeypatch.setattr(travel, "HALVINGS", 0)
    soft = replace(problem, contact=replace(problem.contact, kappa=1e-3 * problem.contact.kappa))
    mended = next(states(s, soft))
    assert mended.min_gap > 0
    assert mended.traction_force.sum((0, 1))[2] == pytest.approx(usual, rel=0.05)
    monkeypatch.setattr(advance, "STIFFER", 1)
    with pytest.raises(NotConverged, match="smallest gap -"):
        next(states(s, soft))


def test_substeps_are_taken_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton is made to refuse any advance of more than .09 mm: .2 mm need four, and .3 mm too."""
    true, depths = travel.advance, [0.0]

    def careful(
        problem: Problem, memory: advance.Memory, matrix: np.ndarray, index: int, duration: float
    ) -> tuple[advance.Memory, solve.State]:
        if np.linalg.norm(matrix[:3, 3] - memory.pose.position) > 0.09:
            raise NotConverged("too far")
        depths.append(matrix[2, 3])
        return true(problem, memory, matrix, index, duration)

    s, problem = made()
    direct = list(states(s, problem))
    monkeypatch.setattr(travel, "advance", careful)
    found = list(states(s, problem))
    assert [state.substeps for state in found] == [4, 4, 4]
    assert depths == pytest.approx([*(-0.05 * k for k in range(9)), *[-0.4] * 4])
    assert [state.index for state in found] == [0, 1, 2]
    assert all((state.pose == pose).all() for state, pose in zip(found, s.poses, strict=True))
    for a, b in zip(direct, found, strict=True):
        assert b.iterations > 1
        assert b.traction_force.sum((0, 1)) == pytest.approx(a.traction_force.sum((0, 1)), abs=2e-3)


def test_halving_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def never(problem: Problem, memory: advance.Memory, matrix: np.ndarray, index: int, duration: float) -> None:
        tried.append(matrix[2, 3])
        raise NotConverged("never")

    monkeypatch.setattr(travel, "advance", never)
    with pytest.raises(NotConverged, match="never"):
        next(states(*made()))
    assert tried == pytest.approx([-0.2 / 2**k for k in range(travel.HALVINGS + 1)])


def test_the_way_between_two_poses_is_straight_and_steady() -> None:
    a, b = poses([(0, 0, 0)], yaw=0.2)[0], poses([(1, 2, 4)], yaw=1.0)[0]
    half = travel.between(a, b, 0.25)
    assert half == pytest.approx(poses([(0.25, 0.5, 1)], yaw=0.4)[0], abs=1e-12)
    assert travel.between(a, b, 1.0) == pytest.approx(b, abs=1e-12)


def test_the_footprint_covers_all_that_is_touched_and_little_more() -> None:
    path = poses([(-2, -1, -0.5), (2, 0.5, -0.5), (2, 0.5, 0.3)])
    s = scene(Sphere(3.0), path, pad=gel(20, 20, 3))
    x0, x1, y0, y1 = mesh.footprint(s)
    rim = np.sqrt(3.0**2 - 2.5**2)
    margin = np.array([-2 - rim - x0, x1 - 2 - rim, -1 - rim - y0, y1 - 0.5 - rim])
    assert margin.min() > 0
    assert margin.max() < 1.5 * s.edge


def test_what_is_touched_lies_within_the_footprint() -> None:
    s = scene(Box(2.0, 1.0, 0.2), poses([(0.5, 0, -0.4), (0.5, 1.0, -0.4)], yaw=0.5), pad=gel(10, 10, 2), friction=0.4)
    found = run(s)
    x0, x1, y0, y1 = mesh.footprint(s)
    rest = found.problem.contact.faces.at(found.problem.mesh.points)
    for state in found.states:
        where = rest[state.normal_force > 0]
        assert len(where) > 10
        assert (where[:, 0] > x0).all()
        assert (where[:, 0] < x1).all()
        assert (where[:, 1] > y0).all()
        assert (where[:, 1] < y1).all()


def test_an_indenter_that_never_touches_has_a_footprint_and_no_force() -> None:
    s = scene(Sphere(2.0), poses([(1.0, 0, 0.5), (1.0, 0, 0.2)]), pad=gel(8, 8, 2), friction=0.5)
    x0, x1, y0, y1 = mesh.footprint(s)
    assert x0 < 1.0 < x1
    assert y0 < 0.0 < y1
    assert max(x1 - x0, y1 - y0) < 2.5 * s.edge
    found = run(s)
    assert np.abs(found.forces).max() == 0
    for state in found.states:
        assert state.x == pytest.approx(found.problem.mesh.points, abs=1e-12)
    assert max(state.balance for state in found.states) < 1e-7


def test_where_nothing_touches_one_iteration_is_enough() -> None:
    s = scene(Sphere(2.0), poses([(1.0, 0, 0.5), (1.0, 0, 0.2)]), pad=gel(8, 8, 2), friction=0.5)
    assert max(state.iterations for state in run(s).states) <= 1


def test_a_step_too_long_for_edges_is_kept_where_its_halves_fail_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """And where it was halved to the end, the next is not tried whole."""
    usual, tried = travel.advance, list[float]()

    def watched(
        problem: Problem, memory: advance.Memory, matrix: np.ndarray, index: int, duration: float
    ) -> tuple[advance.Memory, solve.State]:
        tried.append(matrix[2, 3])
        if failing and np.linalg.norm(matrix[:3, 3] - memory.pose.position) < 0.19:
            raise NotConverged("a half")
        return usual(problem, memory, matrix, index, duration)

    monkeypatch.setattr(travel, "advance", watched)
    monkeypatch.setattr(travel, "HALVINGS", 0)
    monkeypatch.setattr(travel, "rounded", lambda *_: 0.07)
    failing = True
    for state in states(*made()):
        assert (state.substeps, state.rounded) == (1, 0.07)
    assert tried == pytest.approx([-0.2, -0.1, -0.4, -0.3, -0.4, -0.4])
    failing = False
    tried.clear()
    found = list(states(*made()))
    assert [state.substeps for state in found] == [4, 4, 4]
    assert tried == pytest.approx(
        [-0.2, -0.1, -0.05, -0.1, -0.15, -0.2, *(-0.2 - 0.05 * k for k in range(1, 5)), *[-0.4] * 4]
    )
