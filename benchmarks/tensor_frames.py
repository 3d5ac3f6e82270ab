"""Frames a second of the batch engine on ordinary scenes, beside the CPU engine on all cores.

    python -m benchmarks.tensor_frames [--draws 0 256] [--quality draft] [--workers 16] [--compare 32] [--seconds 300]

Some scenes of benchmarks/draws.py are solved by the CPU engine, a process a core. Then all are solved in refilled
slots, pattern after pattern, by one process or by several that share the GPU, and at last those that they have put off;
the CPU engine solves what they leave, meanwhile. Prints frames a second of both, what each kernel takes, how many
scenes share a call, how far forces differ, peak memory, and what the GPU's board draws.
"""

import argparse
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import takewhile
from multiprocessing.pool import AsyncResult
from typing import NamedTuple

import numpy as np
import torch

from benchmarks import gpu_board, results_page
from benchmarks.draws import drawn
from benchmarks.reference_runs import row_of
from tacgen import mechanics
from tacgen.batch.cuda_engine import CHUNK, MEMORY, solvers
from tacgen.errors import UserError
from tacgen.mechanics import mesh
from tacgen.mechanics.phases import Phase
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.state import State
from tacgen.recipe import scene_of_row
from tacgen.tensor_engine import device, engine, pool, scheduler
from tacgen.tensor_engine.batch import Batch
from tacgen.tensor_engine.planning import Planned, divided

Array = np.ndarray
WINDOW = 10  # [s] in which frames are counted: at the end few scenes are left
BEGUN: list[int] = []  # draws that the CPU engine has solved in this process
STARTED: list[float] = []  # when the batch engine began in this process, by the clock [s]
ADVANCE = engine.advance


def main() -> None:
    told = arguments()
    os.environ.update(results_page.one_thread())  # of the other processes too
    os.environ.setdefault("PYTORCH_CUDA_ALLOC_CONF", "expandable_segments:True")  # calls have many sizes
    draws = [k for k in range(told.draws[0], sum(told.draws)) if drawn(k).sensor in (told.sensors or [drawn(k).sensor])]
    plan = partial(planned, quality=told.quality)
    with multiprocessing.get_context("spawn").Pool(told.workers) as others:
        made = {k: one for k, one in zip(draws, others.imap(plan, draws), strict=True) if one is not None}
        print(f"{len(made)} scenes, {len(draws) - len(made)} refused", flush=True)
        cores = by_cores(list(made)[: told.compare], told) if told.compare else []
        with ProcessPoolExecutor(told.processes, mp_context=multiprocessing.get_context("spawn")) as solving:
            found, rest = list[Report](), list[AsyncResult[Alone]]()
            with gpu_board.watched() as board:
                for patient in (False, True):  # as `run` does
                    late = {draw for report in found for draw in report.late}
                    if late:
                        print(f"{len(late)} scenes are put off; {elapsed(found):.1f} s until then", flush=True)
                    parts = parts_of([made[k] for k in made if k in late or not patient], told.processes)
                    for report in solving.map(partial(batched, told=told, patient=patient), parts):
                        found.append(report)
                        left = [] if told.leave else report.left
                        rest += [others.apply_async(alone, (draw, told.quality)) for draw in left]
        forces = merged(found)
        print(f"  {board}", flush=True)
        compare(cores, forces)
        if rest:
            ended = time.time()
            wait(rest, told.seconds)
            frames = [len(one.get().forces) for one in rest if one.ready()]
            print(
                f"{time.time() - ended:.1f} s later the CPU engine has made {sum(frames)} frames of {len(frames)} of"
                f" {len(rest)} scenes that were left to it",
                flush=True,
            )


def parts_of(plans: list[Planned], processes: int) -> list[list[Planned]]:
    """Plans in parts for so many processes, chunk by chunk."""
    chunks = [plans[first : first + CHUNK] for first in range(0, len(plans), CHUNK)]
    return [[chunk[k] for k in part] for chunk in chunks for part in divided(chunk, processes)]


def arguments() -> argparse.Namespace:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--draws", type=int, nargs=2, default=(0, 256), metavar=("FIRST", "COUNT"))
    ask.add_argument("--sensors", nargs="*", help="only draws of these")
    ask.add_argument("--quality", default="draft")
    ask.add_argument("--slots", type=int, default=pool.MOST_SLOTS)
    ask.add_argument(
        "--processes", type=int, default=solvers(multiprocessing.cpu_count(), 1), help="that share the GPU; with MPS"
    )
    ask.add_argument("--workers", type=int, default=multiprocessing.cpu_count(), help="processes, one a core")
    ask.add_argument("--compare", type=int, default=0, help="scenes to solve by the CPU engine too")
    ask.add_argument("--leave", action="store_true", help="scenes that the batch engine does not solve")
    ask.add_argument("--seconds", type=float, default=300.0, help="each process stops after so long, and each engine")
    ask.add_argument("--warm", type=int, default=3, help="scenes to solve before the time counts")
    ask.add_argument("--dtype", choices=("float32", "float64"), default="float32", help="of the factors")
    ask.add_argument("--device", choices=("cpu", "cuda"), help="a GPU if there is one")
    return ask.parse_args()


