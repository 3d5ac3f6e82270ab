"""Progress: plain lines with the time left where there is no terminal, a bar where there is one."""

import io

import pytest

from tacgen.report.progress import COMPILING, Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def frame(scene: str, k: int) -> dict[str, object]:
    return {"event": "frame", "scene": scene, "frame": k, "frames": 4}


def end(scene: str, status: str = "ok", reason: str = "", **seconds: float) -> dict[str, object]:
    return {"event": "scene", "scene": scene, "status": status, "reason": reason, "frames": 4, "seconds": seconds}


def drive(stream: io.StringIO) -> str:
    with Progress(2, 8, stream) as progress:
        progress(frame("scene-00000", 2))
        progress(frame("scene-00001", 2))
        progress({"event": "retry", "scene": "scene-00001", "reason": "its worker [1] was killed"})
        progress(end("scene-00000", "rejected", "stalled [here]", solve=1.0))
        progress(end("scene-00001", solve=1.0))
    return stream.getvalue()


def test_a_line_a_scene_where_there_is_no_terminal():
    lines = drive(io.StringIO()).splitlines()
    assert lines[0].startswith("scene-00001: once more: its worker [1] was killed (about ")
    assert lines[1].startswith("scene-00000: rejected: stalled [here] (about ")
    assert lines[2:] == ["scene-00001: ok"]


def test_a_note_is_reported_once_for_all_scenes():
    stream = io.StringIO()
    with Progress(2, 8, stream) as progress:
        for scene in ("scene-00000", "scene-00001"):
            progress({"event": "note", "scene": scene, "note": "its edges are sharp"})
    assert stream.getvalue() == "scene-00000: note: its edges are sharp\n"


def test_a_line_a_frame_where_there_is_one_scene():
    stream = io.StringIO()
    with Progress(1, 4, stream) as progress:
        progress(frame("scene-00000", 1))
        progress(frame("scene-00000", 3))
        progress(end("scene-00000", solve=1.0))
    first, third = stream.getvalue().splitlines()[:2]
    assert first == "scene-00000: frame 1 of 4"
    assert third.startswith("scene-00000: frame 3 of 4 (about ")
    assert stream.getvalue().endswith("scene-00000: ok\n")


def test_scenes_of_an_earlier_run_are_said_to_be_kept():
    stream = io.StringIO()
    with Progress(3, 12, stream) as progress:
        progress(end("scene-00000"))
        progress(end("scene-00001", "rejected", "stalled"))
        progress(end("scene-00002", "failed", "its worker was killed"))
    lines = [line.partition(" (about")[0] for line in stream.getvalue().splitlines()]
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


def test_what_was_said_while_the_recipe_was_read_is_not_repeated():
    stream = io.StringIO()
    with Progress(2, 8, stream, [COMPILING]) as progress:
        progress({"event": "compiling", "scene": "scene-00001"})
    assert stream.getvalue() == ""


def test_a_bar_on_a_terminal_unless_colour_is_unwanted(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    shown = drive(Terminal())
    assert "\x1b[" in shown
    assert "scene-00000: rejected: stalled [here]" in shown
    assert "2 of 2 scenes" in shown
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b[" not in drive(Terminal())
