"""Odd machines: low limits, closed and full outputs, odd variables: commands work, or end in one line."""

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from helpers.scenes import make, make_plan
from helpers.synthetic import write

from tacgen.bundle.check import check

ODD = {
    "8 file descriptors": "ulimit -n 8; {tacgen} report {data} -o {out}/report.html",
    "8 file descriptors, packing": "ulimit -n 8; {tacgen} pack {data} -o {out}/packed",
    "200 MB of memory": "ulimit -v 200000; {tacgen} check {data}",
    "closed outputs": "{tacgen} check {data} >&- 2>&-",
    "no folder for scratch": "TMPDIR=/nonexistent {tacgen} report {data} -o {out}/report.html",
    "no home": "env -u HOME -u XDG_CACHE_HOME {tacgen} check {data}",
    "a home that cannot be written": "HOME=/proc {tacgen} report {data} -o {out}/report.html",
    "warnings are errors": "PYTHONWARNINGS=error {tacgen} report {data} -o {out}/report.html",
}
REFUSED = {
    "8 file descriptors, solving": ("ulimit -n 8; {tacgen} run {recipe} -o {out}/run", "Too many open files"),
    "200 MB of memory, solving": ("ulimit -v 200000; {tacgen} run {recipe} -o {out}/run", "out of memory"),
    "no room for threads": (
        "ulimit -s 2000000; ulimit -v 1500000; env -u OMP_NUM_THREADS OPENBLAS_NUM_THREADS=2 {tacgen} check {data}",
        "out of memory",
    ),
    "an output that is full": ("{tacgen} check {data} > /dev/full", "No space left on device"),
    "a page into a device": ("{tacgen} report {data} -o /dev/full", "/dev/full: is a pipe, socket or device"),
}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    for number in range(2):
        write(folder / f"scene-{number:05d}.h5", scene_index=number)
    return folder


def done(command: str, data: Path, out: Path) -> subprocess.CompletedProcess[str]:
    recipe = ROOT / "recipes" / "quickstart.yaml"
    line = command.format(tacgen=f"{sys.executable} -m tacgen", data=data, out=out, recipe=recipe)
    env = {"OPENBLAS_NUM_THREADS": "1", **os.environ}  # a thread takes memory
    # OpenBLAS raises SIGINT where it lacks memory, and what a shell runs in the background ignores that
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=120, env=env, preexec_fn=heard)


@pytest.mark.slow
@pytest.mark.parametrize("machine", ODD)
def test_commands_work(tmp_path: Path, data: Path, machine: str) -> None:
    found = done(ODD[machine], data, tmp_path)
    assert found.returncode == 0, found.stderr
    assert "Traceback" not in found.stderr


@pytest.mark.slow
@pytest.mark.parametrize("machine", REFUSED)
def test_what_cannot_work_is_one_line(tmp_path: Path, data: Path, machine: str) -> None:
    command, says = REFUSED[machine]
    found = done(command, data, tmp_path)
    lines = [line for line in found.stderr.splitlines() if says in line]
    assert (found.returncode, len(lines)) == (2, 1)
    assert "Traceback" not in found.stderr


ROOT = Path(__file__).parents[2]
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
def test_lost_results_are_no_success(
    tmp_path: Path, command: str, unbuffered: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether Python writes at once or what is left when it ends."""
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    make(make_plan(tmp_path, 1).rows[0], tmp_path / "out")
    assert shell(tmp_path, f"TACGEN {command} >/dev/full 2>said") == 2
    assert (tmp_path / "said").read_text() == "No space left on device\n"
