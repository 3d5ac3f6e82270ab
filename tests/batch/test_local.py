"""The local engine: one scene is lost with its worker, tried again, and recorded; the rest never notice."""

import ctypes
import hashlib
import json
import os
import resource
import signal
import time
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path
from threading import Thread, current_thread, main_thread
from typing import Any

import pytest
from helpers.scenes import TASK, made, make, make_plan, spoil

from tacgen import batch
from tacgen.base.errors import UserError
from tacgen.batch import Limits, worker_main
from tacgen.batch.local import Pool
from tacgen.batch.worker_process import Worker
from tacgen.bundle.check import check
from tacgen.bundle.journal import read_journal
from tacgen.bundle.run_status import survey

QUICK = Limits(silence_s=3.0)


def run(folder: Path, samples: int = 8, **options: Any) -> list[Any]:
    """Run the stand-in scenes; `shard` is a pair."""
    plan = make_plan(folder.parent, samples, options.get("shard") or (0, 1))
    return batch.run(plan, folder, **{"task": TASK, "limits": QUICK, **options})


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.glob("*.h5"))}


def leftovers(folder: Path) -> list[str]:
    known = (".h5", ".json", ".jsonl", ".log")
    return [path.name for path in folder.iterdir() if path.is_file() and not path.name.endswith(known)]


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="needs glibc")
def test_freed_memory_is_returned_to_the_system():
    def used() -> float:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6

    blocks = [bytes(2000) for _ in range(50_000)]  # 100 MB
    blocks = blocks[::1000]  # one of each 2 MB is kept
    before = used()
    worker_main._return_memory()
    assert used() < before - 50
    assert len(blocks) == 50


