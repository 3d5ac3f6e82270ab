"""Cost of a frame from recipe to bundle: by stage, output and sensor, with empty caches, and on several workers."""

import resource
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import results_page, workers
from tacgen.base import machine
from tacgen.base.clock import Clock

ABOUT = (
    "A ball of 4 mm pressed (1 mm; DIGIT 0.6), slid 1 mm and twisted 10 deg with friction 0.6, from recipe to"
    " bundle: processor seconds a frame, a process a core, compiled before. The mesh and the setup of images"
    " are divided among the scene's frames."
)
DEPTHS = {"gelsight_mini": 1.0, "digit": 0.6, "ninedtact": 1.0}  # [mm]
MARKED = ("gelsight_mini",)  # sensors with markers
MOVES = (
    "trajectory=[{{press: {{depth_mm: {depth}, frames: {n[0]}}}}}, {{slide: {{x_mm: 1, frames: {n[1]}}}}},"
    " {{twist: {{angle_deg: 10, frames: {n[2]}}}}}]"
)
BALL = ("indenter={shape: sphere, radius_mm: 4}", "contact.friction=0.6")
FRAMES, FEW = (8, 7, 5), (1, 1, 1)  # of each movement: timed, and before the measurement
STAGES = ("mesh", "solve", "fields", "render", "bundle")
EVERYTHING = "everything"
FORCE_RGB = "force, rgb"
SHOWN = 0.1  # smaller outputs [ms] and datasets [kB] are left out
SMOKE = "{edge_mm: 1.2, dhat_mm: 0.1, spp: 4}"


def bench(level: results_page.Level, say: results_page.Say) -> results_page.Result:
    """Stages, outputs, bytes and a million frames; the first scene with empty caches; workers."""
    if level == "smoke":
        case = ("gelsight_mini", SMOKE, "traction")
        found = {case: results_page.in_own_process("benchmarks.pipeline:made", *case, FEW)}
        table, plot = workers.workers(2, [1], say, workers.SMOKE)
        return results_page.Result(ABOUT, [_stages(found), *_parts(found), table], [plot])
    jobs = [(s, q, asked, FRAMES) for asked in (EVERYTHING, FORCE_RGB) for s in DEPTHS for q in ("draft", "default")]
    found = {}
    for job, one in zip(jobs, results_page.in_own_processes("benchmarks.pipeline:made", jobs), strict=True):
        if isinstance(one, RuntimeError):
            raise one
        found[job[:3]] = one
        say(f"{', '.join(job[:3])}: {one['total']:.3f} s a frame")
    cores = machine.cores()
    many = sorted({1, *(2**k for k in range(1, 8) if 2**k <= cores), cores})
    table, plot = workers.workers(4, many, say)
    return results_page.Result(ABOUT, [_stages(found), *_parts(found), _first(say), table], [plot])


def row(sensor: str, quality: str, asked: str, frames: tuple[int, int, int]) -> Any:
    """The scene with these outputs, `EVERYTHING` or a list of names."""
    from tacgen.outputs import OUTPUT_NAMES
    from tacgen.recipe import assets, plan

    names = ", ".join(n for n in OUTPUT_NAMES if n != "markers" or sensor in MARKED) if asked == EVERYTHING else asked
    moves = MOVES.format(depth=DEPTHS[sensor], n=frames)
    sets = (f"sensor={sensor}", *BALL, moves, f"quality={quality}", f"outputs=[{names}]")
    return plan.load(assets.recipe_path("quickstart"), sets).rows[0]


def made(sensor: str, quality: str, asked: str, frames: tuple[int, int, int]) -> dict[str, Any]:
    """Make a scene in this process after a smaller one.

    Returns, per frame: `total` processor seconds, `stages` and `outputs` the same by stage and output, `bytes` by
    dataset, `size` of the file; and the peak `memory` of the process [MB].
    """
    import h5py

    from tacgen.batch import pipeline
    from tacgen.bundle import bundle
    from tacgen.outputs import OUTPUTS

    spent = defaultdict[str, float](float)

    def timed(name: str, make: Callable[..., Any]) -> Callable[..., Any]:
        def call(data: Any) -> Any:
            start = time.process_time()
            try:
                return make(data)
            finally:
                spent[name] += time.process_time() - start

        return call

    Clock.now = staticmethod(time.process_time)
    for name, one in OUTPUTS.items():
        OUTPUTS[name] = one._replace(frame=timed(name, one.frame), reference=timed(name, one.reference))
    with tempfile.TemporaryDirectory() as folder:
        pipeline.run_scene(row(sensor, quality, asked, FEW), Path(folder) / "warm")
        spent.clear()
        start = time.process_time()
        result = pipeline.run_scene(row(sensor, quality, asked, frames), Path(folder) / "timed")
        total = time.process_time() - start
        with h5py.File(result.path) as file:
            size = {path: file[path].id.get_storage_size() for path in bundle.read(result.path).shapes}
        whole = result.path.stat().st_size
    n = result.frames
    return {
        "total": total / n,
        "stages": {stage: result.seconds.get(stage, 0.0) / n for stage in STAGES},
        "outputs": {name: seconds / n for name, seconds in spent.items()},
        "bytes": {path: count / n for path, count in size.items()},
        "size": whole / n,
        "memory": results_page.peak_memory(),
    }


