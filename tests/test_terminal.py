"""Data are made whatever becomes of the terminal: full, closed and broken streams, in processes of their own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.scenes import make, make_plan

from tacgen.bundle.check import check

ROOT = Path(__file__).parent.parent
PROGRAM = """
import sys
from tacgen import batch
batch.run.__kwdefaults__["task"] = "helpers.scenes:make"  # scenes in milliseconds
from tacgen.cli.main import app
sys.argv = ["tacgen", *sys.argv[1:]]
app()
"""


def shell(folder: Path, command: str) -> int:
    """Exit code of a shell command in which TACGEN stands for the program with stand-in scenes."""
    program = folder / "program.py"
    program.write_text(PROGRAM)
    text = command.replace("TACGEN", f"{sys.executable} -P {program}")
    paths = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    done = subprocess.run(["bash", "-o", "pipefail", "-c", text], cwd=folder, env={**os.environ, "PYTHONPATH": paths})
    return done.returncode


@pytest.mark.slow
@pytest.mark.parametrize(
    ("streams", "code"),
    [
        ("2>/dev/full", 0),
        (">/dev/full 2>&1", 0),
        ("2>&1 | head -c 10 >/dev/null", 0),
        ("--json 2>/dev/null | head -c 10 >/dev/null", 0),
        (">&- 2>&-", 0),
        ("<&- >&- 2>&-", 0),
    ],
)
def test_a_run_goes_on_when_nobody_reads_what_it_prints(tmp_path: Path, streams: str, code: int) -> None:
    make_plan(tmp_path)
    assert shell(tmp_path, f"TACGEN run many.yaml -o out --set vary.samples=3 {streams}") == code
    assert len(list((tmp_path / "out").glob("scene-*.h5"))) == 3
    assert (tmp_path / "out" / "README.md").read_text().startswith("# many")
    assert check(tmp_path / "out") == []


@pytest.mark.parametrize(
    ("command", "unbuffered"),
    [
        ("show out", ""),
        ("--help", "1"),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in (("show out", "1"), ("--help", ""))),
        *(pytest.param("list sensors", each, marks=pytest.mark.slow) for each in ("", "1")),
        *(pytest.param("--version", each, marks=pytest.mark.slow) for each in ("", "1")),
    ],
)
def test_results_that_nobody_gets_are_no_success(
    tmp_path: Path, command: str, unbuffered: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether Python writes at once or what is left when it ends."""
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    make(make_plan(tmp_path, 1).rows[0], tmp_path / "out")
    assert shell(tmp_path, f"TACGEN {command} >/dev/full 2>said") == 2
    assert (tmp_path / "said").read_text() == "No space left on device\n"