@pytest.mark.usefixtures("kept_workers")
@pytest.mark.parametrize(("interval", "returns"), [(0.0, 3), (60.0, 0)])
def test_memory_is_returned_now_and_then(
    interval: float, returns: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    returned: list[None] = []
    monkeypatch.setattr(worker_main, "_return_memory", lambda: returned.append(None))
    monkeypatch.setattr(worker_main, "MIN_MEMORY_RETURN_S", interval)
    ours, theirs = Pipe()
    for number in range(3):
        ours.send((number, tmp_path, False))
    begun: list[int] = []
    work = theirs, lambda row, folder, **_: row, lambda: begun.append(len(returned))
    worker = Thread(target=worker_main._work, args=work)
    worker.start()
    assert [ours.recv() for _ in range(3)] == [("done", 0), ("done", 1), ("done", 2)]
    ours.close()
    worker.join()
    assert len(returned) == returns
    assert len(begun) == 3


@pytest.mark.slow
def test_shards_on_any_number_of_workers_give_what_one_process_gives(tmp_path: Path):
    serial = tmp_path / "serial"
    for row in make_plan(tmp_path).rows:
        make(row, serial)
    for i, workers in enumerate((1, 2, 1)):
        results = run(tmp_path / "sharded", shard=(i, 3), workers=workers)
        assert [result.status for result in results] == ["ok"] * len(results)
    assert digests(tmp_path / "sharded") == digests(serial)
    assert len(digests(serial)) == len(set(digests(serial).values())) == 8
    assert survey(tmp_path / "sharded").count() == {"ok": 8}


@pytest.mark.slow
def test_every_kind_of_lost_worker_costs_one_scene_which_a_later_run_makes(tmp_path: Path):
    out = tmp_path / "out"
    faults = {
        "scene-00000": ("kill once", "ok", ""),
        "scene-00001": ("kill writing", "failed", "killed by SIGKILL"),
        "scene-00002": ("hang once writing", "ok", ""),
        "scene-00003": ("exit", "failed", "ended with exit code 7"),
        "scene-00004": ("raise", "failed", "ZeroDivisionError: made to fail"),
        "scene-00005": ("refuse", "failed", "this cannot be made"),
    }
    for scene, (words, _, _) in faults.items():
        spoil(out, scene, words)
    events: list[dict[str, Any]] = []
    results = run(out, workers=2, on_event=events.append)
    assert [r.name for r in results] == [f"scene-{i:05d}" for i in range(8)]
    wanted = {scene: (status, reason) for scene, (_, status, reason) in faults.items()}
    for result in results:
        status, reason = wanted.get(result.name, ("ok", ""))
        assert (result.status, reason in result.reason) == (status, True), result
    retries = {event["scene"]: event["reason"] for event in events if event["event"] == "retry"}
    assert set(retries) == set(faults) - {"scene-00005"}  # what is refused will be refused again
    assert retries["scene-00002"] == "its worker was stopped: no new frame for 3 s"
    assert sorted(event["scene"] for event in events if event["event"] == "scene") == [r.name for r in results]
    assert leftovers(out) == []
    assert survey(out).count() == {"ok": 4, "failed": 4}
    assert {s.name: s.reason for s in survey(out).scenes if s.reason}["scene-00005"] == "this cannot be made"
    traceback = [event.traceback for event in read_journal(out) if event.traceback]
    assert "scenes.py" in traceback[0]
    for fault in (out / "faults").iterdir():
        fault.unlink()
    assert {r.status for r in run(out, workers=2)} == {"ok"}
    assert sorted(made(out)) == [f"scene-{i:05d}" for i in range(8)]  # each once: what was done stayed done
    assert check(out) == []
    assert survey(out).count() == {"ok": 8}


@pytest.mark.slow
def test_a_worker_that_eats_the_memory_is_stopped(tmp_path: Path):
    out = tmp_path / "out"
    spoil(out, "scene-00001", "eat")
    results = run(out, samples=3, limits=Limits(memory_gb=0.35))
    assert [r.status for r in results] == ["ok", "failed", "ok"]
    assert "GB of memory used, 0.35 allowed" in results[1].reason


@pytest.mark.slow
def test_workers_are_replaced_after_their_share(tmp_path: Path):
    results = run(tmp_path / "out", samples=5, limits=Limits(scenes=2))
    pids = [result.seconds["pid"] for result in results]
    assert pids[0] == pids[1] != pids[2] == pids[3] != pids[4]


def test_the_end_of_a_replaced_worker_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    stop, waits = Worker.stop, list[Thread]()

    def watched(worker: Worker, patience: float = 0.5) -> int:
        waits.append(current_thread())
        return stop(worker, patience)

    monkeypatch.setattr(Worker, "stop", watched)
    run(tmp_path / "out", samples=3, limits=Limits(scenes=2))
    assert [thread is main_thread() for thread in waits] == [False, True]  # the second one is there at the end


def test_a_pool_stays_for_the_next_batch(tmp_path: Path):
    rows = make_plan(tmp_path, 2).rows
    with Pool(task=TASK) as pool:
        first, second = (pool.run([row], tmp_path / "out")[0] for row in rows)
    assert first.seconds["pid"] == second.seconds["pid"]
    assert pool.workers == []


def test_workers_that_cannot_start_are_one_line(tmp_path: Path):
    with pytest.raises(UserError, match="workers end before their first scene: its worker ended with exit code 1"):
        run(tmp_path / "out", task="no.such.module:make")


def test_workers_use_one_thread_and_respect_the_user(monkeypatch: pytest.MonkeyPatch):
    from tacgen.batch import worker_process
    from tacgen.batch.worker_process import THREAD_VARIABLES

    for name in THREAD_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    worker = Worker(TASK)
    listed = Path(f"/proc/{worker.process.pid}/environ")
    while not (environment := listed.read_bytes()):  # empty until the kernel has started the program
        time.sleep(0.01)
    worker.stop(patience=10)
    wanted = {*(f"{name}=1" for name in THREAD_VARIABLES[1:]), "OMP_NUM_THREADS=3"}
    assert wanted <= set(environment.decode().split("\0"))
    monkeypatch.setenv("OMP_NUM_THREADS", "0")
    assert worker_process._threads()["OMP_NUM_THREADS"] == "1"


def test_an_interrupt_is_the_parent_s_alone_from_the_first_moment():
    worker = Worker(TASK)
    for _ in range(20):
        os.kill(worker.process.pid, signal.SIGINT)
        time.sleep(0.02)
    heard = [("", None)]
    while heard[-1][0] not in ("ready", "lost"):
        heard += worker.listen()
    worker.stop()
    assert heard[-1][0] == "ready"


@pytest.mark.usefixtures("kept_workers")
def test_a_larger_plan_keeps_what_is_there_and_another_recipe_is_refused(tmp_path: Path):
    out = tmp_path / "out"
    run(out, samples=2)
    results = run(out, samples=4)
    assert [bool(result.seconds) for result in results] == [False, False, True, True]
    plan = make_plan(tmp_path, 4)
    changed = replace(plan, rows=tuple(replace(row, seed=row.seed + 1) for row in plan.rows[:1]))
    with pytest.raises(UserError, match="made from other inputs"):
        batch.run(changed, out, task=TASK)
    assert batch.run(changed, out, task=TASK, overwrite=True)[0].seconds


@pytest.mark.usefixtures("kept_workers")
def test_plans_of_another_division_are_replaced(tmp_path: Path):
    out = tmp_path / "out"
    run(out, samples=4, shard=(1, 2))
    assert survey(out).count() == {"ok": 2}
    run(out, samples=4)
    assert [path.name for path in out.glob("plan*.json")] == ["plan.json"]
    assert survey(out).count() == {"ok": 4}


@pytest.mark.usefixtures("kept_workers")
def test_a_journal_line_cut_short_is_passed_over(tmp_path: Path):
    out = tmp_path / "out"
    run(out, samples=1)
    journal = out / "journal.jsonl"
    whole = [json.loads(line)["event"] for line in journal.read_text().splitlines()]
    assert whole == ["begin", "scene", "end"]
    journal.write_text(journal.read_text() + '{"event": "sce')
    assert [event.event for event in read_journal(out)] == whole


@pytest.mark.usefixtures("kept_workers")
def test_a_bundle_that_only_a_newer_tacgen_reads_is_not_written_over(tmp_path: Path):
    import h5py

    out = tmp_path / "out"
    run(out, samples=1)
    with h5py.File(out / "scene-00000.h5", "r+") as file:
        file.attrs["tacgen_format"] = 99
    before = (out / "scene-00000.h5").read_bytes()
    with pytest.raises(UserError, match=r"upgrade it; pass --overwrite to replace it$"):
        run(out, samples=1)
    assert (out / "scene-00000.h5").read_bytes() == before


@pytest.mark.usefixtures("kept_workers")
def test_status_tells_damage_other_inputs_and_work_in_progress(tmp_path: Path):
    from tacgen.base import atomic_file

    out = tmp_path / "out"
    run(out, samples=5)
    (out / "scene-00000.h5").write_bytes(b"\x89HDF\r\n\x1a\n and no more")
    (out / "scene-00001.h5").unlink()
    (out / "scene-00002.h5").unlink()
    (out / "scene-00003.h5").write_bytes((out / "scene-00004.h5").read_bytes())
    with atomic_file.claim(out / "scene-00001.h5"):
        states = [scene.state for scene in survey(out).scenes]
    assert states == ["damaged", "at work", "waiting", "waiting", "ok"]
    assert survey(out).scenes[3].reason == "its place is taken by a bundle of other inputs"
    assert [scene.state for scene in survey(out).scenes][1] == "waiting"


def test_workers_make_ready_before_their_first_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    ready = tmp_path / "ready"
    ready.mkdir()
    monkeypatch.setenv("MADE_READY", str(ready))
    rows = make_plan(tmp_path).rows[:2]
    with Pool(1, task=TASK, first="helpers.scenes:noted") as pool:
        results = pool.run(rows, tmp_path / "out")
        (process,) = (worker.process.pid for worker in pool.workers)
    assert [result.status for result in results] == ["ok", "ok"]
    assert {path.name: path.read_text() for path in ready.iterdir()} == {str(process): rows[0].name}
