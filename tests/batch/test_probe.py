"""Scenes timed before a run, and the number of workers that a machine is good for."""

import time
from pathlib import Path

import pytest
from helpers.scenes import TASK, make_plan, spoil

from tacgen.base import machine
from tacgen.base.errors import UserError
from tacgen.batch import probe, worker_process


@pytest.mark.usefixtures("kept_workers")
def test_a_few_scenes_judge_all(tmp_path: Path):
    found = probe.probe(make_plan(tmp_path, 40), 2, TASK)
    assert found.cost.judged_by == probe.MAX_TIMED_SCENES
    assert found.cost.seconds.expected > 0
    assert 0.01 < found.memory_gb < 4
    size = found.cost.gigabytes
    assert size.low <= size.expected <= size.high < 0.1


@pytest.mark.usefixtures("kept_workers")
def test_where_no_scene_can_be_made_that_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    class Spoilt(probe.TemporaryDirectory):  # type: ignore[type-arg]
        def __enter__(self) -> str:
            name = super().__enter__()
            spoil(Path(name), "scene-00000", "refuse")
            return name

    monkeypatch.setattr(probe, "TemporaryDirectory", Spoilt)
    with pytest.raises(UserError, match="no scene could be made to judge by: scene-00000: this cannot be made"):
        probe.probe(make_plan(tmp_path, 1), 1, TASK)


def test_scenes_that_take_long_are_judged_by_their_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "TIMING_S", 0.2)
    events: list[dict[str, object]] = []
    begun = time.monotonic()
    found = probe.probe(make_plan(tmp_path, 2), 1, "helpers.scenes:endless", on_event=events.append)
    assert time.monotonic() - begun < 10
    assert found.cost.judged_by == 1
    assert found.cost.seconds.expected == pytest.approx(0.05 * 2 * make_plan(tmp_path, 2).frames[0], rel=0.5)
    assert not [event for event in events if event["event"] == "scene"]


def test_cores_are_counted_where_there_is_no_affinity(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(machine.os, "sched_getaffinity")
    monkeypatch.setattr(machine.os, "cpu_count", lambda: 1)
    assert machine.cores() == 1


@pytest.mark.parametrize(("cores", "memory", "workers"), [(8, 64.0, 8), (64, 16.0, 16), (2, 0.5, 1)])
def test_as_many_workers_as_cores_and_memory_allow(
    cores: int, memory: float, workers: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(worker_process, "cores", lambda: cores)
    monkeypatch.setattr(worker_process, "machine_memory", lambda: memory)
    assert worker_process.usual_workers() == workers
