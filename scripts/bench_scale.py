"""What running many scenes costs beyond the scenes: overhead, efficiency, memory, frames read a second.

    python scripts/bench_scale.py [--scenes 200] [--workers 2] [--only overhead efficiency memory reading]

overhead    stand-in scenes without work: milliseconds a scene of each engine; claim, bundle and reading back apart
efficiency  small real scenes (coarse, two frames, force alone) on one worker and on several, and without an engine in
            as many processes that know nothing of each other: what the machine itself loses when all its cores work
memory      of one worker over those scenes: after the first tenth, and after all
reading     TactileDataset at random, RGB and force, 320 x 240, two loader workers: frames a second, and what dominates

Wall-clock figures need a machine that does nothing else; processor seconds, printed beside them, bear company better.
"""

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tacgen import assets, batch, plan
from tacgen.batch.local import Pool
from tacgen.batch.watch import memory
from tacgen.bundle import Writer
from tacgen.resume import SceneResult, once

SMALL = ("quality={edge_mm: 1.2, dhat_mm: 0.1, spp: 4}", "outputs=[force]", "contact.friction=0")
PRESS = "trajectory=[{press: {depth_mm: 0.4, frames: 2}}]"


def scenes(count: int) -> plan.Plan:
    """Small presses of the batch recipe's ball at different places."""
    vary = f"vary={{method: random, samples: {count}, over: {{start.x_mm: {{uniform: [-4, 4]}}}}}}"
    return plan.load(assets.recipe_path("batch"), (*SMALL, PRESS, vary))


def nothing(row: plan.Row, folder: Path, *, overwrite: bool = False, say: Any = None) -> SceneResult:
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
def timed(found: dict[str, float]) -> Iterator[None]:
    """Wall-clock seconds, and processor seconds of this process and of children that have ended."""
    before, start = _processor(), time.perf_counter()
    yield
    found["wall"], found["processor"] = time.perf_counter() - start, _processor() - before


def _processor() -> float:
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in used)


def overhead(count: int, workers: int, out: Path) -> None:
    rows = scenes(count)
    alone: dict[str, float] = {}
    with timed(alone):
        for row in rows.rows:
            nothing(row, out / "alone")
    wall, used = (1000 * alone[kind] / count for kind in ("wall", "processor"))
    print(f"overhead: a bundle without work takes {wall:.1f} ms, {used:.1f} ms of the processor")
    for engine in batch.ENGINES:
        ends: list[float] = []
        spent: list[float] = []

        def hear(event: dict[str, Any], ends: list[float] = ends, spent: list[float] = spent) -> None:
            ends.append(time.perf_counter())
            spent.append(time.process_time())

        batch.run(rows, out / engine, engine=engine, task="bench_scale:nothing", hear=hear)
        step = 1000 * float(np.median(np.diff(ends)))  # workers have started by then
        here = 1000 * (spent[-1] - spent[0]) / (count - 1)
        print(
            f"  {engine:<6} {step:.1f} ms from scene to scene: {step - wall:+.1f} ms; the engine itself {here:.1f} ms"
        )


def efficiency(count: int, workers: int, out: Path) -> None:
    rows = scenes(count)
    found = {}
    for n in (1, workers):
        found[n] = dict[str, float]()
        with timed(found[n]):
            batch.run(rows, out / f"on{n}", workers=n)
    one, many = found[1], found[workers]
    print(f"efficiency: {count} scenes, {one['wall']:.1f} s on one worker, {many['wall']:.1f} s on {workers}")
    print(f"  by wall clock {one['wall'] / many['wall'] / workers:.3f}")
    ratio = one["processor"] / many["processor"]
    print(f"  by processor time {ratio:.3f} ({one['processor']:.1f} s, {many['processor']:.1f} s)")
    apart = _apart(count, workers, out)
    print(f"  the same in {workers} processes of their own: {apart:.1f} s; against these {apart / many['wall']:.3f}")
    pairs = ((path, out / "on1" / path.name) for path in (out / f"on{workers}").glob("*.h5"))
    print(f"  equal bytes: {all(a.read_bytes() == b.read_bytes() for a, b in pairs)}")