def planned(index: int, quality: str = "draft") -> Planned | None:
    """The scene of a draw; None where it is refused."""
    scene = scene_of(index, quality)
    return None if scene is None else Planned.of((index, scene))


def scene_of(index: int, quality: str) -> Scene | None:
    """The scene of a draw; None where it is refused."""
    draw = drawn(index)
    try:
        return scene_of_row.build(
            row_of(("outputs=[force]", f"sensor={draw.sensor}", *draw.sets, f"quality={quality}"))
        )
    except UserError:
        return None


@dataclass
class Report:
    """What one process has solved: forces (frames, 3) [N] by draw, of ended scenes; frames by the second of the clock
    in which they were solved, those of other scenes too; seconds of each kernel, and its calls; seconds in all; why
    scenes did not end, and which, and which were put off; the most memory used [bytes]; seconds of a core."""

    forces: dict[int, Array] = field(default_factory=dict)
    frames: Counter[int] = field(default_factory=Counter)
    seconds: Counter[Phase] = field(default_factory=Counter)
    use: scheduler.Use = field(default_factory=scheduler.Use)
    begun: float = 0.0
    ended: float = 0.0
    why: Counter[str] = field(default_factory=Counter)
    left: list[int] = field(default_factory=list)
    late: list[int] = field(default_factory=list)
    memory: float = 0.0
    cores: float = 0.0
    process: int = field(default_factory=os.getpid)

    def watch(
        self, advance: Callable[[Batch, Phase, list[int]], None], cuda: bool
    ) -> Callable[[Batch, Phase, list[int]], None]:
        def watched(batch: Batch, phase: Phase, rows: list[int]) -> None:
            start = time.perf_counter()
            advance(batch, phase, rows)
            if cuda:
                torch.cuda.synchronize()
            self.seconds[phase] += time.perf_counter() - start  # type: ignore[assignment]
            self.frames[int(time.time())] += sum(batch.courses[row].phase is Phase.done for row in rows)

        return watched


def batched(plans: list[Planned], told: argparse.Namespace, patient: bool) -> Report:
    """Solve scenes by the batch engine; prints as it goes."""
    usable = [told.device] if told.device else (device.usable() or ["cpu"])
    memory, dtype, out = device.chosen(usable[0], MEMORY / told.processes), getattr(torch, told.dtype), Report()
    torch.set_num_threads(1)
    if not STARTED:
        for _ in pool.solved(plans[: told.warm], usable[0], dtype=dtype, memory=memory):
            pass  # loads libraries, and compiles
        STARTED.append(time.time())
    cuda = usable[0].startswith("cuda")
    engine.advance = out.watch(ADVANCE, cuda)  # type: ignore[assignment]
    out.begun, out.cores, sizes = time.time(), -time.process_time(), {"slots": told.slots, "memory": memory}
    try:
        for number, found in pool.solved(plans, usable[0], dtype=dtype, use=out.use, patient=patient, **sizes):
            if found.late:
                out.late.append(number)
                continue
            out.forces[number] = forces_of(found.states)
            if found.why is not None:
                out.why[str(found.why)[:70]] += 1
                out.left.append(number)
            if time.time() - STARTED[0] > told.seconds:
                print("  out of time")
                break
    except RuntimeError as error:  # as in `run`, the CPU engine has the scenes that are left
        out.why[f"a process stopped: {str(error).splitlines()[0][:90]}"] += len(plans) - len(out.forces) - len(out.late)
        out.left += [plan.number for plan in plans if plan.number not in {*out.forces, *out.late}]
    out.ended, out.cores = time.time(), out.cores + time.process_time()
    out.memory = torch.cuda.max_memory_reserved() if cuda else 0.0
    return out


def elapsed(found: list[Report]) -> float:
    """Seconds from the first beginning to the last end."""
    return max(report.ended for report in found) - min(report.begun for report in found)


