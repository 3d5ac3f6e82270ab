"""A GPU beside the cores of its machine: scenes solved alone, scenes to disk, and pictures.

    python -m benchmarks.gpu frames [--draws 94000 1500] [--compare 160] [--seconds 190]
    python -m benchmarks.gpu disk [--scenes 1000] [--outputs force rgb] [--again]
    python -m benchmarks.gpu pictures [--sensors gelsight_mini digit] [--qualities draft default]

`frames`: ordinary scenes (benchmarks/draws.py) by the batch engine, in several processes that share the GPU, those that
take long at last; some of them by the CPU engine first, a process a core, whose forces are compared. Frames count when
their scene ends. `disk`: `tacgen run` makes balls pressed into the Mini, ten frames each, after a few that compile, and
with --again all a second time, to compare the bytes. `pictures`: dents of balls, without solving; milliseconds a frame
of a core and of the GPU, the largest difference of light where the CPU interpolates nothing, over the largest light,
and how far from those, in counts of 8 bits without noise, the CPU's usual pictures and the GPU's are.
"""

import argparse
import json
import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks import results_page
from benchmarks.draws import drawn
from benchmarks.reference_runs import forces_of, row_of, solve_frames
from tacgen import mechanics
from tacgen.base.errors import UserError
from tacgen.batch.cuda_engine import GPU_MEMORY_SHARE, MAX_PLANNED_SCENES, solvers
from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene
from tacgen.optics.adaptive_sampling import SamplingTolerance
from tacgen.optics.hertz_dent import BallDent
from tacgen.recipe import assets, plan, scene_of_row
from tacgen.render.images import Clear, Renderer

if TYPE_CHECKING:
    from tacgen.tensor_engine.planning import Planned

Array = np.ndarray
Ends = list[tuple[float, int]]  # when scenes ended [s], and how many frames they have
WINDOW = 10  # [s] in which frames are counted: at the end few scenes are left
SPAWN = multiprocessing.get_context("spawn")
BEGUN: list[float] = []  # when this process, which is warm since, began [s by the clock]
WARM = {"frames": 3, "disk": 20}  # scenes made before the time counts, which compile
EVERYWHERE = SamplingTolerance(1, 0.0, 0.0)  # no sample of a picture is interpolated
DRAWN = 20  # times that the GPU draws all frames
QUERY = "nvidia-smi", "--query-gpu=power.draw", "--format=csv,noheader,nounits", "-l", "1"
BALLS = """\
tacgen: 1
name: balls
sensor: gelsight_mini
indenter: {shape: sphere, radius_mm: 4.0}
trajectory:
  - press: {depth_mm: 1.0, frames: 10}
contact: {friction: 0.6}
vary:
  samples: 20
  seed: 3
  over:
    indenter.radius_mm: {uniform: [2.5, 5.0]}
    start.x_mm: {uniform: [-3, 3]}
    start.y_mm: {uniform: [-3, 3]}
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("what", choices=("frames", "disk", "pictures"))
    ask.add_argument("--draws", type=int, nargs=2, default=(0, 256), metavar=("FIRST", "COUNT"))
    ask.add_argument("--scenes", type=int, default=1000, help="to disk by the GPU")
    ask.add_argument("--alone", type=int, default=160, help="to disk by the cores")
    ask.add_argument("--outputs", nargs="*", default=("force", "rgb"), help="to disk")
    ask.add_argument("--again", action="store_true", help="a second time to disk by the GPU, for the bytes")
    ask.add_argument("--sensors", nargs="*", default=("gelsight_mini", "digit", "gelsight_r15"), help="of pictures")
    ask.add_argument("--qualities", nargs="*", default=("draft", "default"), help="of pictures")
    ask.add_argument("--quality", default="draft")
    ask.add_argument("--compare", type=int, default=0, help="scenes to solve by the CPU engine too")
    ask.add_argument("--workers", type=int, default=os.cpu_count(), help="processes, one a core")
    ask.add_argument("--processes", type=int, default=solvers(os.cpu_count() or 1, 1), help="that share the GPU")
    ask.add_argument("--seconds", type=float, default=300.0, help="each engine stops after so long")
    ask.add_argument("--device", default="cuda:0", help="cpu: PyTorch's CPU backend, as a test")
    told = ask.parse_args(arguments)
    os.environ.update(results_page.one_thread())  # of the other processes too
    os.environ.setdefault("PYTORCH_CUDA_ALLOC_CONF", "expandable_segments:True")  # calls have many sizes
    {"frames": frames, "disk": disk, "pictures": pictures}[told.what](told)


def rates(ends: Ends, seconds: float) -> str:
    """Frames a second in all, after the first scene, and where they are most."""
    count, (first, before), last = sum(n for _, n in ends), ends[0], ends[-1][0]
    most = max(sum(n for at, n in ends if start <= at < start + WINDOW) for start, _ in ends)
    return (
        f"{count} frames in {seconds:.1f} s: {count / seconds:.1f} a second; the first scene at {first:.1f} s, then"
        f" {(count - before) / max(last - first, 1e-9):.1f} a second, {most / WINDOW:.1f} in the best {WINDOW} s"
    )


class Board(list[float]):
    """Power that all GPUs' boards draw together [W], second by second."""

    def __str__(self) -> str:
        return f"{sum(self) / 1e3:.1f} kJ of the GPU's board, at most {max(self):.0f} W" if self else "no GPU's board"


