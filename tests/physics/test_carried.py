"""What a step begins from: the gel gone along with the indenter. Long steps and short ones then come to the same."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.fem.contact import Pose
from tacgen.fem.shapes import Capsule
from tacgen.step.carried import carried
from tacgen.step.problem import Memory, Problem
from tacgen.step.travel import travel

from .presses import Run, gel, poses, run, scene

Array = np.ndarray
SQUARE = (-2.5, 2.5, -2.5, 2.5)
CORNERS = [(0.0, 0.0, -0.8), (1.0, 0.4, -0.8), (0.4, 0.9, -0.8)]  # pressed, slid, slid another way


def slid(parts: int) -> Array:
    """Forces (3, 3) of a rough capsule at three corners of its path, with so many frames to each."""
    way = [(0.0, 0.0, 0.0), *CORNERS]
    path = [
        tuple(a + (b - a) * (k + 1) / parts)
        for a, b in zip(np.array(way[:-1]), np.array(way[1:]), strict=True)
        for k in range(parts)
    ]
    made = scene(Capsule(1.3, 2.6), poses(path), pad=gel(nu=0.2), friction=1.1, edge=0.6)
    return run(made, SQUARE).forces[parts - 1 :: parts]


def test_a_long_slide_in_one_frame_ends_where_short_frames_do() -> None:
    """Begun from where the gel was, with new points where the press before would have brought them, the first slide was
    half its force off; the indenter is rough enough that two answers are not far from each other."""
    long, short = slid(1), slid(8)
    off = np.linalg.norm(long - short, axis=1) / np.linalg.norm(short, axis=1)
    assert off[:2] == pytest.approx(0, abs=0.02)
    assert off[2] < 0.06


@pytest.fixture(scope="module")
def pressed() -> tuple[Problem, Memory, Run]:
    made = scene(Capsule(1.3, 2.6), poses(CORNERS[:2]), friction=0.6, edge=0.6)
    whole = run(made, SQUARE)
    first = Problem.of(made, whole.problem.mesh)
    memory, _ = travel(first, first.rest(Pose.of(made.start)), made.start, made.poses[0], 0, 0.0)
    return first, memory, whole


def test_points_in_contact_go_along_and_all_else_follows(pressed: tuple[Problem, Memory, Run]) -> None:
    problem, memory, whole = pressed
    pose = Pose.of(whole.scene.poses[1])
    found = carried(problem, memory, pose)
    assert found is not None
    x = found.x
    faces = problem.contact.faces
    firm = memory.normal_force > 0.1 * memory.normal_force.max()
    gone = pose.local(faces.at(x))[firm] - memory.pose.local(faces.at(memory.x))[firm]
    assert np.abs(gone).max() < 0.02 * np.linalg.norm(pose.position - memory.pose.position)
    moved = np.linalg.norm(x - memory.x, axis=1)
    assert moved.max() < 1.02 * np.linalg.norm(pose.position - memory.pose.position)
    assert not moved[problem.mesh.points[:, 2] == problem.mesh.points[:, 2].min()].any()  # it is bonded there


def test_a_kept_stiffness_and_a_new_one_carry_alike(pressed: tuple[Problem, Memory, Run]) -> None:
    problem, memory, whole = pressed
    pose = Pose.of(whole.scene.poses[1])
    kept = carried(problem, memory, pose)
    other = replace(problem)
    assert other.condensed is not None
    assert not other.condensed.usable
    new = carried(other, memory, pose)
    assert kept is not None
    assert new is not None
    assert np.abs(kept.x - new.x).max() < 0.15 * np.abs(new.x - memory.x).max()  # it is of a gel less deformed


def test_where_nothing_touches_nothing_is_carried(pressed: tuple[Problem, Memory, Run]) -> None:
    problem, _, whole = pressed
    rest = problem.rest(Pose.of(whole.scene.start))
    assert carried(problem, rest, Pose.of(whole.scene.poses[0])) is None
