"""The Dask engine: the same bundles as the local one, whoever of its workers dies."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from helpers.needs import needs
from helpers.scenes import made, make, make_plan, spoil

from batch.test_local import digests, leftovers, run
from tacgen.base.errors import UserError
from tacgen.bundle.check import check
from tacgen.bundle.run_status import survey

needs("distributed")
TESTS = Path(__file__).parents[1]


@pytest.mark.slow
def test_dask_writes_the_bytes_that_this_process_writes(tmp_path: Path):
    spoil(tmp_path / "dask", "scene-00003", "kill once writing")
    spoil(tmp_path / "dask", "scene-00005", "refuse")
    events: list[dict[str, Any]] = []
    results = run(tmp_path / "dask", engine="dask", workers=2, on_event=events.append)
    assert [r.status for r in results] == ["ok"] * 5 + ["failed"] + ["ok"] * 2
    assert [e["scene"] for e in events if e["event"] == "retry"] == ["scene-00003"]
    assert survey(tmp_path / "dask").count() == {"ok": 7, "failed": 1}
    (tmp_path / "dask" / "faults" / "scene-00005").unlink()
    run(tmp_path / "dask", engine="dask")
    for row in make_plan(tmp_path).rows:
        make(row, tmp_path / "here")
    assert digests(tmp_path / "dask") == digests(tmp_path / "here")
    assert len(digests(tmp_path / "here")) == 8


@pytest.mark.slow
def test_a_worker_of_a_real_scheduler_killed_in_the_middle_loses_nothing(tmp_path: Path):
    out = tmp_path / "out"
    with socket.socket() as probe:  # of a free port
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
    here = {**os.environ, "PYTHONPATH": f"{TESTS}{os.pathsep}{TESTS.parent}"}
    quiet: dict[str, Any] = {"env": here, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    python = [sys.executable, "-m"]
    scheduler = [*python, "distributed.cli.dask_scheduler", "--host", address, "--no-dashboard"]
    started = [subprocess.Popen(scheduler, **quiet)]
    try:
        worker = [*python, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        started += [subprocess.Popen(worker, **quiet) for _ in range(2)]
        spoil(out, "scene-00002", "slow")
        killer = [sys.executable, "-c", KILLER, str(out / "scene-00000.h5"), str(started[1].pid)]
        deadly = subprocess.Popen(killer)
        results = run(out, engine="dask", scheduler=address)
        deadly.wait()
        assert {r.status for r in results} == {"ok"}
        assert started[1].wait(10) == -signal.SIGKILL
        assert check(out) == []
        assert len(digests(out)) == 8
        assert set(made(out)) == {r.name for r in results}
        assert leftovers(out) == []
    finally:
        for process in started:
            process.kill()
            process.wait()


SBATCH = """#!/bin/sh
bash "$1" >/dev/null 2>&1 &
echo "Submitted batch job $!"
"""


@pytest.mark.slow
def test_the_slurm_script_runs_where_jobs_are_processes(tmp_path: Path):
    needs("dask_jobqueue")
    for name, text in (("sbatch", SBATCH), ("scancel", '#!/bin/sh\nkill "$@"\n')):
        command = tmp_path / "bin" / name
        command.parent.mkdir(exist_ok=True)
        command.write_text(text)
        command.chmod(0o755)
    here = {**os.environ, "PATH": f"{command.parent}:{os.environ['PATH']}", "PYTHONPATH": str(TESTS.parent)}
    sets = ("--set", "vary.samples=2", "--set", "outputs=[force]", "--set", "quality=draft")
    script = [sys.executable, TESTS.parent / "scripts" / "slurm.py", "batch", "-o", tmp_path / "out", "--jobs", "2"]
    done = subprocess.run([*script, "--interface", "lo", *sets], env=here, cwd=tmp_path, timeout=240)
    assert done.returncode == 0
    assert check(tmp_path / "out") == []
    assert survey(tmp_path / "out").count() == {"ok": 2}


KILLER = """
import os, signal, sys, time
while not os.path.exists(sys.argv[1]):
    time.sleep(0.005)
os.kill(int(sys.argv[2]), signal.SIGKILL)
"""


def test_what_a_user_can_mend_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for options, says in (
        ({"engine": "dusk"}, "--engine dusk: must be one of local, dask"),
        ({"scheduler": "tcp://x"}, "--scheduler tcp://x: needs --engine dask"),
        ({"engine": "dask", "scheduler": "nonsense://x"}, "--scheduler nonsense://x: "),
    ):
        with pytest.raises(UserError, match=says) as caught:
            run(tmp_path / "out", **options)
        assert len(caught.value.lines) == 1
    monkeypatch.setattr("tacgen.batch.dask_engine.SCHEDULER_TIMEOUT_S", 1)
    start = time.monotonic()
    with pytest.raises(UserError, match=r"--scheduler tcp://127\.0\.0\.1:1: "):
        run(tmp_path / "out", engine="dask", scheduler="tcp://127.0.0.1:1")
    assert time.monotonic() - start < 30
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UserError, match=r"pip install 'tacgen\[dask\]'"):
        run(tmp_path / "out", engine="dask")


@pytest.mark.slow
def test_what_goes_into_a_job_script_is_quoted():
    needs("dask_jobqueue")
    script = [sys.executable, TESTS.parent / "scripts" / "slurm.py", "batch", "-o", "out", "--dry-run", "--queue"]
    done = subprocess.run([*script, "a b; touch x"], capture_output=True, text=True, timeout=120)
    assert "#SBATCH -p 'a b; touch x'\n" in done.stdout, done.stderr
    done = subprocess.run([*script, "a\ntouch x"], capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert "argument --queue: must be one line" in done.stderr