@contextmanager
def watched() -> Iterator[Board]:
    """A board that is read until the end; an empty one where there is no `nvidia-smi`."""
    board = Board()
    try:
        gpus = subprocess.run(("nvidia-smi", "-L"), capture_output=True, text=True, check=False).stdout.splitlines()
        process = subprocess.Popen(QUERY, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    except OSError:
        yield board
        return

    def read() -> None:
        assert process.stdout is not None
        for k, line in enumerate(process.stdout):  # one GPU after another
            board.extend([0.0] * (k % max(len(gpus), 1) == 0))
            with suppress(ValueError):
                board[-1] += float(line)

    thread = threading.Thread(target=read, daemon=True)
    with process:
        thread.start()
        try:
            yield board
        finally:
            process.terminate()
            thread.join()


# frames: ordinary scenes, solved alone


class Solved(NamedTuple):
    """Scenes that a process has solved: forces (frames, 3) [N] by draw, when scenes ended, why others did not, which
    were put off, and when it began and ended [s by the clock]."""

    forces: dict[int, Array]
    ends: Ends
    left: dict[int, str]
    late: list[int]
    begun: float
    ended: float


class Alone(NamedTuple):
    """A draw solved by the CPU engine: forces (frames, 3) [N], frames before the first damped one, processor seconds,
    and whether it was the first of its process, which compiles."""

    draw: int
    forces: Array
    stable: int
    seconds: float
    first: bool


def frames(told: argparse.Namespace) -> None:
    """Ordinary scenes by the batch engine, some by the CPU engine, and how far their forces differ."""
    from tacgen.tensor_engine.planning import divided

    draws = range(told.draws[0], sum(told.draws))
    with SPAWN.Pool(told.workers) as others:
        plans = [one for one in others.imap(partial(planned, quality=told.quality), draws) if one]
    print(f"{len(plans)} scenes, {len(draws) - len(plans)} refused", flush=True)
    cores = by_cores([one.number for one in plans[: told.compare]], told) if told.compare else []
    found, late = list[Solved](), set[int]()
    with watched() as board, ProcessPoolExecutor(told.processes, mp_context=SPAWN) as solving:
        for patient in (False, True):  # as `run` does
            some = [one for one in plans if one.number in late or not patient]
            chunks = (some[k : k + MAX_PLANNED_SCENES] for k in range(0, len(some), MAX_PLANNED_SCENES))
            parts = [[chunk[k] for k in part] for chunk in chunks for part in divided(chunk, told.processes)]
            found += solving.map(partial(batched, told=told, patient=patient), parts)
            late = {draw for one in found for draw in one.late}
    begun, ended = min(one.begun for one in found), max(one.ended for one in found)
    ends = sorted((at - begun, count) for one in found for at, count in one.ends)
    left = Counter(why for one in found for why in one.left.values())
    print(f"batch engine, {told.processes} processes: {len(ends)} scenes; {rates(ends, ended - begun)}; {board}")
    print(f"  {len(late)} scenes were put off; {left.total()} are left to the CPU engine", dict(left), flush=True)
    compare(cores, {draw: forces for one in found for draw, forces in one.forces.items()})


def scene_of(draw: int, quality: str) -> Scene | None:
    """The scene of a draw; None where it is refused."""
    one = drawn(draw)
    try:
        return scene_of_row.build(row_of(("outputs=[force]", f"sensor={one.sensor}", *one.sets, f"quality={quality}")))
    except UserError:
        return None


def planned(draw: int, quality: str) -> "Planned | None":
    """The scene of a draw, and the pattern for it."""
    from tacgen.tensor_engine.planning import Planned

    scene = scene_of(draw, quality)
    return None if scene is None else Planned.of((draw, scene))


def batched(plans: "list[Planned]", told: argparse.Namespace, patient: bool) -> Solved:
    """Solve scenes by the batch engine."""
    import torch

    from tacgen.tensor_engine import device, pool

    torch.set_num_threads(1)
    memory = device.chosen(told.device, GPU_MEMORY_SHARE / told.processes)
    if not BEGUN:
        list(pool.solved(plans[: WARM["frames"]], told.device, memory=memory))
        BEGUN.append(time.time())
    out = Solved({}, [], {}, [], time.time(), 0.0)
    try:
        for draw, found in pool.solved(plans, told.device, memory=memory, patient=patient):
            if found.late:
                out.late.append(draw)
                continue
            out.forces[draw] = forces_of(found.states)
            if found.why is None:
                out.ends.append((time.time(), len(found.states)))
            else:
                out.left[draw] = str(found.why)[:70]
            if time.time() - BEGUN[0] > told.seconds:
                print("  out of time", flush=True)
                break
    except RuntimeError as error:  # as in `run`, the CPU engine has the scenes that are left
        missed = {one.number for one in plans}.difference(out.forces, out.late)
        out.left.update(dict.fromkeys(missed, f"a process stopped: {str(error).splitlines()[0][:90]}"))
    return out._replace(ended=time.time())


def alone(draw: int, quality: str) -> Alone:
    """A scene by the CPU engine, up to where it fails."""
    scene, first = scene_of(draw, quality), not BEGUN
    BEGUN.append(time.time())
    assert scene is not None
    found = solve_frames(scene, mechanics.Problem.of(scene, mesh.of(scene)))
    stable = len(list(takewhile(lambda state: not state.damped, found.states)))
    return Alone(draw, found.forces, stable, found.seconds, first)


def by_cores(draws: list[int], told: argparse.Namespace) -> list[Alone]:
    """Draws solved by the CPU engine, as many as end in time; prints its speed."""
    end, ended = time.monotonic() + told.seconds, list[Alone]()
    with SPAWN.Pool(told.workers) as others, suppress(multiprocessing.TimeoutError):
        found = others.imap_unordered(partial(alone, quality=told.quality), draws)
        while len(ended) < len(draws):
            ended.append(found.next(max(end - time.monotonic(), 0.1)))
    counted = [one for one in ended if not one.first] or ended
    rate = sum(len(one.forces) for one in counted) / sum(one.seconds for one in counted)
    speed = f"{rate:.2f} frames a second of a core, {told.workers * rate:.1f} of {told.workers}"
    print(f"CPU engine: {len(ended)} of {len(draws)} scenes ended; {speed}", flush=True)
    return ended


def compare(ended: list[Alone], forces: dict[int, Array]) -> None:
    """Print how far forces of the CPU engine and of the batch engine differ."""
    off = dict[int, float]()
    for one in ended:
        many = forces.get(one.draw, np.zeros((0, 3)))
        if n := min(len(many), one.stable):
            size = np.linalg.norm(one.forces, axis=1).max(initial=1e-12)
            off[one.draw] = float(np.linalg.norm(many[:n] - one.forces[:n], axis=1).max() / size)
    if off:
        worst = max(off, key=lambda draw: off[draw])
        same = sum(len(forces.get(one.draw, ())) == len(one.forces) for one in ended)
        print(
            f"both engines have as many frames of {same} of {len(ended)} scenes; forces of {len(off)} scenes differ,"
            f" before the first damped frame and over the scene's largest, by {np.median(list(off.values())):.1e}"
            f" (median), {off[worst]:.1e} (draw {worst}); {sum(each > 1e-3 for each in off.values())} by more than 1e-3"
        )


# disk: balls from recipe to bundles


class Made(NamedTuple):
    """A run: scenes by their status, when they ended, seconds in all, seconds of cores, and the GPU's board."""

    status: dict[str, int]
    ends: Ends
    seconds: float
    cores: float
    board: Board

    def __str__(self) -> str:
        status = ", ".join(f"{n} {s}" for s, n in self.status.items())
        core = 1e3 * self.cores / sum(n for _, n in self.ends)
        return f"{status}; {rates(self.ends, self.seconds)}; {core:.1f} ms of a core a frame; {self.board}"


def disk(told: argparse.Namespace) -> None:
    """The balls by the GPU and by the cores alone."""
    sets = [f"quality={told.quality}", f"outputs=[{', '.join(told.outputs)}]"]
    for engine, scenes in (("cuda", told.scenes), ("local", told.alone)):
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            made(folder / "warm", engine, WARM["disk"], sets, told.workers)
            print(f"{engine}, {told.workers} workers: {made(folder / 'one', engine, scenes, sets, told.workers)}")
            size = sum(path.stat().st_size for path in (folder / "one").glob("*.h5")) / scenes / 10
            print(f"  {size / 1e3:.0f} kB a frame", flush=True)
            if told.again and engine == "cuda":
                print(f"{engine}, again: {made(folder / 'again', engine, scenes, sets, told.workers)}")
                different = [*unlike(folder / "one", folder / "again")]
                print(f"  {len(different)} of {scenes} bundles differ", *different[:5], flush=True)


def made(out: Path, engine: str, scenes: int, sets: Sequence[str], workers: int) -> Made:
    """Make scenes into a folder. Raises RuntimeError: the command fails."""
    recipe = out.with_suffix(".yaml")
    recipe.write_text(BALLS)
    more = [part for each in (*sets, f"vary.samples={scenes}") for part in ("--set", each)]
    call = [sys.executable, "-m", "tacgen", "run", str(recipe), "-o", str(out), *more, "--json"]
    status, ends, before, start = Counter[str](), Ends(), _children(), time.perf_counter()
    call += ["--engine", engine, "--workers", str(workers)]
    with watched() as board, out.with_suffix(".log").open("w+") as log:
        with subprocess.Popen(call, stdout=subprocess.PIPE, stderr=log, text=True) as run:
            assert run.stdout is not None
            for line in run.stdout:
                if '"scene"' in line and (event := json.loads(line))["event"] == "scene":
                    status[event["status"]] += 1
                    ends.append((time.perf_counter() - start, event["frames"]))
        if run.returncode or not ends:
            log.seek(0)
            raise RuntimeError(f"{' '.join(call)}: {log.read().strip() or f'exit code {run.returncode}'}")
    return Made(status, ends, time.perf_counter() - start, _children() - before, board)


def _children() -> float:
    """Processor seconds of processes that have ended."""
    return sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])


