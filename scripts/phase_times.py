"""Where the time of ordinary scenes goes: processor seconds and calls of each kernel of the solver.

    python -m scripts.phase_times [FIRST] [COUNT] [QUALITY]

Solves draws FIRST, FIRST + 1... of benchmarks/draws.py. Prints, for all frames together and for those that needed
damping, seconds a frame, calls a frame and milliseconds a call, phase by phase.
"""

import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

from benchmarks.draws import drawn
from benchmarks.reference_runs import row_of
from tacgen import mechanics
from tacgen.mechanics import mesh, solver
from tacgen.mechanics.phases import Outcome, Phase
from tacgen.mechanics.solve_state import SolveState
from tacgen.recipe import scene_of_row

Spent = dict[Phase, float]


@contextmanager
def timed() -> Iterator[tuple[Spent, Counter[Phase]]]:
    """Adds up the processor seconds and the calls of the kernels."""
    seconds, calls, usual = defaultdict[Phase, float](float), Counter[Phase](), dict(solver.KERNELS)

    def watched(phase: Phase) -> Callable[[mechanics.Problem, SolveState], tuple[Outcome, SolveState]]:
        def kernel(problem: mechanics.Problem, now: SolveState) -> tuple[Outcome, SolveState]:
            start = time.process_time()
            try:
                return usual[phase](problem, now)
            finally:
                seconds[phase] += time.process_time() - start
                calls[phase] += 1

        return kernel

    solver.KERNELS.update({phase: watched(phase) for phase in usual})
    try:
        yield seconds, calls
    finally:
        solver.KERNELS.update(usual)


def solved(index: int, quality: str) -> tuple[bool, list[tuple[bool, Spent, Counter[Phase]]]]:
    """Whether draw `index` ended, and of each frame whether it was damped, its seconds and its calls by phase."""
    draw = drawn(index)
    made = scene_of_row.build(row_of(("outputs=[force]", f"sensor={draw.sensor}", *draw.sets, f"quality={quality}")))
    problem, frames = mechanics.Problem.of(made, mesh.of(made)), list[tuple[bool, Spent, Counter[Phase]]]()
    with timed() as (seconds, calls):
        try:
            for state in mechanics.states(made, problem):
                frames.append((state.damped > 0, dict(seconds), Counter(calls)))
                seconds.clear()
                calls.clear()
        except mechanics.NotConverged:
            return False, frames
    return True, frames


def table(name: str, frames: list[tuple[bool, Spent, Counter[Phase]]]) -> None:
    """Prints what these frames took."""
    total = {phase: sum(spent.get(phase, 0.0) for _, spent, _ in frames) for phase in Phase}
    whole, count = sum(total.values()), max(len(frames), 1)
    print(f"{name}: {len(frames)}, {whole / count:.3f} s a frame")
    for phase in sorted(total, key=total.__getitem__, reverse=True):
        if total[phase]:
            times = sum(calls[phase] for _, _, calls in frames)
            share, each = total[phase] / whole, 1e3 * total[phase] / times
            print(f"    {phase:8} {share:6.1%} {total[phase] / count:8.4f} s {times / count:7.2f} calls {each:8.2f} ms")


def main(first: int, count: int, quality: str) -> None:
    mechanics.warm()
    frames = list[tuple[bool, Spent, Counter[Phase]]]()
    for index in range(first, first + count):
        ended, more = solved(index, quality)
        seconds = sum(sum(spent.values()) for _, spent, _ in more)
        shape = drawn(index).shape
        status = "ok" if ended else "rejected"
        print(f"draw {index} {shape}: {status}, {len(more)} frames, {seconds:.1f} s", flush=True)
        frames += more
    table("all frames", frames)
    table("damped frames", [frame for frame in frames if frame[0]])


if __name__ == "__main__":
    given = sys.argv[1:]
    with threadpool_limits(1, user_api="blas"):
        main(
            int(given[0]) if given else 0,
            int(given[1]) if len(given) > 1 else 12,
            given[2] if len(given) > 2 else "draft",
        )