Found = dict[tuple[str, str, str], dict[str, Any]]


def _stages(found: Found) -> results_page.Table:
    rows: list[list[results_page.Cell]] = []
    for (sensor, quality, asked), one in found.items():
        parts = [1000 * one["stages"][stage] for stage in STAGES]
        rows.append([sensor, quality, asked, *parts, 1000 * one["total"] - sum(parts), 1000 * one["total"]])
        rows[-1] += [one["size"] / 1000, one["memory"], one["total"] * 1e6 / 3600, one["size"] / 1000]
    heads = results_page.columns(
        "sensor", "quality", "asked for", *(f"{stage} [ms]: .0f" for stage in STAGES), "other [ms]: .0f",
        "ms a frame: .0f", "kB a frame: .0f", "memory [MB]: .0f", "core-hours a million: .0f", "GB a million: .0f",
    )  # fmt: skip
    note = "Memory: peak of the process. The last two columns are for a million frames of scenes like this."
    return results_page.Table("Where the time goes", heads, rows, note)


def _parts(found: Found) -> list[results_page.Table]:
    """Milliseconds of each output and kilobytes of each dataset, in the scenes with all outputs."""
    whole = {(sensor, quality): one for (sensor, quality, asked), one in found.items() if asked != FORCE_RGB}
    heads = [f"{sensor} {quality}" for sensor, quality in whole]

    def table(title: str, kind: str, unit: float, note: str) -> results_page.Table:
        parts = [{name: unit * value for name, value in one[kind].items()} for one in whole.values()]
        most = {name: max(part.get(name, 0.0) for part in parts) for part in parts for name in part}
        rows: list[list[results_page.Cell]] = [
            [name, *(part.get(name) for part in parts)]
            for name in sorted(most, key=lambda name: -most[name])
            if most[name] >= SHOWN
        ]
        return results_page.Table(title, {kind: "", **dict.fromkeys(heads, ".1f")}, rows, note)

    stored = "As stored; datasets of the whole scene are divided by its frames."
    shared = "Data shared by several outputs count for the first of them in the bundle's order."
    return [
        table("Milliseconds a frame of each output", "outputs", 1e3, shared),
        table("Kilobytes a frame of each dataset", "bytes", 1e-3, stored),
    ]


def _first(say: results_page.Say) -> results_page.Table:
    """The quickstart on every sensor, with empty caches and then with filled ones."""
    rows: list[list[results_page.Cell]] = []
    for sensor in DEPTHS:
        with tempfile.TemporaryDirectory() as folder:
            for caches in ("empty", "filled"):
                start = time.time()
                kept = {"TACGEN_CACHE_DIR": folder, "TACGEN_CODE_DIR": f"{folder}/code"}
                found = results_page.in_own_process("benchmarks.pipeline:first", sensor, start, env=kept)
                whole = [time.time() - start, found["processor"], found["memory"]]
                rows.append([sensor, caches, *found["to_frame"], *whole])
                say(f"{sensor}, caches {caches}: {found['to_frame'][0]:.1f} s to the first frame")
    heads = results_page.columns(
        "sensor", "caches", "s to the first frame: .1f", "s in all: .1f", "processor in all: .1f", "memory [MB]: .0f"
    )
    note = (
        "The quickstart (15 frames, `default`) as by `tacgen run`: caches of compiled code and images are empty,"
        " or filled by the line above. Wall-clock seconds including the start of Python, and processor seconds of"
        " all processes."
    )
    return results_page.Table("The first scene", heads, rows, note)


def first(sensor: str, started: float) -> dict[str, Any]:
    """Make the quickstart by a worker process; `started` is the time at which this process was started."""
    from tacgen.batch.local import Pool
    from tacgen.recipe import assets, plan

    rest = () if sensor in MARKED else ("outputs=[force, traction, height, stress, rgb]",)
    reached = list[float]()

    def on_event(event: dict[str, Any]) -> None:
        if event["event"] == "frame" and not reached:
            reached.append(time.time() - started)

    scene = plan.load(assets.recipe_path("quickstart"), (f"sensor={sensor}", *rest)).rows[0]
    with tempfile.TemporaryDirectory() as folder, Pool() as pool:
        pool.run([scene], Path(folder), on_event=on_event)
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    seconds = sum(one.ru_utime + one.ru_stime for one in used)
    return {"to_frame": reached, "processor": seconds, "memory": used[1].ru_maxrss / 1e3}
