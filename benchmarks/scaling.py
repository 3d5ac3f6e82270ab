"""What running many scenes costs beyond the scenes, and where the time of one goes."""

import json
import resource
import shutil
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results_page import (
    Cell,
    Level,
    Plot,
    Result,
    Say,
    Series,
    Table,
    columns,
    core_count,
    in_own_process,
    in_own_processes,
)
from tacgen import batch, pipeline
from tacgen.batch.local import Pool
from tacgen.batch.worker_process import memory
from tacgen.bundle.bundle import Writer
from tacgen.bundle.resume import SceneResult, once
from tacgen.recipe import assets, plan

ABOUT = (
    "Many scenes by `tacgen run --workers`, and where the time of one scene goes, by the bundles' own timing files."
    " Wall clock, which other work on the machine lengthens; processor seconds, printed beside it, depend less on that."
)
PRESS = "trajectory=[{{press: {{depth_mm: 0.4, frames: {frames}}}}}]"
TINY = ("quality={edge_mm: 1.2, dhat_mm: 0.1, spp: 4}", "outputs=[force]", "contact.friction=0", PRESS.format(frames=1))
WORK = ("quality={edge_mm: 0.8, dhat_mm: 0.06}", "outputs=[force, traction]", PRESS.format(frames=2))
STAGES = ("mesh", "solve", "fields", "render", "bundle")
ONE = "{press: {depth_mm: 0.4, frames: 1}}"
MOVES = "{press: {depth_mm: 0.8, frames: 2}}, {slide: {x_mm: 0.6, frames: 2}}, {twist: {angle_deg: 8, frames: 1}}"


def bench(level: Level, say: Say) -> Result:
    """Stages of a scene, workers, engines, memory and reading."""
    count, few = {"smoke": (4, 2), "normal": (48, 16), "full": (200, 100)}[level]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        if level == "smoke":
            table, plot = _workers(few, [1], out, say)
            return Result(ABOUT, [table], [plot])
        cores = core_count()
        many = sorted({1, *(2**k for k in range(1, 8) if 2**k <= cores), cores})
        table, plot = _workers(few, many, out, say)
        more = [_overhead(count, out, say), _memory(count, out, say)]
        if find_spec("torch"):
            more.append(_reading(out, say))
        return Result(ABOUT, [_stages(say), table, *more], [plot])


def scenes(count: int, sets: tuple[str, ...] = TINY) -> plan.Plan:
    """Presses of the batch recipe's ball at different places."""
    vary = f"vary={{method: random, samples: {count}, over: {{start.x_mm: {{uniform: [-4, 4]}}}}}}"
    return plan.load(assets.recipe_path("batch"), (*sets, vary))


def _stages(say: Say) -> Table:
    """Wall seconds a frame in each stage of a scene with everything that people train on."""
    jobs = [("gelsight_mini", ", markers"), ("digit", ""), ("ninedtact", "")]
    rows: list[list[Cell]] = []
    for (sensor, _), found in zip(jobs, in_own_processes("benchmarks.scaling:stages", jobs), strict=True):
        if isinstance(found, RuntimeError):
            raise found
        for quality, each in found.items():
            total = sum(each)
            shares = ", ".join(f"{stage} {part / total:.0%}" for stage, part in zip(STAGES, each, strict=True))
            rows.append([sensor, quality, *each, total, shares])
            say(f"{sensor} {quality}: {total:.2f} s a frame: {shares}")
    heads = columns("sensor", "quality", *(f"{stage} [s]: .3f" for stage in STAGES), "s a frame: .2f", "shares")
    note = (
        "A ball pressed, slid and twisted in 5 frames: force, traction, height, stress, rgb, and markers on the Mini;"
        " on one core, with others beside it on the rest. Mesh and render include what is made ready once a scene."
    )
    return Table("Where the time goes", heads, rows, note)


def stages(sensor: str, dots: str) -> dict[str, list[float]]:
    """Seconds a frame of each of STAGES, by quality."""
    out: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for part, quality, moves in (("warm", "draft", ONE), ("timed", "draft", MOVES), ("timed", "default", MOVES)):
            sets = (
                f"sensor={sensor}",
                f"trajectory=[{moves}]",
                f"quality={quality}",
                f"outputs=[force, traction, height, stress, rgb{dots}]",
            )
            row = plan.load(assets.recipe_path("quickstart"), sets).rows[0]
            found = pipeline.run_scene(row, Path(folder) / f"{quality}-{part}")
            if part == "timed":
                seconds = json.loads(found.path.with_suffix(".timing.json").read_text())["seconds"]
                out[quality] = [seconds.get(stage, 0.0) / row.frames for stage in STAGES]
    return out