def unlike(folder: Path, other: Path) -> Iterator[str]:
    """Names of the bundles of a folder that another one has not byte by byte."""
    for path in sorted(folder.glob("*.h5")):
        if not (other / path.name).is_file() or path.read_bytes() != (other / path.name).read_bytes():
            yield path.name


# pictures: of dents, without solving


def pictures(told: argparse.Namespace) -> None:
    """A line for each sensor and quality."""
    print("sensor, quality: ms a frame of a core, of the GPU; difference of light; counts off, mean and most: CPU, GPU")
    for sensor in told.sensors:
        for quality in told.qualities:
            print(f"{sensor}, {quality}: {pictured(sensor, quality, told.device)}", flush=True)


def pictured(sensor: str, quality: str, device: str, count: int = 10) -> str:
    """Time and error of pictures of so many dents at random places by a core and by the GPU."""
    from tacgen.render import tensor_drawing

    asked = [f"sensor={sensor}", f"quality={quality}", "outputs=[force, rgb]"]
    (row,) = plan.load(assets.recipe_path("quickstart"), asked).rows
    renderer = Renderer(row.sensor, row.recipe.resolved().spp, 0, row.sensor.markers is not None)  # type: ignore[arg-type]
    if not (isinstance(renderer.light, Clear) and tensor_drawing.drawable(renderer)):
        return "not drawn on a GPU"
    random, direct, none = np.random.default_rng(0), renderer.light.direct, [None] * count
    dents = random.uniform([2.5, 0.2, -3, -3], [5.0, 0.6, 3, 3], (count, 4))
    faces = [BallDent(radius, share * radius, (x, y), renderer.untouched) for radius, share, x, y in dents]
    renderer.image(faces[0])  # compiles it
    started = time.perf_counter()
    shipped = [renderer.image(face) for face in faces]
    core = (time.perf_counter() - started) / count
    tolerance, direct.tolerance = direct.tolerance, EVERYWHERE
    exact = np.array([renderer.image(face) for face in faces])
    direct.tolerance = tolerance
    drawing = tensor_drawing.drawing(renderer, device)
    nodes = [np.stack([part(face) for face in faces]) for part in (renderer.sheet.at, renderer.sheet.touched)]
    light = drawing.radiance(*nodes)
    counts = drawing.developed(light, none, none).astype(int)
    started = time.perf_counter()
    for _ in range(DRAWN):
        drawing.developed(drawing.radiance(*nodes), none, none)
    gpu = (time.perf_counter() - started) / (DRAWN * count)
    right, usual = (np.array([renderer.develop(one) for one in lights]).astype(int) for lights in (exact, shipped))
    off = [f"{np.abs(each - right).mean():.5f} and {np.abs(each - right).max()}" for each in (usual, counts)]
    differs = np.abs(light.cpu().numpy() - exact).max() / exact.max()
    return f"{1e3 * core:.1f} ms, {1e3 * gpu:.2f} ms; {differs:.1e}; {', '.join(off)}"


if __name__ == "__main__":
    main()
