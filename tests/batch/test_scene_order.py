"""Long scenes are begun first: which these are is learnt from the scenes that are made."""

import heapq
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers.scenes import make_plan

from tacgen.batch.local import _Batch
from tacgen.batch.scene_order import COMPARED_SCENES, MIN_SCENES_FOR_PREDICTION, SceneOrder
from tacgen.bundle.resume import SceneResult


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
