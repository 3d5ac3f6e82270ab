"""Odd machines: commands under low limits, with closed or full outputs and odd variables work, or end in one line."""

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from helpers.synthetic import write

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
    recipe = Path(__file__).parents[2] / "recipes" / "quickstart.yaml"
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
