"""Frames a second of the batch engine on ordinary scenes, beside the CPU engine on all cores.

    python -m benchmarks.tensor_frames [--draws 0 256] [--slots 512] [--workers 16] [--compare 32] [--seconds 300]

Scenes of benchmarks/draws.py at draft are made ready in other processes and solved in refilled slots, pattern after
pattern. Then some of them are solved by the CPU engine, a process a core. Prints frames a second of both, what each
kernel takes, how many scenes share a call, how far forces differ, and peak memory.
"""

import argparse
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import takewhile
from typing import NamedTuple

import numpy as np
import torch

from benchmarks import results_page
from benchmarks.draws import drawn
from benchmarks.reference_runs import row_of
from tacgen import mechanics
from tacgen.errors import UserError
from tacgen.mechanics import mesh
from tacgen.mechanics.phases import Phase
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.state import State
from tacgen.recipe import scene_of_row
from tacgen.tensor_engine import engine, pool, scheduler
from tacgen.tensor_engine.batch import Batch

Array = np.ndarray
BEGUN: list[int] = []  # draws that the CPU engine has solved in this process


def main() -> None:
    told = arguments()
    device = told.device or ("cuda" if torch.cuda.is_available() else "cpu")
    torch.set_num_threads(1)
    begun = time.perf_counter()
    os.environ.update(results_page.one_thread())  # of the other processes
    os.environ.setdefault("PYTORCH_CUDA_ALLOC_CONF", "expandable_segments:True")  # calls have many sizes
    draws = [k for k in range(told.draws[0], sum(told.draws)) if drawn(k).sensor in (told.sensors or [drawn(k).sensor])]
    with multiprocessing.get_context("spawn").Pool(told.workers) as others:
        scenes = {k: made for k, made in zip(draws, others.imap(scene_of, draws), strict=True) if made is not None}
        print(f"{len(scenes)} scenes, {len(draws) - len(scenes)} refused", flush=True)
        for _ in pool.solved(list(scenes.values())[: told.warm], device, dtype=getattr(torch, told.dtype)):
            pass  # loads libraries, and compiles
        print(f"made warm in {time.perf_counter() - begun:.0f} s", flush=True)
        forces = batched(scenes, told, device, others.imap)
        if told.compare:
            compare(list(scenes)[: told.compare], forces, told, others.imap_unordered)


def arguments() -> argparse.Namespace:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--draws", type=int, nargs=2, default=(0, 256), metavar=("FIRST", "COUNT"))
    ask.add_argument("--sensors", nargs="*", help="only draws of these")
    ask.add_argument("--slots", type=int, default=pool.MOST_SLOTS)
    ask.add_argument(
        "--least", type=int, default=pool.LEAST_SHARED, help="scenes of a pattern; fewer share a larger one"
    )
    ask.add_argument("--workers", type=int, default=multiprocessing.cpu_count(), help="processes, one a core")
    ask.add_argument("--compare", type=int, default=0, help="scenes to solve by the CPU engine too")
    ask.add_argument("--seconds", type=float, default=300.0, help="each part stops after so long")
    ask.add_argument("--warm", type=int, default=3, help="scenes to solve before the time counts")
    ask.add_argument("--dtype", choices=("float32", "float64"), default="float32", help="of the factors")
    ask.add_argument("--device", choices=("cpu", "cuda"), help="a GPU if there is one")
    return ask.parse_args()


def scene_of(index: int) -> Scene | None:
    """The scene of a draw at draft; None where it is refused."""
    draw = drawn(index)
    try:
        return scene_of_row.build(row_of(("outputs=[force]", f"sensor={draw.sensor}", *draw.sets, "quality=draft")))
    except UserError:
        return None


@dataclass
class Clock:
    """Seconds in each kernel."""

    device: str
    seconds: Counter[Phase] = field(default_factory=Counter)

    def watch(self, advance: Callable[[Batch, Phase, list[int]], None]) -> Callable[[Batch, Phase, list[int]], None]:
        def watched(batch: Batch, phase: Phase, rows: list[int]) -> None:
            start = time.perf_counter()
            advance(batch, phase, rows)
            if self.device == "cuda":
                torch.cuda.synchronize()
            self.seconds[phase] += time.perf_counter() - start  # type: ignore[assignment]

        return watched


