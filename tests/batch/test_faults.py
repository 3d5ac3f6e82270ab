"""Whatever is killed, filled or damaged: run again, and every scene is there, whole, and made no more than needed."""

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from helpers.scenes import made, spoil

from batch.test_local import digests, leftovers, run
from tacgen.bundle.check import check
from tacgen.bundle.run_status import survey

TESTS = Path(__file__).parent.parent
PROGRAM = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(TESTS)!r})
from helpers.scenes import TASK, make_plan
from tacgen import batch
out = Path(sys.argv[1])
results = batch.run(make_plan(out.parent), out, task=TASK, workers=int(sys.argv[2]))
print(*[r.status for r in results])
"""
ALL = [f"scene-{i:05d}" for i in range(8)]


def start(out: Path, workers: int) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", PROGRAM, str(out), str(workers)]
    # tests that a shell runs in the background ignore Ctrl-C, and so would what they start
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=TESTS.parent, preexec_fn=heard)


def wait_for(what: Callable[[], object], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)


@pytest.mark.slow
def test_a_parent_killed_twice_during_a_write_takes_its_workers_along_and_loses_nothing_else(tmp_path: Path):
    out = tmp_path / "out"
    spoil(out, "scene-00003", "hang writing")
    for _ in range(2):
        program = start(out, workers=2)
        wait_for(lambda: list(out.glob("scene-00003.h5.tacgen-part-*")) and len(made(out)) == 7)
        program.send_signal(signal.SIGKILL)
        program.communicate()
        assert not (out / "scene-00003.h5").exists()
        wait_for(lambda: survey(out).count() == {"ok": 7, "waiting": 1}, 10)  # its worker noticed and let go
        assert {f.level for f in check(out)} == {"incomplete"}
    (out / "faults" / "scene-00003").unlink()
    assert {r.status for r in run(out)} == {"ok"}
    assert sorted(made(out)) == ALL
    assert check(out) == []
    assert leftovers(out) == []


@pytest.mark.slow
def test_a_run_takes_over_what_another_one_dies_of(tmp_path: Path):
    out = tmp_path / "out"
    spoil(out, "scene-00000", "hang writing")
    first = start(out, workers=1)
    wait_for(lambda: list(out.glob("scene-00000.h5.tacgen-part-*")))
    (out / "faults" / "scene-00000").unlink()
    second = start(out, workers=1)
    wait_for(lambda: len(made(out)) == 7)
    first.send_signal(signal.SIGKILL)
    first.communicate()
    said, _ = second.communicate(timeout=60)
    assert said.split() == ["ok"] * 8
    assert sorted(made(out)) == ALL
    assert leftovers(out) == []


@pytest.mark.usefixtures("kept_workers")
def test_truncated_and_flipped_bundles_are_found_and_made_again(tmp_path: Path):
    out = tmp_path / "out"
    run(out)
    good = digests(out)
    cut, flipped = out / "scene-00002.h5", out / "scene-00005.h5"
    cut.write_bytes(cut.read_bytes()[:-100])
    data = bytearray(flipped.read_bytes())
    data[len(data) // 2] ^= 1
    flipped.write_bytes(data)
    assert {f.path for f in check(out)} == {cut, flipped}
    assert {r.status for r in run(out)} == {"ok"}
    assert digests(out) == good
    assert sorted(made(out)) == sorted([*ALL, "scene-00002", "scene-00005"])


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    disk = tmp_path / "disk"
    disk.mkdir()
    if os.geteuid() != 0 or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=96k", "tmpfs", disk]).returncode:
        pytest.skip("mounting a small disk needs root")
    yield disk
    subprocess.run(["umount", "-l", disk], check=True)


@pytest.mark.usefixtures("kept_workers")
def test_a_disk_that_fills_up_stops_the_run_and_a_larger_one_lets_it_go_on(small_disk: Path):
    out = small_disk / "out"
    with pytest.raises(OSError, match="No space left on device") as caught:
        run(out, workers=2)
    assert caught.value.errno == errno.ENOSPC
    whole = set(digests(out))
    assert len(whole) < 8
    assert not whole or check(out) == []
    assert leftovers(out) == []
    subprocess.run(["mount", "-o", "remount,size=1m", small_disk], check=True)
    assert {r.status for r in run(out, workers=2)} == {"ok"}
    assert check(out) == []
    assert set(survey(out).count()) == {"ok"}


def test_ctrl_c_leaves_no_worker_and_no_leftovers(tmp_path: Path):
    out = tmp_path / "out"
    spoil(out, "scene-00000", "hang writing")
    program = start(out, workers=2)
    wait_for(lambda: list(out.glob("scene-00000.h5.tacgen-part-*")) and len(made(out)) == 7)
    workers = [int(p) for p in Path(f"/proc/{program.pid}/task/{program.pid}/children").read_text().split()]
    assert workers
    program.send_signal(signal.SIGINT)
    program.communicate(timeout=30)
    assert program.returncode != 0
    assert not [pid for pid in workers if Path(f"/proc/{pid}").exists()]
    assert leftovers(out) == []
    assert len(digests(out)) == 7
