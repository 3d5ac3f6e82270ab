"""The tangent of a rigid indenter's wrench against finite differences of whole solves."""

import math

import numpy as np
import pytest
from helpers.presses import gel, poses, scene
from helpers.solves import advance, equilibrium

from tacgen.geometry.analytic_sdf import SphereSdf
from tacgen.geometry.pose import Pose, about, shortest_turn
from tacgen.mechanics import Problem, mesh
from tacgen.mechanics.rigid_stiffness import stiffness
from tacgen.mechanics.state import State

Array = np.ndarray
STEP = 2e-3  # [mm], and of a turn by an arm of 3 mm


def wrench(problem: Problem, state: State, centre: Array) -> Array:
    f, arm = state.traction_force, problem.contact.faces.at(state.x) - centre
    return np.concatenate([f.sum((0, 1)), np.cross(arm, f).sum((0, 1))])


@pytest.mark.parametrize(("slid", "tol"), [(0.0, 0.03), (0.1, 0.03), (0.5, 0.2)])
def test_tangent_is_the_derivative_of_the_wrench(slid: float, tol: float) -> None:
    """Sticking, slipping at the rim, and sliding as a whole, where the anchors of the path blur the direction."""
    s = scene(SphereSdf(4.0), poses([(0.0, 0.0, -0.3), (slid, 0.0, -0.31)]), pad=gel(10, 10), friction=0.6)
    problem = Problem.of(s, mesh.of(s))
    rest = problem.rest(Pose.of(s.start))
    before = advance(problem, rest, s.start, s.poses[0], np.zeros(3), 0, math.inf).history
    turn = shortest_turn(s.poses[0], s.poses[1])
    after, state = advance(problem, before, s.poses[0], s.poses[1], turn, 1, math.inf).reached()
    assert state.substeps == 1
    centre = np.array([slid, 0.0, 3.7])
    scale = np.array([1.0, 1, 1, 3, 3, 3])
    found = stiffness(problem, before, after, 1, centre) / scale / scale[:, None]
    exact = np.zeros((6, 6))
    for k in range(6):
        ends = []
        for step in (STEP, -STEP):
            motion, moved = step * np.eye(6)[k] / scale, s.poses[1].copy()
            moved[:3, :3] = about(motion[3:], 1.0) @ moved[:3, :3]
            moved[:3, 3] = about(motion[3:], 1.0) @ (s.poses[1][:3, 3] - centre) + centre + motion[:3]
            there = equilibrium(problem, before, moved, 1, near=state).reached()[1]
            ends.append(wrench(problem, there, centre + motion[:3]))
        exact[:, k] = (ends[0] - ends[1]) / (2 * STEP) / scale
    assert np.linalg.norm(found - exact) < tol * np.linalg.norm(exact), (found, exact)


def test_nothing_touched_resists_nothing() -> None:
    s = scene(SphereSdf(4.0), poses([(0.0, 0.0, 1.0)]), pad=gel(10, 10), friction=0.6)
    problem = Problem.of(s, mesh.of(s))
    rest = problem.rest(Pose.of(s.poses[0]))
    assert not stiffness(problem, rest, rest, 1, np.zeros(3)).any()
