"""Processes beside a run: started before they are needed, and gone with it."""

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from importlib import import_module
from pathlib import Path

import pytest

from tacgen.batch import process_pool

HOLD = """
import sys, time
from contextlib import ExitStack
from tacgen.batch import process_pool
from test_process_pool import number

if __name__ == "__main__":
    with ExitStack() as stack:
        pool = process_pool.started(stack, 2, number, by=sys.argv[1])
        print(*pool._processes, flush=True)
        pool.submit(time.sleep, 600)
        time.sleep(600)
"""


def number() -> int:
    return os.getpid()


def modules() -> list[str]:
    return list(sys.modules)


@pytest.mark.slow
@pytest.mark.parametrize("by", ["spawn", "forkserver"])
def test_processes_start_before_they_are_needed(by: str) -> None:
    with ExitStack() as stack:
        pool = process_pool.started(stack, 2, import_module, "tacgen.tensor_engine.planning", by=by)
        assert len(pool._processes) == 2
        assert "tacgen.tensor_engine.grids" in pool.submit(modules).result()


@pytest.mark.parametrize("by", ["spawn", "forkserver"])
def test_processes_end_with_one_that_is_killed(by: str, tmp_path: Path) -> None:
    script = tmp_path / "hold.py"
    script.write_text(HOLD)
    paths = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    there = {**os.environ, "PYTHONPATH": paths}
    with subprocess.Popen([sys.executable, str(script), by], stdout=subprocess.PIPE, env=there, text=True) as held:
        assert held.stdout is not None
        started = [int(each) for each in held.stdout.readline().split()]
        held.kill()
    assert len(started) == 2
    deadline = time.monotonic() + 20
    try:
        while any(map(runs, started)) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not any(map(runs, started))
    finally:
        for each in started:
            with suppress(ProcessLookupError):
                os.kill(each, signal.SIGKILL)


def runs(process: int) -> bool:
    """Whether a process is there, and not only its exit code."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