def _apart(count: int, workers: int, out: Path) -> float:
    """Wall-clock seconds of the same scenes in processes side by side, a share each, no engine."""
    code = "import sys, bench_scale as b; b.share(*map(int, sys.argv[1:4]), b.Path(sys.argv[4]))"
    start = time.perf_counter()
    started = [
        subprocess.Popen([sys.executable, "-c", code, str(count), str(i), str(workers), str(out / "apart")])
        for i in range(workers)
    ]
    codes = [process.wait() for process in started]
    if any(codes):
        raise SystemExit("a process of the comparison failed")
    return time.perf_counter() - start


def share(count: int, i: int, n: int, out: Path) -> None:
    """Every n-th scene from the i-th, one after the other."""
    from tacgen import pipeline

    for row in scenes(count).rows[i::n]:
        pipeline.run_scene(row, out)


def flat(count: int, workers: int, out: Path) -> None:
    used: list[float] = []
    with Pool() as pool:

        def hear(event: dict[str, Any]) -> None:
            if event["event"] == "scene":
                used.append(1000 * memory(pool.workers[0].process.pid))

        pool.run(scenes(count).rows, out / "flat", hear=hear)
    tenth = max(1, count // 10)
    start, end = np.median(used[tenth : 2 * tenth]), np.median(used[-tenth:])
    rise = 1000 * (end - start) / count
    print(f"memory: {start:.0f} MB after {tenth} scenes, {end:.0f} MB after {count}: {rise:+.0f} kB a scene")


def reading(count: int, workers: int, out: Path) -> None:
    from torch.utils.data import DataLoader

    from tacgen import pack, source
    from tacgen.torch import TactileDataset

    row = plan.load(assets.recipe_path("quickstart"), ("quality=draft", "outputs=[force, rgb]")).rows
    batch.run(plan.Plan("reading", row), out / "one")
    for i in range(1, 60):  # of different names, so that no cache can help
        shutil.copy(out / "one" / "scene-00000.h5", out / "one" / f"scene-{i:05d}.h5")
    folder = pack.pack(source.scenes(out / "one"), out / "packed", 32).folder
    for kind in (out / "one", folder):
        data = TactileDataset(kind)
        order = np.random.default_rng(0).permutation(len(data))
        for i in order[:: len(data) // 60]:
            data[int(i)]  # files open
        start = time.process_time()
        for i in order:
            data[int(i)]
        each = 1000 * (time.process_time() - start) / len(order)
        loader = DataLoader(data, batch_size=64, shuffle=True, num_workers=2, persistent_workers=True)
        for _ in range(2):  # the first starts the workers
            start = time.perf_counter()
            seen = sum(len(part["force"]) for part in loader)
            rate = seen / (time.perf_counter() - start)
        print(f"reading {kind.name:<7} {each:.2f} ms of the processor a frame, {rate:.0f} frames/s from two workers")
    _where(TactileDataset(folder))


def _where(data: Any) -> None:
    """How much of the time is inflating."""
    import cProfile
    import pstats

    profile = cProfile.Profile()
    profile.enable()
    for i in range(0, len(data), 2):
        data[i]
    profile.disable()
    entries = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    total = sum(entry[2] for entry in entries.values())
    name, entry = max(entries.items(), key=lambda item: item[1][2])
    print(f"  {name[2]}: {100 * entry[2] / total:.0f} % of it")


BENCHES = {"overhead": overhead, "efficiency": efficiency, "memory": flat, "reading": reading}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", nargs="+", choices=BENCHES, default=list(BENCHES))
    args = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    for name in args.only:
        with tempfile.TemporaryDirectory() as folder:
            BENCHES[name](args.scenes, args.workers, Path(folder))


if __name__ == "__main__":
    main()
