"""Episodes go through intervals, recipes and the batch engine, and come back as labels of their own rows."""

from pathlib import Path

import numpy as np
import pytest

from tacgen import batch
from tacgen.bundle.resume import SceneResult
from tacgen.touch import labels, plan_text, scenes
from tacgen.touch.episode import Touch
from tacgen.touch.intervals import Rate
from tacgen.touch.scenes import TouchChoice, TouchScenes
from touch.made_source import COARSE, FINGER, Made, ball, episode, over

Labelled = tuple[TouchScenes, list[SceneResult], list[list[Touch]]]
GAPS = [60.0, 9.0, 0.6, -0.2, -0.4, -0.4, 0.5, 12.0, 40.0, 40.0]
SHIFT = [0.0, 0.0, 0.0, 0.0, 0.0, 1.5, 1.5, 0.0, 0.0, 0.0]  # in the last row of contact it has slid


def solved(source: Made, folder: Path, asked: TouchChoice) -> tuple[TouchScenes, list[SceneResult]]:
    from tacgen.batch import pipeline

    prepared = scenes.prepare(source, [FINGER], asked, folder)
    return prepared, pipeline.run(prepared.plan.rows, folder)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Labelled:
    force = np.zeros((len(GAPS), 3))
    force[3:6, 2] = -3.0
    force[8, 2] = -1.0
    touched = episode({"ball": over(GAPS, SHIFT)}, 0, forces=force)
    free = episode({"ball": over([30.0] * 3)}, 2)
    source = Made([touched, "episode 1: rows are missing", free], [ball("ball", 0.02)])
    folder = tmp_path_factory.mktemp("touch")
    prepared, results = solved(source, folder, TouchChoice(rate=Rate(20.0), sets=COARSE))
    return prepared, results, labels.felt(prepared, results)


def test_labels_stand_at_the_rows_of_the_episode(made: Labelled) -> None:
    prepared, results, (first, _) = made
    (touch,) = first
    assert prepared.notes == ("episode 1: rows are missing",)
    assert touch.touched == [""] * 3 + ["ball"] * 3 + [""] * 4
    assert (touch.force[[0, 1, 2, 6, 7, 8, 9]] == 0).all()
    normal = -touch.force[:, 2]
    assert 0 < normal[3] < normal[4]
    assert touch.correction == pytest.approx(np.zeros(10), abs=1e-9)
    assert touch.moved.tolist() == [False] * 5 + [True] + [False] * 4
    assert ((touch.error > 0) == touch.contact).all()
    assert touch.engine == pytest.approx([0, 0, 0, 3, 3, 3, 0, 0, 1, 0])
    assert touch.note[8] == "the engine has ball press on hand, but not on its gel"
    assert set(touch.note) - {touch.note[8]} == {""}
    assert [result.frames for result in results] == [scenes.UNTOUCHED_FRAMES, 15]
    height = prepared.episodes[0].bodies["ball"][:, 2, 3]
    assert (touch.lifted <= touch.contact).all()
    assert touch.lifted[5] == (height[5] > height[0] + labels.MIN_LIFTED_MM)


def test_pictures_and_markers_are_untouched_in_between(made: Labelled) -> None:
    _, results, ((touch,), (free,)) = made
    still, contact = results[0].bundles[0], results[1].bundles[0]
    assert (touch.image(8) == still.frame("/frames/rgb", 8 % scenes.UNTOUCHED_FRAMES)).all()
    assert (touch.image(4) == contact.frame("/frames/rgb", 8)).all()  # two frames a row
    assert touch.markers is not None
    assert touch.markers[9] == pytest.approx(still["/reference/markers"])
    assert np.abs(touch.markers[5] - touch.markers[9]).max() > 0.05
    assert free.touched == [""] * 3
    assert not free.force.any()


def test_forces_beside_the_engines(made: Labelled) -> None:
    prepared, _, touches = made
    (one,) = plan_text.engine_table(prepared.episodes, touches)
    normal = -touches[0][0].force[3:6, 2]
    assert one["engine_n"] == 3
    assert one["ratio"] == pytest.approx(np.median(3 / normal))
    assert "engine / tacgen" in plan_text.engine_lines([one])[1]


def test_frames_that_are_too_deep_are_said_and_those_before_are_solved(tmp_path: Path) -> None:
    source = Made([episode({"ball": over([9.0, 0.5, -0.3, -5.0, -0.3, 9.0])})], [ball("ball")])
    prepared, results = solved(source, tmp_path, TouchChoice(sets=COARSE))
    ((touch,),) = labels.felt(prepared, results)
    assert touch.touched == ["", "", "ball", "ball", "ball", ""]
    assert np.isfinite(touch.force[:3]).all()
    assert np.isnan(touch.force[3:]).all()
    assert touch.note[:3] == [""] * 3
    assert all("base of the gel" in note for note in touch.note[3:])
    assert not touch.image(3).any()
    assert touch.image(2).any()


def test_a_scene_that_ends_early_or_fails_is_said(made: Labelled) -> None:
    from dataclasses import replace

    prepared, results, _ = made
    failed = replace(results[1], status="failed", reason="out of memory", path=Path("nowhere"), bundles=())
    ((touch,), _) = labels.felt(prepared, [results[0], failed])
    assert touch.note[:8] == ["not solved: out of memory"] * 8
    assert np.isnan(touch.force[:8]).all()
    assert touch.touched == [""] * 3 + ["ball"] * 3 + [""] * 4
    assert not touch.force[8:].any()


def test_a_run_of_a_part_is_resumed(tmp_path: Path, kept_workers: None) -> None:
    source = Made([episode({"ball": over(GAPS)}, k) for k in range(2)], [ball("ball")])
    prepared = scenes.prepare(source, [FINGER], TouchChoice(sets=COARSE), tmp_path)
    part = scenes.shard(prepared.plan, (1, 2))
    assert [row.name for row in part.rows] == ["scene-00001"]
    batch.run(part, tmp_path, shard=(1, 2))
    events: list[dict] = []
    again = scenes.prepare(source, [FINGER], TouchChoice(sets=COARSE), tmp_path)
    results = batch.run(again.plan, tmp_path, on_event=events.append)
    assert [result.status for result in results] == ["ok"] * 3
    assert {event["scene"] for event in events if event["event"] == "frame"} == {"scene-00000", "scene-00002"}