def batched(
    scenes: dict[int, Scene], told: argparse.Namespace, device: str, mapped: Callable[[Callable, Iterable], Iterable]
) -> dict[int, Array]:
    """Solve scenes by the batch engine; prints as it goes. Forces (frames, 3) [N] of those that ended."""
    use, clock, forces, why = scheduler.Use(), Clock(device), dict[int, Array](), Counter[str]()
    keys, engine.advance = list(scenes), clock.watch(engine.advance)  # type: ignore[assignment]
    start = said = time.perf_counter()
    runs = pool.solved(
        scenes.values(),
        device,
        dtype=getattr(torch, told.dtype),
        slots=told.slots,
        least=told.least,
        mapped=mapped,
        use=use,
    )
    for number, found in runs:
        forces[keys[number]] = forces_of(found.states)
        if found.why is not None:
            why[str(found.why)[:70]] += 1
        now = time.perf_counter()
        if now - said > 10:
            said = now
            print(f"  {now - start:.0f} s: {len(forces)} scenes, {frames(forces)} frames", flush=True)
        if now - start > told.seconds:
            print("  out of time")
            break
    total = sum(clock.seconds.values())
    memory = f", {torch.cuda.max_memory_allocated() / 1e9:.1f} GB" if device == "cuda" else ""
    print(
        f"batch engine: {len(forces)} scenes, {sum(why.values())} of them not to their end, {frames(forces)} frames in"
        f" {time.perf_counter() - start:.1f} s, {total:.1f} s of it in kernels: {frames(forces) / total:.1f} frames a"
        f" second; {use.mean:.1f} scenes a call{memory}"
    )
    for phase, seconds in clock.seconds.most_common():
        calls = use.calls[phase]
        print(
            f"  {phase:8s} {100 * seconds / total:3.0f} %, {calls} calls of {use.scenes[phase] / calls:.1f} scenes,"
            f" {1000 * seconds / calls:.1f} ms a call"
        )
    for reason, count in why.most_common():
        print(f"  {count} for the CPU engine: {reason}")
    return forces


def frames(forces: dict[int, Array]) -> int:
    """Frames of all scenes."""
    return sum(map(len, forces.values()))


def forces_of(states: Iterable[State]) -> Array:
    """Force of each frame (frames, 3) [N]."""
    return np.array([state.traction_force.sum((0, 1)) for state in states]).reshape(-1, 3)


class Alone(NamedTuple):
    """A scene solved by the CPU engine: its draw, forces (frames, 3) [N], frames before the first damped one, processor
    seconds, and whether it was the first of its process, which compiles."""

    draw: int
    forces: Array
    stable: int
    seconds: float
    first: bool


def alone(index: int) -> Alone:
    """A scene by the CPU engine, up to where it fails."""
    scene, states, start, first = scene_of(index), list[State](), time.process_time(), not BEGUN
    BEGUN.append(index)
    assert scene is not None
    with suppress(mechanics.NotConverged):
        states += mechanics.states(scene, mechanics.Problem.of(scene, mesh.of(scene)))
    stable = len(list(takewhile(lambda state: not state.damped, states)))
    return Alone(index, forces_of(states), stable, time.process_time() - start, first)


def compare(
    draws: list[int],
    forces: dict[int, Array],
    told: argparse.Namespace,
    mapped: Callable[[Callable, Iterable], Iterator[Alone]],
) -> None:
    """Solve draws by the CPU engine; prints its speed and how far the forces of both differ."""
    start, ended, off = time.perf_counter(), list[Alone](), dict[int, float]()
    for one in mapped(alone, draws):
        ended.append(one)
        many = forces.get(one.draw, np.zeros((0, 3)))
        n = min(len(many), one.stable)
        if n:
            size = np.linalg.norm(one.forces, axis=1).max(initial=1e-12)
            off[one.draw] = float(np.linalg.norm(many[:n] - one.forces[:n], axis=1).max() / size)
        if time.perf_counter() - start > told.seconds:
            print("  out of time")
            break
    counted = [one for one in ended if not one.first] or ended
    rate = sum(len(one.forces) for one in counted) / sum(one.seconds for one in counted)
    print(f"CPU engine: {len(ended)} scenes; {rate:.2f} frames a second of a core, {16 * rate:.1f} of 16 cores")
    if off:
        worst = max(off, key=lambda draw: off[draw])
        print(
            f"forces of {len(off)} scenes differ, before the first damped frame and over the scene's largest, by"
            f" {np.median(list(off.values())):.1e} (median), {off[worst]:.1e} (draw {worst})"
        )


if __name__ == "__main__":
    main()
