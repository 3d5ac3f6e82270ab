"""A GPU beside the cores of its machine: ordinary scenes solved alone.

    python -m benchmarks.gpu [--draws 94000 1500] [--compare 160] [--seconds 190]

Ordinary scenes (benchmarks/draws.py) by the batch engine, in several processes that share the GPU, those that take long
at last; some of them by the CPU engine first, a process a core, whose forces are compared. Frames count when their
scene ends. To disk `tacgen run --engine cuda` tells its own time.
"""

import argparse
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from functools import partial
from itertools import takewhile
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks import results_page
from benchmarks.draws import drawn
from benchmarks.reference_runs import forces_of, row_of, solve_frames
from tacgen import mechanics
from tacgen.batch.cuda_engine import CHUNK, MEMORY, solvers
from tacgen.errors import UserError
from tacgen.mechanics import mesh
from tacgen.mechanics.scene import Scene
from tacgen.recipe import scene_of_row

if TYPE_CHECKING:
    from tacgen.tensor_engine.planning import Planned

Array = np.ndarray
Ends = list[tuple[float, int]]  # when scenes ended [s], and how many frames they have
WINDOW = 10  # [s] in which frames are counted: at the end few scenes are left
SPAWN = multiprocessing.get_context("spawn")
BEGUN: list[float] = []  # when this process, which is warm since, began [s by the clock]
WARM = 3  # scenes made before the time counts, which compile


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--draws", type=int, nargs=2, default=(0, 256), metavar=("FIRST", "COUNT"))
    ask.add_argument("--quality", default="draft")
    ask.add_argument("--compare", type=int, default=0, help="scenes to solve by the CPU engine too")
    ask.add_argument("--workers", type=int, default=os.cpu_count(), help="processes, one a core")
    ask.add_argument("--processes", type=int, default=solvers(os.cpu_count() or 1, 1), help="that share the GPU")
    ask.add_argument("--seconds", type=float, default=300.0, help="each engine stops after so long")
    ask.add_argument("--device", default="cuda:0", help="cpu: PyTorch's CPU backend, as a test")
    told = ask.parse_args(arguments)
    os.environ.update(results_page.one_thread())  # of the other processes too
    os.environ.setdefault("PYTORCH_CUDA_ALLOC_CONF", "expandable_segments:True")  # calls have many sizes
    frames(told)


def rates(ends: Ends, seconds: float) -> str:
    """Frames a second in all, after the first scene, and where they are most."""
    count, (first, before), last = sum(n for _, n in ends), ends[0], ends[-1][0]
    most = max(sum(n for at, n in ends if start <= at < start + WINDOW) for start, _ in ends)
    return (
        f"{count} frames in {seconds:.1f} s: {count / seconds:.1f} a second; the first scene at {first:.1f} s, then"
        f" {(count - before) / max(last - first, 1e-9):.1f} a second, {most / WINDOW:.1f} in the best {WINDOW} s"
    )


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
    with ProcessPoolExecutor(told.processes, mp_context=SPAWN) as solving:
        for patient in (False, True):  # as `run` does
            some = [one for one in plans if one.number in late or not patient]
            chunks = (some[k : k + CHUNK] for k in range(0, len(some), CHUNK))
            parts = [[chunk[k] for k in part] for chunk in chunks for part in divided(chunk, told.processes)]
            found += solving.map(partial(batched, told=told, patient=patient), parts)
            late = {draw for one in found for draw in one.late}
    begun, ended = min(one.begun for one in found), max(one.ended for one in found)
    ends = sorted((at - begun, count) for one in found for at, count in one.ends)
    left = Counter(why for one in found for why in one.left.values())
    print(f"batch engine, {told.processes} processes: {len(ends)} scenes; {rates(ends, ended - begun)}")
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
    memory = device.chosen(told.device, MEMORY / told.processes)
    if not BEGUN:
        list(pool.solved(plans[:WARM], told.device, memory=memory))
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


if __name__ == "__main__":
    main()
