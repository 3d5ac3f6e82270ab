"""Trajectories: a force is reached and its depth kept, closed paths of movements return."""

from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.small_recipe import HEAD
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tacgen import mechanics
from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.geometry.analytic_sdf import BoxSdf, ConeSdf, Shape, SphereSdf
from tacgen.geometry.pose import Pose
from tacgen.mechanics import frames, mesh, presolve
from tacgen.mechanics.force_control import End, meet
from tacgen.recipe import plan, scene_of_row, trajectory_poses
from tacgen.recipe.row import Row
from tacgen.recipe.trajectory import Press, Segment, Start

BOX = "indenter={shape: box, size_x_mm: 4, size_y_mm: 3, fillet_mm: 0.3}"
ROUGH = "contact.friction=0.5"
SHAPES: tuple[Shape, ...] = (SphereSdf(4.0), BoxSdf(3.0, 2.0, 0.3), ConeSdf(float(np.radians(30)), 0.5))


def row(folder: Path, segments: str, *sets: str) -> Row:
    path = folder / "recipe.yaml"
    path.write_text(HEAD + "".join(f"  - {line.strip()}\n" for line in segments.strip().splitlines()))
    return plan.load(path, sets).rows[0]


def solved(made: Row) -> list[mechanics.State]:
    built = presolve.presolved(scene_of_row.build(made))
    grid = mesh.build(built.gel, mesh.footprint(built), built.edge)
    return list(mechanics.states(built, mechanics.Problem.of(built, grid)))


@pytest.mark.parametrize("sets", [(), (BOX, ROUGH)])
def test_a_force_is_reached_in_equal_steps_and_its_depth_kept(tmp_path: Path, sets: tuple[str, ...]) -> None:
    segments = "press: {force_n: 2.0, frames: 2}\nslide: {x_mm: 0.2, frames: 1}\nrelease: {frames: 2}"
    found = solved(row(tmp_path, segments, *sets))
    force = [mechanics.normal_force(state) for state in found]
    assert force[0] == pytest.approx(1.0, rel=0.0101)
    assert force[1] == pytest.approx(2.0, rel=0.005)
    z = [state.pose[2, 3] for state in found]
    assert z[1] < z[0] < 0
    assert z[2] == z[1]
    assert z[3:] == pytest.approx([z[1] / 2, 0], abs=1e-12)
    assert force[4] == pytest.approx(0, abs=0.02)


def test_a_slide_and_a_twist_hold_a_force(tmp_path: Path) -> None:
    """Otherwise they would keep their height, and bear some percent less."""
    moves = """press: {force_n: 1, frames: 1}
    slide: {x_mm: 1, force_n: 1, frames: 2}
    twist: {angle_deg: 20, force_n: 1.4, frames: 2}"""
    found = solved(row(tmp_path, moves, "contact.friction=0.8"))
    force = [mechanics.normal_force(state) for state in found]
    assert force == pytest.approx([1, 1, 1, 1.2, 1.4], rel=0.0101)
    assert force[2] == pytest.approx(1, rel=3e-3)
    assert force[4] == pytest.approx(1.4, rel=3e-3)
    heights = [state.pose[2, 3] for state in found]
    assert abs(heights[2] - heights[0]) > 1e-3
    assert [state.pose[0, 3] for state in found] == pytest.approx([0, 0.5, 1, 1, 1])


def test_the_depth_found_gives_the_force_again(tmp_path: Path) -> None:
    """With friction as well: the trials left nothing behind."""
    built = presolve.presolved(scene_of_row.build(row(tmp_path, "press: {force_n: 1.5, frames: 1}", ROUGH)))
    problem = mechanics.Problem.of(built, mesh.build(built.gel, mesh.footprint(built), built.edge))
    found = next(mechanics.states(built, problem))
    again = next(mechanics.states(replace(built, poses=found.pose[None], forced=None), problem))
    assert mechanics.normal_force(again) == pytest.approx(mechanics.normal_force(found), rel=5e-3)


def test_a_second_force_may_be_smaller_and_a_depth_may_follow(tmp_path: Path) -> None:
    segments = "press: {force_n: 2, frames: 1}\npress: {force_n: 1, frames: 1}\npress: {depth_mm: 0.3, frames: 2}"
    found = solved(row(tmp_path, segments))
    assert [mechanics.normal_force(state) for state in found[:2]] == pytest.approx([2, 1], rel=0.005)
    z = [state.pose[2, 3] for state in found]
    assert z[0] < z[1] < 0
    assert z[2:] == pytest.approx([(z[1] - 0.3) / 2, -0.3], abs=1e-12)


