"""Scenes timed before a run, the workers that a machine is good for, and long scenes begun first."""

import heapq
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers.scenes import TASK, make_plan, spoil

from tacgen.base import machine
from tacgen.base.errors import UserError
from tacgen.batch import probe, worker_process
from tacgen.batch.local import _Batch
from tacgen.batch.scene_order import COMPARED_SCENES, MIN_SCENES_FOR_PREDICTION, SceneOrder
from tacgen.bundle.resume import SceneResult


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
def test_workers_by_cores_and_memory(cores: int, memory: float, workers: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(worker_process, "cores", lambda: cores)
    monkeypatch.setattr(worker_process, "machine_memory", lambda: memory)
    assert worker_process.usual_workers() == workers


class Scene(NamedTuple):
    """What the order looks at, and what the scene will take [s]."""

    frames: int
    values: dict[str, Any]
    seconds: float


def scenes(seed: int, count: int = 64) -> list[Scene]:
    """Costs as of real scenes: deeper ones and one shape take several times as long, and some of it is chance."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        depth, shape, frames = rng.uniform(0.2, 1.4), str(rng.choice(["ball", "box"])), int(rng.integers(4, 9))
        each = np.exp(1.5 * depth + 1.5 * (shape == "box") + rng.normal(0, 0.3))
        found.append(Scene(frames, {"press.depth_mm": depth, "indenter": {"shape": shape}}, float(frames * each)))
    return found


def excess(plan: list[Scene], workers: int, learning: bool) -> float:
    """Time until the last scene is made over that of an even share of the work, less 1."""
    order, waiting, busy, now = SceneOrder(), list(plan), list[tuple[float, int, Scene]](), 0.0
    while waiting or busy:
        while waiting and len(busy) < workers:
            at = order.longest(waiting[:COMPARED_SCENES]) if learning else 0  # type: ignore[arg-type]
            scene = waiting.pop(at)
            heapq.heappush(busy, (now + scene.seconds, len(waiting), scene))
        now, _, scene = heapq.heappop(busy)
        order.learn(scene, {"solve": scene.seconds, "compile": 30.0})  # type: ignore[arg-type]
    return now * workers / sum(scene.seconds for scene in plan) - 1


def test_a_batch_ends_sooner_with_long_scenes_first() -> None:
    plain, learnt = (np.mean([excess(scenes(seed), 8, learning) for seed in range(5)]) for learning in (False, True))
    assert plain > 0.1
    assert learnt < plain / 3


def test_the_plans_order_is_kept_until_enough_is_known() -> None:
    order, plan = SceneOrder(), scenes(0, 40)
    known = sorted(plan[:MIN_SCENES_FOR_PREDICTION], key=lambda scene: scene.seconds)
    waiting = plan[MIN_SCENES_FOR_PREDICTION:]
    for scene in known[:-1]:
        order.learn(scene, {"solve": scene.seconds})  # type: ignore[arg-type]
        assert order.longest(waiting) == 0  # type: ignore[arg-type]
    order.learn(known[-1], {})  # its bundle was there already: nothing was timed
    assert order.longest(waiting) == 0  # type: ignore[arg-type]
    order.learn(known[-1], {"solve": known[-1].seconds})  # type: ignore[arg-type]
    chosen = waiting[order.longest(waiting)]  # type: ignore[arg-type]
    assert chosen.seconds > np.quantile([scene.seconds for scene in waiting], 0.8)


@pytest.mark.parametrize("in_order", [True, False])
def test_a_batch_learns_from_its_results(in_order: bool, tmp_path: Path) -> None:
    """Scenes farther along x take longer; one worker keeps the plan's order."""
    rows = make_plan(tmp_path, 24).rows
    batch = _Batch(rows, tmp_path, lambda event: None, in_order=in_order)
    taken = []
    while job := batch.next():
        taken.append(job.row.values["start.x_mm"])
        batch.settle(job, "done", SceneResult(job.row.name, tmp_path, "ok", "", 12, {"solve": np.exp(taken[-1])}))
    planned = [row.values["start.x_mm"] for row in rows]
    assert taken[:MIN_SCENES_FOR_PREDICTION] == planned[:MIN_SCENES_FOR_PREDICTION]
    assert (taken == planned) == in_order
    assert in_order or taken[MIN_SCENES_FOR_PREDICTION:] == sorted(planned[MIN_SCENES_FOR_PREDICTION:], reverse=True)