def _workers(count: int, many: list[int], out: Path, say: Say) -> tuple[Table, Plot]:
    """Real scenes on one worker and on several, and in as many independent processes."""
    whole, rows, rates, alone = max(count, 4 * many[-1]), list[list[Cell]](), list[float](), list[float]()
    every = scenes(whole, WORK)
    batch.run(plan.Plan("warm", every.rows[:1]), out / "warm", workers=1)  # compile
    for n in many:
        some = every.rows[: max(count, 4 * n)]
        ends, found = list[float](), dict[str, float]()

        def on_event(event: dict[str, Any], ends: list[float] = ends) -> None:
            if event["event"] == "scene":
                ends.append(time.perf_counter())

        with _timed(found):
            started = time.perf_counter()
            results = batch.run(plan.Plan("some", some), out / f"on{n}", workers=n, on_event=on_event)
        each = n * (ends[-n] - ends[n - 1]) / (len(some) - 2 * n + 1)  # seconds of a worker, while all were at work
        start = ends[0] - started - each
        rates.append(3600 * n / each)
        alone.append(_without_engine(whole, len(some), n, out))
        pairs = [(one.path, out / "on1" / one.path.name) for one in results[:count]]
        same = all(a.read_bytes() == b.read_bytes() for a, b in pairs)
        efficiency = rates[-1] / rates[0] / n
        rows.append(
            [
                n,
                start,
                rates[-1],
                efficiency,
                alone[0] / alone[-1],
                found["processor"] / len(some),
                "yes" if same else "NO",
            ]
        )
        say(f"{n} workers: {rates[-1]:.0f} scenes an hour, efficiency {efficiency:.2f}, {rows[-1][4]:.2f} without")
    heads = columns(
        "workers: d", "start [s]: .1f", "scenes an hour: .0f", "efficiency: .2f", "without an engine: .2f",
        "processor s a scene: .3f", "equal bytes",
    )  # fmt: skip
    note = (
        f"{count} scenes or more (a press in two frames on a coarse mesh: force and traction). Start: until a worker"
        " begins its first one; the rate is that from there on. Without an engine: as many independent processes, each"
        " with a share of the scenes; what a machine loses when all its cores work is in both."
    )
    series = [
        Series("measured", [float(n) for n in many], rates),
        Series("in proportion", [float(n) for n in many], [rates[0] * n for n in many], line=True),
    ]
    return Table("Workers", heads, rows, note), Plot("Scenes an hour", "workers", "scenes an hour", series)


def _without_engine(whole: int, count: int, workers: int, out: Path) -> float:
    """Seconds a scene in processes side by side, with a share of the scenes each, without an engine."""
    with ThreadPoolExecutor(workers) as threads:  # each waits for a process
        shares = [
            threads.submit(in_own_process, "benchmarks.scaling:share", whole, count, i, workers, str(out))
            for i in range(workers)
        ]
        return float(np.mean([one.result() for one in shares]))


def share(whole: int, count: int, first: int, step: int, out: str) -> float:
    """Every `step`-th of `count` scenes, one after the other, in this process: seconds of each after the first."""
    clock = []
    with tempfile.TemporaryDirectory(dir=out) as folder:
        for row in scenes(whole, WORK).rows[first:count:step]:
            pipeline.run_scene(row, Path(folder))
            clock.append(time.perf_counter())
    return (clock[-1] - clock[0]) / (len(clock) - 1)


def nothing(row: plan.Row, folder: Path, *, overwrite: bool = False, on_event: Any = None) -> SceneResult:
    """A scene without work: claimed, written, read back."""

    def make(path: Path) -> SceneResult:
        known = {"recipe": row.document(), "scene_index": row.index, "seed": row.seed, "sensor": row.sensor.name}
        known |= {"sensor_sha256": row.sensor_sha256, "solver": "none", "input_key": row.key}
        with Writer(path, known, 1) as writer:
            writer.append({"/frames/force": np.array([0.0, 0.0, -row.index])})
            writer.finish()
        return SceneResult(row.name, path, "ok", "", row.frames, {"solve": 0.0})

    return once(row, folder, make, overwrite=overwrite)