def merged(found: list[Report]) -> dict[int, Array]:
    """Print what all processes have solved together; returns the forces of all scenes."""
    seconds, calls, scenes, why = Counter[Phase](), Counter[Phase](), Counter[Phase](), Counter[str]()
    for report in found:
        for mine, of_all in ((report.seconds, seconds), (report.use.calls, calls), (report.use.scenes, scenes)):
            of_all.update(mine)
        why.update(report.why)
    forces, total = {k: v for report in found for k, v in report.forces.items()}, sum(seconds.values())
    frames, memory = sum((report.frames for report in found), Counter[int]()), dict[int, float]()
    took = elapsed(found)
    busiest = max(sum(frames[second + k] for k in range(WINDOW)) / WINDOW for second in frames)
    mean = scenes.total() / max(calls.total(), 1)
    for report in found:
        memory[report.process] = max(memory.get(report.process, 0.0), report.memory / 1e9)
    left = {draw for report in found for draw in report.left}
    ended = sum(len(one) for draw, one in forces.items() if draw not in left)
    print(
        f"batch engine, {len(memory)} processes: {len(forces)} scenes, {why.total()} of them not to their end; of the"
        f" others {ended} frames in {took:.1f} s: {ended / took:.1f} a second, {busiest:.1f} of all in the best"
        f" {WINDOW} s; {mean:.1f} scenes a call, {sum(memory.values()):.1f} GB"
    )
    busy, cores = sum(report.ended - report.begun for report in found), sum(report.cores for report in found)
    print(f"  {busy / took:.1f} processes are busy on average, with {cores / took:.1f} cores")
    begun = min(frames)
    by_window = Counter[int]()
    for second, count in frames.items():
        by_window[(second - begun) // WINDOW] += count
    print(f"  frames a second by {WINDOW} s:", *(round(by_window[k] / WINDOW) for k in range(max(by_window) + 1)))
    for phase, time_ in seconds.most_common():
        print(
            f"  {phase:8s} {100 * time_ / total:3.0f} %, {calls[phase]} calls of {scenes[phase] / calls[phase]:.1f}"
            f" scenes, {1000 * time_ / calls[phase]:.1f} ms a call"
        )
    for reason, count in why.most_common():
        print(f"  {count} for the CPU engine: {reason}")
    return forces


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


def alone(index: int, quality: str) -> Alone:
    """A scene by the CPU engine, up to where it fails."""
    scene, states, start, first = scene_of(index, quality), list[State](), time.process_time(), not BEGUN
    BEGUN.append(index)
    assert scene is not None
    with suppress(mechanics.NotConverged):
        states += mechanics.states(scene, mechanics.Problem.of(scene, mesh.of(scene)))
    stable = len(list(takewhile(lambda state: not state.damped, states)))
    return Alone(index, forces_of(states), stable, time.process_time() - start, first)


def by_cores(draws: list[int], told: argparse.Namespace) -> list[Alone]:
    """Draws solved by the CPU engine, as many as end in time; prints its speed."""
    end, ended = time.monotonic() + told.seconds, list[Alone]()
    with multiprocessing.get_context("spawn").Pool(told.workers) as others, suppress(multiprocessing.TimeoutError):
        found = others.imap_unordered(partial(alone, quality=told.quality), draws)
        while len(ended) < len(draws):
            ended.append(found.next(max(end - time.monotonic(), 0.1)))
    counted = [one for one in ended if not one.first] or ended
    rate = sum(len(one.forces) for one in counted) / sum(one.seconds for one in counted)
    print(
        f"CPU engine: {len(ended)} of {len(draws)} scenes ended; {rate:.2f} frames a second of a core,"
        f" {told.workers * rate:.1f} of {told.workers}",
        flush=True,
    )
    return ended


def compare(ended: list[Alone], forces: dict[int, Array]) -> None:
    """Print how far forces of the CPU engine and of the batch engine differ."""
    off = dict[int, float]()
    for one in ended:
        many = forces.get(one.draw, np.zeros((0, 3)))
        n = min(len(many), one.stable)
        if n:
            size = np.linalg.norm(one.forces, axis=1).max(initial=1e-12)
            off[one.draw] = float(np.linalg.norm(many[:n] - one.forces[:n], axis=1).max() / size)
    if off:
        worst = max(off, key=lambda draw: off[draw])
        above = sum(each > 1e-3 for each in off.values())
        same = sum(len(forces.get(one.draw, ())) == len(one.forces) for one in ended)
        print(
            f"both engines have as many frames of {same} of {len(ended)} scenes; forces of {len(off)} scenes differ,"
            f" before the first damped frame and over the scene's largest, by {np.median(list(off.values())):.1e}"
            f" (median), {off[worst]:.1e} (draw {worst}); {above} by more than 1e-3",
            flush=True,
        )


def wait(calls: list[AsyncResult[Alone]], seconds: float) -> None:
    """Wait for calls, so long at most."""
    end = time.monotonic() + seconds
    for each in calls:
        each.wait(max(end - time.monotonic(), 0.0))


if __name__ == "__main__":
    main()
