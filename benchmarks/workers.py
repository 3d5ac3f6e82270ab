"""Frames a second on one and several workers, and in as many independent processes without an engine."""

import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results_page import Cell, Plot, Say, Series, Table, columns, in_own_process
from tacgen import batch
from tacgen.batch import pipeline
from tacgen.recipe import assets, plan

HALF = 4  # frames of the press, and of the slide
WORK = (
    "quality=draft",
    "outputs=[force, traction, height, markers, rgb]",
    "contact.friction=0.6",
    f"trajectory=[{{press: {{depth_mm: 0.8, frames: {HALF}}}}}, {{slide: {{x_mm: 0.6, frames: {HALF}}}}}]",
)
SMOKE = ("quality={edge_mm: 1.2, dhat_mm: 0.1, spp: 4}", "outputs=[force, traction]")


def scenes(count: int, sets: tuple[str, ...]) -> plan.Plan:
    """Presses of the ball of the batch recipe at different positions."""
    vary = f"vary={{method: random, samples: {count}, over: {{start.x_mm: {{uniform: [-4, 4]}}}}}}"
    return plan.load(assets.recipe_path("batch"), (*sets, vary))


def workers(each: int, many: list[int], say: Say, sets: tuple[str, ...] = WORK) -> tuple[Table, Plot]:
    """Run `each` scenes per worker on each number of workers in `many`."""
    whole, rows, rates, alone = each * many[-1], list[list[Cell]](), list[float](), list[float]()
    every = scenes(whole, sets)
    frames = every.rows[0].frames
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        batch.run(plan.Plan("warm", every.rows[:1], every.frames[:1]), out / "warm", workers=1)  # compile
        for n in many:
            some = every.rows[: each * n]
            ends = list[float]()

            def on_event(event: dict[str, Any], ends: list[float] = ends) -> None:
                if event["event"] == "scene":
                    ends.append(time.perf_counter())

            started = time.perf_counter()
            part = plan.Plan("some", some, every.frames[: each * n])
            results = batch.run(part, out / f"on{n}", workers=n, on_event=on_event)
            # seconds of a worker for a scene, while all workers are busy
            scene = n * (ends[-n] - ends[n - 1]) / (len(some) - 2 * n + 1)
            rates.append(frames * n / scene)
            alone.append(_without_engine(whole, len(some), n, out, sets))
            pairs = [(one.path, out / f"on{many[0]}" / one.path.name) for one in results[:each]]
            same = "yes" if all(a.read_bytes() == b.read_bytes() for a, b in pairs) else "NO"
            efficiency = rates[-1] / rates[0] / n
            rows.append([n, ends[0] - started - scene, rates[-1], efficiency, alone[0] / alone[-1], same])
            say(f"{n} workers: {rates[-1]:.2f} frames a second, efficiency {efficiency:.2f}, {rows[-1][4]:.2f} without")
    heads = columns("workers: d", "start [s]: .1f", "frames a second: .2f", "efficiency: .2f", "without an engine: .2f")
    heads |= columns("equal bytes")
    note = (
        f"{each} scenes per worker of {frames} frames at `draft` on the Mini: force, traction, height, markers,"
        " rgb. Start: time until a worker begins its first scene; the rate is measured after that. Without an"
        " engine: as many independent processes."
    )
    series = [
        Series("measured", [float(n) for n in many], rates),
        Series("in proportion", [float(n) for n in many], [rates[0] * n for n in many], line=True),
    ]
    return Table("Workers", heads, rows, note), Plot("Frames a second", "workers", "frames a second", series)


def _without_engine(whole: int, count: int, many: int, out: Path, sets: tuple[str, ...]) -> float:
    """Seconds per scene in parallel processes, each with a share of the scenes."""
    with ThreadPoolExecutor(many) as threads:  # each thread waits for a process
        shares = [
            threads.submit(in_own_process, "benchmarks.workers:share", whole, count, i, many, str(out), sets)
            for i in range(many)
        ]
        return float(np.mean([one.result() for one in shares]))


def share(whole: int, count: int, first: int, step: int, out: str, sets: list[str]) -> float:
    """Make every `step`-th of `count` scenes in this process; mean seconds per scene after the first."""
    clock = []
    with tempfile.TemporaryDirectory(dir=out) as folder:
        for row in scenes(whole, tuple(sets)).rows[first:count:step]:
            pipeline.run_scene(row, Path(folder))
            clock.append(time.perf_counter())
    return (clock[-1] - clock[0]) / (len(clock) - 1)