@contextmanager
def _timed(found: dict[str, float]) -> Iterator[None]:
    """Wall-clock seconds, and processor seconds of this process and of children that have ended."""
    before, start = _processor(), time.perf_counter()
    yield
    found["wall"], found["processor"] = time.perf_counter() - start, _processor() - before


def _processor() -> float:
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in used)


def _overhead(count: int, out: Path, say: Say) -> Table:
    """Stand-in scenes without work: what an engine takes for each."""
    plan_of = scenes(count)
    alone: dict[str, float] = {}
    with _timed(alone):
        for row in plan_of.rows:
            nothing(row, out / "alone")
    bare = 1000 * alone["wall"] / count
    rows: list[list[Cell]] = [["no engine", bare, None, None]]
    for engine in batch.ENGINES:
        if engine == "dask" and not find_spec("distributed"):
            continue
        ends: list[float] = []
        spent: list[float] = []

        def on_event(event: dict[str, Any], ends: list[float] = ends, spent: list[float] = spent) -> None:
            ends.append(time.perf_counter())
            spent.append(time.process_time())

        batch.run(plan_of, out / engine, engine=engine, task="benchmarks.scaling:nothing", on_event=on_event)
        step = 1000 * float(np.median(np.diff(ends)))  # workers have started by then
        here = 1000 * (spent[-1] - spent[0]) / (count - 1)
        rows.append([engine, step, step - bare, here])
        say(f"{engine}: {step - bare:+.1f} ms a scene")
    heads = columns("engine", "ms a scene: .1f", "beyond a bundle's own: +.1f", "its own processor: .1f")
    return Table("Engines", heads, rows, "Scenes without work: claimed, written, read back.")


def _memory(count: int, out: Path, say: Say) -> Table:
    """Of one worker over many scenes: it should not grow."""
    held: list[float] = []
    with Pool() as pool:

        def on_event(event: dict[str, Any]) -> None:
            if event["event"] == "scene":
                held.append(1000 * memory(pool.workers[0].process.pid))

        pool.run(scenes(count).rows, out / "flat", on_event=on_event)
    part = max(1, count // 10)
    start, end = float(np.median(held[part : 2 * part])), float(np.median(held[-part:]))
    say(f"memory: {start:.0f} MB, then {end:.0f} MB")
    heads = columns("scenes: d", "after a tenth [MB]: .0f", "after all [MB]: .0f", "a scene [kB]: +.0f")
    return Table("Memory of a worker", heads, [[count, start, end, 1000 * (end - start) / count]])


def _reading(out: Path, say: Say) -> Table:
    """Frames at random by PyTorch's DataLoader, RGB and force, 320 x 240, two loader workers."""
    from torch.utils.data import DataLoader

    from tacgen.bundle import dataset, pack
    from tacgen.torch import TactileDataset

    rows = plan.load(
        assets.recipe_path("quickstart"), ("quality=draft", "outputs=[force, rgb]", PRESS.format(frames=5))
    ).rows
    batch.run(plan.Plan("reading", rows), out / "one")
    for i in range(1, 200):  # of different names, so that no cache can help
        shutil.copy(out / "one" / "scene-00000.h5", out / "one" / f"scene-{i:05d}.h5")
    packed = pack.pack(dataset.scenes(out / "one"), out / "packed", 32).folder
    table: list[list[Cell]] = []
    for name, kind in (("bundles", out / "one"), ("packed", packed)):
        data = TactileDataset(kind)
        order = np.random.default_rng(0).permutation(len(data))
        for i in order[:: len(data) // 60]:
            data[int(i)]  # files open
        start = time.process_time()
        for i in order:
            data[int(i)]
        each = 1000 * (time.process_time() - start) / len(order)
        loader: Any = DataLoader(data, batch_size=64, shuffle=True, num_workers=2, persistent_workers=True)
        rates = []
        for _ in range(3):  # the first starts the workers
            start = time.perf_counter()
            rates.append(sum(len(part["force"]) for part in loader) / (time.perf_counter() - start))
        table.append([name, each, min(rates[1:]), max(rates[1:])])
        say(f"reading {name}: {rates[-1]:.0f} frames a second")
    heads = columns("from", "processor ms a frame: .2f", "frames a second, from: .0f", "to: .0f")
    return Table("Reading for training", heads, table, "RGB and force, 320 x 240, at random, two loader workers.")