def test_a_force_the_gel_cannot_give_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (trajectory_poses, frames, presolve):
        monkeypatch.setattr(module, "MAX_FORCE_SEARCH_DEPTH", 0.2)
    found = pipeline.run_scene(row(tmp_path, "press: {force_n: 500, frames: 1}"), tmp_path / "out")
    assert found.status == "rejected"
    assert found.reason.startswith("frame 1 of 1: 500 N asked for, and 20% of the gel's thickness gives ")
    assert bundle.read(found.path).frames == 0


@pytest.mark.slow
def test_an_absurd_force_is_refused_on_the_coarse_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And what comes before it is kept."""
    segments = "press: {depth_mm: 0.3, frames: 1}\npress: {force_n: 500, frames: 1}\nrelease: {frames: 1}"
    solved_on, usual = [], frames.to_pose

    def watched(problem, *rest, **how):  # type: ignore[no-untyped-def]
        solved_on.append(problem.edge)
        return usual(problem, *rest, **how)

    monkeypatch.setattr(frames, "to_pose", watched)
    found = pipeline.run_scene(row(tmp_path, segments, "quality.edge_mm=0.65"), tmp_path / "out")
    assert found.status == "rejected"
    assert found.reason.startswith("frame 2 of 3: 500 N asked for, and 80% of the gel's thickness gives ")
    assert found.reason.endswith(" N, as a coarse mesh has it")
    assert bundle.read(found.path).frames == 1
    assert solved_on.count(0.65) == 1


def test_a_coarse_solve_ends_with_the_last_force_and_a_tolerance_may_be_given(tmp_path: Path) -> None:
    moves = "press: {force_n: 1, frames: 1}\nslide: {x_mm: 0.2, frames: 1}"
    rough = presolve.rough(scene_of_row.build(row(tmp_path, moves, "quality.edge_mm=1.5")))
    problem = mechanics.Problem.of(rough, mesh.of(rough))
    assert len(list(mechanics.states(rough, problem))) == 1
    assert rough.forced is not None
    fine = replace(rough, forced=replace(rough.forced, tol=1e-6))
    (found,) = mechanics.states(fine, problem)
    assert mechanics.normal_force(found) == pytest.approx(1, rel=1e-6)


def test_a_force_asked_for_on_several_sensors_is_met_more_closely_in_every_frame(tmp_path: Path) -> None:
    one = row(tmp_path, "press: {force_n: 1, frames: 2}")
    alone, paired = (scene_of_row.build(each).forced for each in (one, replace(one, pair=0)))
    assert alone is not None
    assert paired is not None
    assert (alone.tol, paired.tol) == (None, 2e-3)


def test_what_follows_a_force_goes_on_from_its_depth(tmp_path: Path) -> None:
    """Held, slid askew, twisted and lifted: the depth that was found is kept until the release, at the poses asked."""
    segments = """
        press: {force_n: 1.0, frames: 1}
        hold: {frames: 1}
        slide: {x_mm: -0.2, y_mm: 0.15, frames: 2}
        twist: {angle_deg: 12, frames: 1}
        release: {frames: 2}
    """
    found = solved(row(tmp_path, segments, ROUGH))
    at = np.array([state.pose[:3, 3] for state in found])
    z = at[0, 2]
    assert at[:, 2] == pytest.approx([z, z, z, z, z, z / 2, 0], abs=1e-12)
    assert at[:, :2] == pytest.approx(np.outer([0, 0, 0.5, 1, 1, 1, 1], [-0.2, 0.15]), abs=1e-12)
    held, slid = found[1].traction_force.sum((0, 1)), found[3].traction_force.sum((0, 1))
    assert held == pytest.approx(found[0].traction_force.sum((0, 1)), abs=0.01)
    assert slid[:2] / np.linalg.norm(slid[:2]) == pytest.approx([-0.8, 0.6], abs=0.03)  # dragged along
    assert np.linalg.norm(slid[:2]) > 0.2
    assert found[4].pose[:2, 0] == pytest.approx([np.cos(np.radians(12)), np.sin(np.radians(12))])
    assert np.abs(found[6].traction_force.sum((0, 1))).max() < 0.02


@pytest.mark.parametrize("axis", [0.0, 90.0])
def test_a_press_after_a_tilt_on_a_dome_counts_from_its_first_touch(tmp_path: Path, axis: float) -> None:
    """Of a box, whose edge leads when it leans: raised by the depth, it touches DIGIT's face at one place."""
    sets = ("sensor=digit", "start.y_mm=3", BOX)
    segments = f"tilt: {{angle_deg: 15, axis_deg: {axis}, frames: 1}}\npress: {{depth_mm: 0.4, frames: 1}}"
    made = scene_of_row.build(row(tmp_path, segments, *sets))
    x, y = np.meshgrid(np.linspace(-6, 6, 241), np.linspace(-3, 9, 241))
    face = np.stack([x, y, made.gel.top(x, y)], -1).reshape(-1, 3)
    raised = made.poses[1].copy()
    raised[2, 3] += 0.4
    gap = made.shape.distance(Pose.of(raised).local(face))[0].min()
    assert -1e-3 < gap < 3e-3
    sunk = made.shape.distance(Pose.of(made.poses[1]).local(face))[0].min()
    assert -0.4 <= sunk < -0.3


