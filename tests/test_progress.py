"""Progress: plain lines with the time left where there is no terminal, a bar where there is one."""

import io
from types import SimpleNamespace

import pytest

from tacgen.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


ROWS = [SimpleNamespace(name="scene-00000", frames=4), SimpleNamespace(name="scene-00001", frames=4)]


def drive(stream: io.StringIO) -> str:
    with Progress(ROWS, stream) as progress:
        progress("scene-00000: meshed [draft]")
        progress("scene-00000: frame 2 of 4")
        progress(SimpleNamespace(name="scene-00000", status="rejected", reason="stalled [here]"))
        progress(SimpleNamespace(name="scene-00001", status="ok", reason=""))
    return stream.getvalue()


def test_lines_where_there_is_no_terminal():
    lines = drive(io.StringIO()).splitlines()
    assert lines[0] == "scene-00000: meshed [draft]"
    assert lines[1].startswith("scene-00000: frame 2 of 4 (about ")
    assert lines[2].startswith("scene-00000: rejected: stalled [here] (about ")
    assert lines[3] == "scene-00001: ok"


def test_a_bar_on_a_terminal_unless_colour_is_unwanted(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    shown = drive(Terminal())
    assert "\x1b[" in shown
    assert "scene-00000: rejected: stalled [here]" in shown
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b[" not in drive(Terminal())
