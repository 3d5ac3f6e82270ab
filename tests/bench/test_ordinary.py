"""The bench of ordinary scenes: what is drawn, how each ending is told, and what the summary says of it."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import draws, half_edge, ordinary, results_page, summary
from benchmarks.reference_runs import row_of
from tacgen import mechanics
from tacgen.recipe import assets

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def found(own_cache: None) -> results_page.Result:
    return ordinary.bench("smoke", lambda text: None)


def rows(found: results_page.Result, title: str) -> list[dict[str, Any]]:
    table = next(table for table in found.tables if table.title == title)
    return [dict(zip(table.columns, row, strict=True)) for row in table.rows]


def measured(sets: tuple[str, ...] = draws.BALL.sets, limit: float = ordinary.LIMIT_S) -> ordinary.Outcome:
    """The ball, or the ball changed, on a coarse mesh."""
    return ordinary.measure(replace(draws.BALL, sets=sets), ordinary.SMOKE, False, limit)


def test_every_kind_is_drawn_as_often_as_it_should_be() -> None:
    every = [draws.drawn(i) for i in range(600)]
    assert every[7] == draws.drawn(7)  # alone as among others
    for name in draws.THICKNESS:
        assert np.mean([one.sensor == name for one in every]) == pytest.approx(1 / 3, abs=0.06)
    assert {one.shape for one in every} == {*draws.KINDS, *draws.OBJECTS} - {"mesh"}
    assert np.mean([one.shape in draws.OBJECTS for one in every]) == pytest.approx(0.2, abs=0.05)
    assert np.mean([one.shape == "sphere" for one in every]) == pytest.approx(0.2, abs=0.05)
    path = [one.sets[1] for one in every]
    assert np.mean(["release" in text for text in path]) == pytest.approx(0.3, abs=0.06)
    moves = [re.findall("slide|twist|tilt", text) for text in path]
    assert np.bincount([len(names) for names in moves]) / 600 == pytest.approx(1 / 3, abs=0.06)
    assert np.mean([name == "slide" for names in moves for name in names]) == pytest.approx(0.5, abs=0.07)


def test_draws_are_recipes_within_the_ranges() -> None:
    for draw in map(draws.drawn, range(40)):
        recipe = row_of((f"sensor={draw.sensor}", "outputs=[force]", *draw.sets)).recipe
        first, *others = recipe.trajectory
        assert first.press is not None
        assert 0.099 <= first.press.depth_mm / draws.THICKNESS[draw.sensor] <= 0.351
        assert 3 <= first.frames <= 5
        assert 0.2 <= recipe.contact.friction <= 1
        assert max(abs(recipe.start.x_mm), abs(recipe.start.y_mm)) <= 3
        for step in others:
            if step.slide:
                assert 0.299 <= np.hypot(step.slide.x_mm, step.slide.y_mm) <= min(3, 0.35 * step.frames) + 0.002
            elif step.twist:
                assert 3 <= step.twist.angle_deg <= min(30, 5 * step.frames) + 0.05
            elif step.tilt:
                assert 1 <= step.tilt.angle_deg <= min(5, 1.5 * step.frames) + 0.05
            else:
                assert step is others[-1]
                assert step.release is not None


def test_sensors_and_objects_are_those_that_are_shipped() -> None:
    for name, thickness in draws.THICKNESS.items():
        gel = row_of((f"sensor={name}", "outputs=[force]")).sensor.gel
        crown = sum(layer.thickness_mm for layer in gel.layers)
        assert crown == pytest.approx(thickness) if gel.dome is None else crown > thickness
    assert set(draws.OBJECTS) == {path.name for path in assets.mesh_path("gear").parents[1].iterdir() if path.is_dir()}


@pytest.mark.slow
def test_a_smoke_run_fills_every_table(found: results_page.Result) -> None:
    together = rows(found, "Together")
    drawn, *kinds, ball = together
    assert (drawn["scenes of"], drawn["scenes"], ball["scenes"]) == ("ordinary", 2, 1)
    assert sum(kind["scenes"] for kind in kinds) == 2
    for row in together:
        assert row["ok"] == row["scenes"]
        assert 0 < row["s a frame, mean"] == pytest.approx(3.6e-3 * row["core-hours a million"])
    for row in (drawn, ball):
        assert 0 < row["s a frame, p50"] <= row["s a frame, p90"] <= row["s a frame, p99"]
        assert 1 < row["iterations, p50"] < 30
        assert 0 < row["least J"] < 1
        assert row["J <= 0"] == 0
        assert 0 < row["force error, median"] <= row["force error, worst"] < 0.1
    assert sum(row["scenes"] for row in rows(found, "By shape")) == 2
    assert sum(row["ok"] for row in rows(found, "By sensor")) == 2
    assert rows(found, "What failed") == []


@pytest.mark.slow
def test_the_summary_says_seconds_of_ordinary_scenes(found: results_page.Result, tmp_path: Path) -> None:
    results_page.write(tmp_path, "ordinary", found, 1.0)
    told = summary.short(tmp_path)
    assert f"| 2 ordinary scenes at `{ordinary.SMOKE}`, a core each, solve alone | 2 ok; seconds a frame: mean " in told
    figures = r"mean \d\.\d\d, median \d\.\d\d, 90 % quantile \d\.\d\d; \d+% of the frames unique"
    assert re.search(figures + r"; a million frames \d+ core-hours \| ordinary \|", told)


def test_an_impossible_scene_is_refused() -> None:
    ended = measured((*draws.BALL.sets, "trajectory=[{press: {depth_mm: 9, frames: 2}}]"))
    assert (ended.status, ended.frames) == ("refused", 0)
    assert "depth_mm" in ended.reason


def test_a_scene_that_takes_too_long_is_stopped_after_a_frame() -> None:
    ended = measured(limit=0)
    assert (ended.status, ended.reason, ended.frames) == ("out of time", "after frame 1 of 8", 1)
    assert measured((*draws.BALL.sets, "trajectory=[{press: {depth_mm: 0.3, frames: 1}}]"), limit=0).status == "ok"


def test_a_frame_without_a_solution_rejects_the_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    states = mechanics.states

    def ends(*args: Any) -> Iterator[mechanics.State]:
        yield next(states(*args))
        raise mechanics.NotConverged(mechanics.Failure.singular)

    monkeypatch.setattr(mechanics, "states", ends)
    ended = measured()
    assert (ended.status, ended.reason, ended.frames) == ("rejected", f"frame 2 of 8: {mechanics.Failure.singular}", 1)


@pytest.mark.slow
def test_a_bug_in_one_scene_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(draw: draws.Draw, quality: str, *how: Any, **more: Any) -> ordinary.Outcome:
        if draw.index == 0:
            raise IndexError("out of bounds")
        return ordinary.Outcome(draw, quality, "ok", frames=3, seconds=0.3, stable=3)

    monkeypatch.setattr(ordinary, "measure", breaks)
    found = ordinary.bench("smoke", lambda text: None)
    together = rows(found, "Together")[0]
    assert (together["ok"], together["crashed"]) == (1, 1)
    (failed,) = rows(found, "What failed")
    assert (failed["scene"], failed["status"], failed["reason"]) == (0, "crashed", "IndexError: out of bounds")
    assert np.isfinite(together["s a frame, p90"])


def test_an_inverted_element_is_listed_and_fails_though_the_scene_is_ok() -> None:
    folded = ordinary.Outcome(draws.BALL, "draft", "ok", frames=3, least_J=-0.1)
    assert ordinary._summary("ball", [folded])[-6:-3] == [-0.1, 1, 0]
    (failed,) = ordinary._failed([folded, replace(folded, least_J=0.2)]).rows
    assert failed[-2:] == ["ok", "least certified J -0.100"]


def test_the_mean_is_what_a_set_costs_and_objects_stand_apart() -> None:
    long = ordinary.Outcome(draws.BALL, "draft", "ok", frames=9, seconds=0.9, stable=9)
    short = replace(long, draw=replace(draws.BALL, shape="key"), frames=1, seconds=2.1, stable=0)
    late = replace(short, status="out of time", seconds=150.0)
    assert ordinary._mean([long, short, late]) == pytest.approx(0.3)
    named = dict(ordinary._kinds([long, short, late]))
    assert (named["shapes"], named["objects"]) == ([long], [short, late])
    summary_of_all = ordinary._summary("ordinary", [long, short, late])
    assert 0.3 in [pytest.approx(cell) for cell in summary_of_all if isinstance(cell, float)]


def test_forces_are_compared_where_both_paths_have_been() -> None:
    long = np.array([[0, 0, -1.0], [0, 0, -2.0], [0, 0, -9.0]])
    short = np.repeat([[0, 0, -1.1], [0, 0, -2.0]], ordinary.FINER, axis=0)  # the third frame was not reached
    assert ordinary._force_error(long, short) == pytest.approx(0.1 / 2)
    assert ordinary._force_error(long, short[:2]) is None
    assert ordinary._force_error(long[:1], short) == pytest.approx(0.1 / 2)


@pytest.mark.slow
def test_frames_from_an_instability_on_are_told() -> None:
    """A rough cone drags the gel with it until that folds and slips: later forces depend on the step size."""
    moves = "trajectory=[{press: {depth_mm: 0.651, frames: 2}}, {slide: {x_mm: 1.1, y_mm: -0.85, frames: 4}}]"
    shape = "indenter={shape: cone, half_angle_deg: 62.7, tip_radius_mm: 1.033}"
    place = ("start={x_mm: 2.43, y_mm: 1.24}", "contact.friction=0.995")
    cone = ordinary.measure(replace(draws.BALL, sensor="digit", sets=(shape, moves, *place)), "draft", False)
    assert (cone.status, cone.frames) == ("ok", 6)
    assert 3 <= cone.stable < 6
    ball = ordinary.measure(draws.BALL, ordinary.SMOKE, False)
    assert ball.stable == ball.frames


def test_errors_against_half_the_edge_are_told_by_shape() -> None:
    found = [half_edge.Compared("box", 0.02, 0.03), half_edge.Compared("box", 0.05, 0.03)]
    found += [half_edge.Compared("key", 0.10, 0.04), half_edge.Compared("key", float("nan"), float("nan"))]
    told = half_edge.table(found)
    assert [row[:2] for row in told.rows] == [["all", 3], ["box", 2], ["key", 1]]
    assert told.rows[0][-2:] == pytest.approx([1 / 3, 2 / 3])
    assert "1 of 4" in told.note