@pytest.mark.parametrize(
    ("sets", "line"),
    [
        (("start.tilt_deg=50",), "--set start.tilt_deg=50: start.tilt_deg: the indenter's flank would meet the gel"),
        ((), "recipe.yaml:10:23: trajectory[1].tilt.angle_deg: the indenter's flank would meet the gel before its tip"),
    ],
)
def test_a_tilt_that_cannot_be_is_reported_where_it_stands(tmp_path: Path, sets: tuple[str, ...], line: str) -> None:
    cone = "indenter={shape: cone, half_angle_deg: 60, tip_radius_mm: 0.5}"
    with pytest.raises(UserError) as caught:
        row(tmp_path, "press: {depth_mm: 1.0, frames: 1}\ntilt: {angle_deg: 40, frames: 1}", cone, *sets)
    assert caught.value.lines[0].removeprefix(f"{tmp_path}/").startswith(line)


def test_of_a_mesh_that_tilts_only_its_file_knows_the_lowest_point(tmp_path: Path) -> None:
    """Which it is then turned about: until the file is read, nothing is said of where that leads."""
    tilts = "tilt: {angle_deg: 5, frames: 1}\ntilt: {angle_deg: 5, frames: 1}\nslide: {x_mm: 1, frames: 1}"
    assert row(tmp_path, tilts, "indenter={shape: mesh, file: gear}").frames == 3


def test_the_footprint_holds_what_a_force_may_need(tmp_path: Path) -> None:
    made = scene_of_row.build(row(tmp_path, "press: {force_n: 1, frames: 1}"))
    sure, seen = mesh.footprint(made), mesh.footprint(presolve.presolved(made))
    assert sure[0] < seen[0] < -1
    assert seen[1] - seen[0] < 0.8 * (sure[1] - sure[0])


def test_a_tilt_turns_about_the_point_that_is_lowest_at_the_start(tmp_path: Path) -> None:
    segments = "press: {depth_mm: 0.5, frames: 1}\ntilt: {angle_deg: 8, axis_deg: 90, frames: 2}"
    poses = scene_of_row.build(row(tmp_path, segments)).poses
    for pose, angle in zip(poses[1:], np.radians([4, 8]), strict=True):
        assert pose[:3, 3] == pytest.approx([0, 0, -0.5], abs=1e-9)
        assert pose[:3, 2] == pytest.approx([np.sin(angle), 0, np.cos(angle)], abs=1e-12)
    lean = "start={tilt_deg: 8, tilt_axis_deg: 90}"
    leaning = scene_of_row.build(row(tmp_path, f"{segments}\nslide: {{x_mm: 1, frames: 1}}\n{segments}", lean)).poses
    tip = [4 * np.sin(np.radians(8)), 0, 4 - 4 * np.cos(np.radians(8)), 1]  # of the ball, in its own frame
    assert (leaning[2] @ tip)[:3] == pytest.approx((leaning[0] @ tip)[:3], abs=1e-6)
    assert (leaning[-1] @ tip)[:3] == pytest.approx((leaning[-3] @ tip)[:3], abs=1e-6)


