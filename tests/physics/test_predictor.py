"""What a load step begins from: the gel carried along with the indenter. Long steps and short ones come to the same."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.presses import Run, poses, run, scene
from helpers.solves import advance

from benchmarks.cases import PLAIN
from benchmarks.reference_runs import row_of
from tacgen.geometry.analytic_sdf import CapsuleSdf
from tacgen.geometry.pose import Pose, shortest_turn
from tacgen.mechanics import DEFAULT_OPTIONS, Problem, SolverOptions, mesh, states
from tacgen.mechanics.course import Course, Leg
from tacgen.mechanics.one_scene import OneScene
from tacgen.mechanics.phases import Phase
from tacgen.mechanics.predictor import Prediction
from tacgen.mechanics.solver import go_on
from tacgen.mechanics.state import History
from tacgen.recipe import scene_of_row

Array = np.ndarray
SQUARE = (-2.5, 2.5, -2.5, 2.5)
WHOLE = SolverOptions(slide=np.inf, slide_sharp=np.inf)
CORNERS = [(0.0, 0.0, -0.8), (1.0, 0.4, -0.8)]  # pressed and slid


def capsule(parts: int, options: SolverOptions = DEFAULT_OPTIONS) -> tuple[Array, int]:
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
    made = scene_of_row.build(row_of((*PLAIN, *sets)))
    found = list(states(made, Problem.of(made, mesh.of(made), options)))
    return found[-1].traction_force.sum((0, 1)), sum(state.iterations for state in found)


@pytest.mark.slow
def test_a_long_slide_in_one_load_step_ends_where_short_frames_do() -> None:
    """Half its force off where new points touch by the way of the press before; 1.1 % here, and as near where steps
    begin from the gel left behind."""
    short, _ = capsule(4)
    for options in (WHOLE, replace(WHOLE, predict=False)):
        long, _ = capsule(1, options)
        assert np.linalg.norm(long - short) < 0.02 * np.linalg.norm(short)


@pytest.fixture(scope="module")
def pressed() -> tuple[Problem, History, Run]:
    made = scene(CapsuleSdf(1.3, 2.6), poses(CORNERS), friction=0.6, edge=0.6)
    whole = run(made, SQUARE)
    first = Problem.of(made, whole.problem.mesh)
    start, end = made.start, made.poses[0]
    turn = shortest_turn(start, end)
    return first, advance(first, first.rest(Pose.of(start)), start, end, turn, 0, 0.0).history, whole


def predicted(problem: Problem, history: History, pose: Pose) -> Prediction | None:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.position
    scene = OneScene(problem, Course(0, history, (Leg(matrix, matrix, np.zeros(3), 0.0),)))
    go_on(scene, until=Phase.start)
    return scene.prediction


def test_points_in_contact_go_along_and_all_else_follows(pressed: tuple[Problem, History, Run]) -> None:
    problem, history, whole = pressed
    pose = Pose.of(whole.scene.poses[1])
    found = predicted(problem, history, pose)
    assert found is not None
    x = found.x
    faces = problem.contact.faces
    firm = history.normal_force > 0.1 * history.normal_force.max()
    gone = pose.local(faces.at(x))[firm] - history.pose.local(faces.at(history.x))[firm]
    assert np.abs(gone).max() < 0.02 * np.linalg.norm(pose.position - history.pose.position)
    moved = np.linalg.norm(x - history.x, axis=1)
    assert moved.max() < 1.02 * np.linalg.norm(pose.position - history.pose.position)
    assert not moved[problem.mesh.points[:, 2] == problem.mesh.points[:, 2].min()].any()  # it is bonded there


def test_a_kept_tangent_and_a_new_one_carry_alike(pressed: tuple[Problem, History, Run]) -> None:
    problem, history, whole = pressed
    pose = Pose.of(whole.scene.poses[1])
    assert problem.tangent.usable
    kept = predicted(problem, history, pose)
    other = replace(problem)
    assert not other.tangent.usable
    new = predicted(other, history, pose)
    assert other.tangent.condensation.factored == 1
    assert kept is not None
    assert new is not None
    assert np.abs(kept.x - new.x).max() < 0.15 * np.abs(new.x - history.x).max()  # it is of a gel less deformed


def test_where_nothing_touches_nothing_is_carried(pressed: tuple[Problem, History, Run]) -> None:
    problem, _, whole = pressed
    rest = problem.rest(Pose.of(whole.scene.start))
    assert predicted(problem, rest, Pose.of(whole.scene.poses[0])) is None
