"""What scenes will cost: the sum is right on average, and in its range as often as it says."""

import math
from pathlib import Path

import numpy as np
import pytest

from tacgen.bundle.run_status import SceneStatus, Survey
from tacgen.report import estimate
from tacgen.report.estimate import Made


def test_a_range_holds_the_sum_nine_times_of_ten():
    rng, inside, ratio = np.random.default_rng(0), 0, []
    for _ in range(400):
        frames = rng.integers(5, 30, 60)
        seconds = frames * rng.gamma(8, 0.05, 60)
        known = [Made(int(f), float(s), 0.0) for f, s in zip(frames[:8], seconds[:8], strict=True)]
        found = estimate.cost([int(f) for f in frames[8:]], known)
        assert found is not None
        truth = seconds[8:].sum()
        inside += found.seconds.low <= truth <= found.seconds.high
        ratio.append(found.seconds.expected / truth)
    assert inside / 400 == pytest.approx(0.9, abs=0.05)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.02)


def test_one_scene_gives_no_range_and_none_no_cost():
    found = estimate.cost([10, 10], [Made(5, 2.0, 0.5)])
    assert found is not None
    assert found.seconds.expected == 8.0
    assert math.isnan(found.seconds.low)
    assert found.text(4) == "about 8 s of one core, 2 s with 4 workers; 2 GB; estimated from 1 scene"
    assert found.plain()["seconds"] == [8.0, None, None]
    assert estimate.cost([10], []) is None


def test_what_comes_once_is_no_scene_s_cost():
    assert estimate.work({"start": 1.0, "compile": 30.0, "mesh": 1.0, "solve": 2.0}) == 3.0


def test_what_is_left_of_a_folder_is_judged_by_what_is_there(tmp_path: Path):
    size = tmp_path / "scene-00000.h5"
    size.write_bytes(bytes(3000))
    made = [SceneStatus(f"scene-{i}", "ok", "", 4, size, {}, {"start": 9.0, "solve": 2.0}) for i in range(2)]
    waiting = [SceneStatus(f"scene-{i}", "waiting", "", 6, tmp_path / "none.h5") for i in range(2, 5)]
    found = estimate.left(Survey("many", tmp_path, (*made, *waiting)))
    assert found is not None
    assert found.seconds.expected == pytest.approx(9.0)
    assert found.gigabytes.expected == pytest.approx(13.5e-6)
    assert estimate.left(Survey("many", tmp_path, tuple(made))) is None