angles = st.floats(-12, 12)
there = st.one_of(
    st.tuples(st.just("tilt"), angles, st.floats(0, 360)),
    st.tuples(st.just("twist"), st.floats(-90, 90)),
    st.tuples(st.just("slide"), st.floats(-1, 1), st.floats(-1, 1)),
)
KEYS = {"tilt": ("angle_deg", "axis_deg"), "twist": ("angle_deg",), "slide": ("x_mm", "y_mm")}


def back(move: tuple[Any, ...]) -> tuple[Any, ...]:
    kind, *numbers = move
    return kind, -numbers[0], *(numbers[1:] if kind == "tilt" else [-y for y in numbers[1:]])


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(SHAPES), st.floats(0, 10), st.floats(-180, 180), st.lists(there, min_size=1, max_size=4))
@example(BoxSdf(3.0, 3.0, 0.3), 0.0, 0.0, [("tilt", 10.0, 0.0)])
def test_a_closed_path_returns_to_its_pose(shape: Shape, lean: float, yaw: float, moves: list[tuple[Any, ...]]) -> None:
    def contact(pose: np.ndarray) -> float:
        return shape.support(-pose[2, :3])

    start = Start(tilt_deg=lean, tilt_axis_deg=30, yaw_deg=yaw, x_mm=0.3)
    walk = trajectory_poses.Walk.at_start(start, (), shape.support, contact, lambda _: 0.0, 50.0)

    def go(kind: str, *numbers: float) -> None:
        step = Segment.model_validate({kind: dict(zip(KEYS[kind], numbers, strict=True)) | {"frames": 2}})
        list(walk.frames(step, (), ("trajectory",)))

    list(walk.frames(Segment(press=Press(depth_mm=1, frames=1)), (), ("trajectory",)))
    before = walk.pose
    for move in (*moves, *map(back, reversed(moves))):
        go(*move)
    assert walk.pose == pytest.approx(before, abs=1e-9)


def test_a_tilted_box_turns_about_the_middle_of_its_face_and_must_not_reach_the_base(tmp_path: Path) -> None:
    press = "press: {depth_mm: 1.0, frames: 1}\n"
    poses = scene_of_row.build(row(tmp_path, press + "tilt: {angle_deg: 10, frames: 1}", BOX)).poses
    assert poses[-1][:3, 3] == pytest.approx([0, 0, -1.0], abs=1e-9)
    wide = "indenter={shape: box, size_x_mm: 16, size_y_mm: 16, fillet_mm: 0.3}"
    with pytest.raises(UserError, match=r"trajectory\[1\].tilt.angle_deg: would turn the indenter's edge to the base"):
        scene_of_row.build(row(tmp_path, press + "tilt: {angle_deg: 40, frames: 1}", wide))


@pytest.mark.parametrize("power", [0.5, 1.0, 1.5, 4.0])
@pytest.mark.parametrize("guess", [0.01, 0.5, 2.9])
def test_a_rising_function_is_met_in_few_evaluations(power: float, guess: float) -> None:
    seen: list[float] = []

    def f(u: float) -> float:
        seen.append(u)
        return u**power if u < 2.5 else float("nan")

    assert searched(f, 1.3, known=(0, 0), guess=guess, low=0, high=3) is End.met
    assert seen[-1] ** power == pytest.approx(1.3, rel=1e-3)
    assert len(seen) < 16
    assert searched(f, 0.2, known=(1, 1), guess=guess, low=0, high=3) is End.met
    assert seen[-1] ** power == pytest.approx(0.2, rel=1e-3)
    assert searched(lambda u: u, 5, known=(0, 0), guess=0.1, low=0, high=2) is End.out_of_reach
    assert searched(lambda u: None, 5, known=(0, 0), guess=0.1, low=0, high=2) is End.stopped
    assert searched(lambda u: float(u > 1), 0.5, known=(0, 0), guess=0.1, low=0, high=2) is End.not_found


def searched(f: Callable[[float], float | None], target: float, **how: Any) -> End:
    """How a search ends, of which each evaluation needs two things done."""

    def asking(u: float) -> Generator[float, None, float | None]:
        yield from (u, u)
        return f(u)

    search, asked = meet(asking, target, tol=1e-3, **how), list[float]()
    while True:
        try:
            asked.append(next(search))
        except StopIteration as end:
            assert asked[::2] == asked[1::2]
            return End(end.value)
