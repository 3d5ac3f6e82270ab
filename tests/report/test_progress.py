"""What scenes will cost, right on average and in its range as often as it says; and the progress of a run."""

import io
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from tacgen.bundle.run_status import SceneStatus, Survey
from tacgen.report import estimate
from tacgen.report.estimate import Made
from tacgen.report.progress import COMPILING, Progress


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


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def frame(scene: str, k: int) -> dict[str, object]:
    return {"event": "frame", "scene": scene, "frame": k, "frames": 4}


def end(scene: str, status: str = "ok", reason: str = "", **seconds: float) -> dict[str, object]:
    return {"event": "scene", "scene": scene, "status": status, "reason": reason, "frames": 4, "seconds": seconds}


def shown(scenes: int, *events: dict[str, object], stream: io.StringIO | None = None, noted: Iterable[str] = ()) -> str:
    """What a stream gets of a run of scenes of four frames."""
    stream = stream or io.StringIO()
    with Progress(scenes, 4 * scenes, stream, noted) as progress:
        for event in events:
            progress(event)
    return stream.getvalue()


RUN = (
    frame("scene-00000", 2),
    frame("scene-00001", 2),
    {"event": "retry", "scene": "scene-00001", "reason": "its worker [1] was killed"},
    end("scene-00000", "rejected", "stalled [here]", solve=1.0),
    end("scene-00001", solve=1.0),
)


def test_a_line_a_scene_where_there_is_no_terminal_and_a_frame_where_there_is_one_scene():
    lines = shown(2, *RUN).splitlines()
    assert lines[0].startswith("scene-00001: once more: its worker [1] was killed (about ")
    assert lines[1].startswith("scene-00000: rejected: stalled [here] (about ")
    assert lines[2:] == ["scene-00001: ok"]
    said = shown(1, frame("scene-00000", 1), frame("scene-00000", 3), end("scene-00000", solve=1.0)).splitlines()
    assert (said[0], said[-1]) == ("scene-00000: frame 1 of 4", "scene-00000: ok")
    assert said[1].startswith("scene-00000: frame 3 of 4 (about ")


def test_notes_are_reported_once_and_not_again_what_was_said_while_the_recipe_was_read():
    assert shown(2, {"event": "compiling", "scene": "scene-00001"}, noted=[COMPILING]) == ""
    notes = ({"event": "note", "scene": f"scene-0000{k}", "note": "its edges are sharp"} for k in range(2))
    assert shown(2, *notes) == "scene-00000: note: its edges are sharp\n"


def test_scenes_of_an_earlier_run_are_said_to_be_kept():
    ends = ("ok", ""), ("rejected", "stalled"), ("failed", "its worker was killed")
    said = shown(3, *(end(f"scene-0000{k}", *how) for k, how in enumerate(ends)))
    lines = [line.partition(" (about")[0] for line in said.splitlines()]
    assert lines[:2] == ["scene-00000: kept", "scene-00001: kept, rejected: stalled"]
    assert lines[2] == "scene-00002: failed: its worker was killed"


def test_what_was_there_already_and_what_comes_once_say_nothing_about_the_time_left(monkeypatch: pytest.MonkeyPatch):
    clock = iter([0.0, 50.0, 500.0, 510.0, 510.0])
    monkeypatch.setattr("tacgen.report.progress.time.monotonic", lambda: next(clock))
    stream = io.StringIO()
    with Progress(2, 8, stream) as progress:
        progress(end("scene-00000"))
        progress({"event": "compiling", "scene": "scene-00001"})
        progress({"event": "tracing", "scene": "scene-00000"})
        progress({"event": "tracing", "scene": "scene-00001"})
        progress(frame("scene-00001", 1))
        progress({"event": "compiling", "scene": "scene-00001"})
        progress(frame("scene-00001", 2))  # after the compiler: the next one says how long a frame takes
        progress({"event": "retry", "scene": "scene-00009", "reason": "so that a line is printed"})
        assert "left" not in stream.getvalue()
        progress(frame("scene-00001", 3))
        progress({"event": "retry", "scene": "scene-00009", "reason": "so that a line is printed"})
    assert stream.getvalue().count("compiling") == 1
    assert stream.getvalue().count("tracing") == 1
    assert "(about 10 s left)" in stream.getvalue()  # 10 s from the second frame to the third, one to go


def test_a_bar_on_a_terminal_unless_colour_is_unwanted(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    said = shown(2, *RUN, stream=Terminal())
    assert "\x1b[" in said
    assert "scene-00000: rejected: stalled [here]" in said
    assert "2 of 2 scenes" in said
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b[" not in shown(2, *RUN, stream=Terminal())
