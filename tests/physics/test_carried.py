"""What a step begins from: the gel gone along with the indenter. Long steps and short ones then come to the same."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen import mesh
from tacgen import scene as stage
from tacgen.bench.answers import row_of
from tacgen.bench.cases import PLAIN
from tacgen.fem.contact import Pose
from tacgen.fem.shapes import Capsule
from tacgen.solve import states
from tacgen.step.carried import carried
from tacgen.step.problem import Memory, Problem
from tacgen.step.travel import travel

from .presses import Run, poses, run, scene

Array = np.ndarray
SQUARE = (-2.5, 2.5, -2.5, 2.5)
CORNERS = [(0.0, 0.0, -0.8), (1.0, 0.4, -0.8)]  # pressed and slid


def capsule(parts: int) -> tuple[Array, int]:
    """Force (3,) after a rough capsule is pressed into the Mini's gel and slid by 1.07 mm, in so many frames for each
    of three, and all iterations."""
    press = f"press: {{depth_mm: 0.856, frames: {2 * parts}}}"
    slide = f"slide: {{x_mm: 0.9955, y_mm: 0.3946, frames: {parts}}}"
    sets = (
        "indenter={shape: capsule, radius_mm: 1.2786, length_mm: 2.5572}",
        f"trajectory=[{{{press}}}, {{{slide}}}]",
        "contact.friction=1.107",
        "sensor.gel.layers[0].youngs_modulus_mpa=1.291",
        "sensor.gel.layers[0].poissons_ratio=0.0055",
    )
    made = stage.build(row_of((*PLAIN, *sets)))
    found = list(states(made, Problem.of(made, mesh.of(made))))
    return found[-1].traction_force.sum((0, 1)), sum(state.iterations for state in found)


def test_a_long_slide_in_one_frame_ends_where_short_frames_do() -> None:
    """Half its force off where new points touch by the way of the press before."""
    (long, few), (short, _) = capsule(1), capsule(4)
    assert np.linalg.norm(long - short) < 0.02 * np.linalg.norm(short)
    assert few <= 13  # 16 where it begins from the gel left behind


@pytest.fixture(scope="module")
def pressed() -> tuple[Problem, Memory, Run]:
    made = scene(Capsule(1.3, 2.6), poses(CORNERS), friction=0.6, edge=0.6)
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
