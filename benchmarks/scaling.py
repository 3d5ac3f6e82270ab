"""Overhead of running many scenes; `pipeline` measures the speed-up by workers."""

import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results_page import Cell, Level, Result, Say, Table, columns
from benchmarks.workers import scenes
from tacgen import batch
from tacgen.batch.local import Pool
from tacgen.batch.worker_process import memory
from tacgen.bundle.bundle import Writer
from tacgen.bundle.resume import SceneResult, once
from tacgen.recipe.row import Row

ABOUT = "Many scenes by `tacgen run`, in wall-clock seconds, which other work on the machine increases."
PRESS = "trajectory=[{{press: {{depth_mm: 0.4, frames: {frames}}}}}]"
TINY = ("quality={edge_mm: 1.2, dhat_mm: 0.1, spp: 4}", "outputs=[force]", "contact.friction=0", PRESS.format(frames=1))


def bench(level: Level, say: Say) -> Result:
    """Engines, and the memory of a worker."""
    count = {"smoke": 4, "normal": 48, "full": 200}[level]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        tables = [_overhead(count, out, say)]
        if level != "smoke":
            tables.append(_memory(count, out, say))
        return Result(ABOUT, tables)


def nothing(row: Row, folder: Path, *, overwrite: bool = False, on_event: Any = None) -> SceneResult:
    """A scene without computation: claimed, written, read back."""

    def make(path: Path) -> SceneResult:
        known = {"recipe": row.document(), "scene_index": row.index, "seed": row.seed, "sensor": row.sensor.name}
        known |= {"sensor_sha256": row.sensor_sha256, "solver": "none", "input_key": row.key}
        with Writer(path, known, 1) as writer:
            writer.append({"/frames/force": np.array([0.0, 0.0, -row.index])})
            writer.finish()
        return SceneResult(row.name, path, "ok", "", row.frames, {"solve": 0.0})

    return once(row, folder, make, overwrite=overwrite)


def _overhead(count: int, out: Path, say: Say) -> Table:
    """Overhead of an engine per scene, measured on scenes without computation."""
    plan_of = scenes(count, TINY)
    start = time.perf_counter()
    for row in plan_of.rows:
        nothing(row, out / "alone")
    bare = 1000 * (time.perf_counter() - start) / count
    rows: list[list[Cell]] = [["no engine", bare, None, None]]
    for engine in ("local", "dask"):
        if engine == "dask" and not find_spec("distributed"):
            continue
        ends: list[float] = []
        spent: list[float] = []

        def on_event(event: dict[str, Any], ends: list[float] = ends, spent: list[float] = spent) -> None:
            ends.append(time.perf_counter())
            spent.append(time.process_time())

        batch.run(plan_of, out / engine, engine=engine, task="benchmarks.scaling:nothing", on_event=on_event)
        step = 1000 * float(np.median(np.diff(ends)))  # median: without the start of workers
        here = 1000 * (spent[-1] - spent[0]) / (count - 1)
        rows.append([engine, step, step - bare, here])
        say(f"{engine}: {step - bare:+.1f} ms a scene")
    heads = columns("engine", "ms a scene: .1f", "beyond a bundle's own: +.1f", "its own processor: .1f")
    return Table("Engines", heads, rows, "Scenes without computation: claimed, written, read back.")


def _memory(count: int, out: Path, say: Say) -> Table:
    """Memory of one worker over many scenes, which should not grow."""
    held: list[float] = []
    with Pool() as pool:

        def on_event(event: dict[str, Any]) -> None:
            if event["event"] == "scene":
                held.append(1000 * memory(pool.workers[0].process.pid))

        pool.run(scenes(count, TINY).rows, out / "flat", on_event=on_event)
    part = max(1, count // 10)
    start, end = float(np.median(held[part : 2 * part])), float(np.median(held[-part:]))
    say(f"memory: {start:.0f} MB, then {end:.0f} MB")
    heads = columns("scenes: d", "after a tenth [MB]: .0f", "after all [MB]: .0f", "a scene [kB]: +.0f")
    return Table("Memory of a worker", heads, [[count, start, end, 1000 * (end - start) / count]])
