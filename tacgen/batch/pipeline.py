"""One scene down the line. What its outputs do not need is neither imported nor computed."""

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tacgen import mechanics
from tacgen.base import array_cache, atomic_file, compiled
from tacgen.batch.recorder import OnEvent, Recorder, Rejected, SceneWork, Solvable
from tacgen.bundle import bundle, resume
from tacgen.bundle.resume import SceneResult
from tacgen.mechanics import mesh, presolve
from tacgen.mechanics.expected_error import Expected
from tacgen.outputs import STRESS_OUTPUTS
from tacgen.recipe import scene_checks, scene_of_row
from tacgen.recipe.row import Row

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

    from tacgen.mechanics.grasp_balance import Held

# entries of the cache that take long, by the event that tells of them; tables come first of a sensor's images
TOLD_ENTRIES = {compiled.COMPILED_ENTRY: "compiling", "untouched": "tracing", "table": "tracing"}
# of a frame: each gel's state, and of a grasp what holds the object and the number of the finger
Found = tuple[tuple[mechanics.State, "tuple[Held, int] | None"], ...]


def run_scene(
    row: Row, folder: Path, *, overwrite: bool = False, on_event: OnEvent = lambda event: None
) -> SceneResult:
    """Solve, label, render and write one scene; a finished bundle of the same inputs is kept unless `overwrite`.

    `on_event` is called after each frame: `{"event": "frame", "scene": "scene-00000", "frame": 3, "frames": 15}`.

    Raises:
        UserError: the bundle's place is taken by a file made from other inputs.
        atomic_file.Busy: another process is making this very bundle.
    """
    return run_work(SceneWork(row, on_event), folder, overwrite=overwrite)


def run_work(work: SceneWork, folder: Path, *, overwrite: bool = False) -> SceneResult:
    """As `run_scene`, with what is already known of the scene."""
    with resume.claimed(work.row, folder, overwrite=overwrite) as found:
        return found if isinstance(found, SceneResult) else _make(work, found)


def _make(work: SceneWork, path: Path) -> SceneResult:
    """The work itself, with one BLAS thread: more would add up in another order, and change the bytes."""

    def tell(kind: str) -> None:
        if kind in TOLD_ENTRIES:
            work.tell(TOLD_ENTRIES[kind])

    row, clock = work.row, work.clock
    with array_cache.telling(tell):
        with clock.stage("start"):
            mechanics.warm()  # every BLAS is loaded by now: a limit does not reach those that come later
            one_thread = _blas(len(sys.modules)).limit(limits=1, user_api="blas")
        with one_thread, clock.stage("bundle"):
            status, reason, done, bundles = _made(work, path)
    seconds = {name: round(value, 4) for name, value in clock.seconds.items()}
    timing = json.dumps({"frames": row.frames, "seconds": seconds}, indent=1) + "\n"
    atomic_file.write(path.with_suffix(".timing.json"), timing.encode(), sync=False)
    return SceneResult(row.name, path, status, reason, done, seconds, bundles)


@lru_cache(maxsize=1)
def _blas(modules: int) -> "ThreadpoolController":
    """The BLAS libraries of this process, looked for again when it has loaded more modules."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _gels(work: SceneWork) -> tuple[tuple[Solvable, ...], Iterator[Found]]:
    """The gels of a row of the plan, meshed, and what will be found at each frame."""
    row, clock, known = work.row, work.clock, work.known
    if row.other is not None:
        return _grasped(work)
    with clock.stage("mesh"):
        built = scene_of_row.build(row)
    if built.forced is not None:
        with clock.stage("presolve"):
            built = presolve.refined(built, known.heights) if known else presolve.presolved(built)
    if (expected := Expected.of(built)) is not None:
        expected.refuse()
    with clock.stage("mesh"):
        if known and not built.differentiable:
            stress = bool(row.recipe.outputs & STRESS_OUTPUTS)
            problem = mechanics.Problem.of_known_frames(built, mesh.of(built), stress=stress)
        else:
            # a trial of a prescribed force may fold where its solution does not: its frames stop such a scene
            through = row.recipe.folds == "keep" or built.forced is not None
            options = replace(mechanics.DEFAULT_OPTIONS, through_folds=through)
            problem = mechanics.Problem.of(built, mesh.of(built), options)
        states = iter(known.states) if known else mechanics.states(built, problem)
    return (Solvable(row, built, problem),), (((state, None),) for state in states)


def _grasped(work: SceneWork) -> tuple[tuple[Solvable, ...], Iterator[Found]]:
    """The two gels of a grasp, meshed, and the states of both at each frame."""
    from tacgen.mechanics import grasp_balance as holding
    from tacgen.recipe import grasp_of_row as two_fingers

    clock = work.clock
    with clock.stage("mesh"):
        grasp = two_fingers.build(work.row)
    with clock.stage("presolve"):
        grasp = holding.presolved(grasp)
    with clock.stage("mesh"):
        each = zip(work.row.bundles, grasp.fingers, strict=True)
        left, right = (Solvable(finger, built, holding.problem_of(built)) for finger, built in each)
    frames = holding.held(grasp, (left.problem, right.problem))
    return (left, right), (tuple((state, (held, side)) for side, state in enumerate(held.states)) for held in frames)


def _made(work: SceneWork, path: Path) -> tuple[Literal["ok", "rejected"], str, int, tuple[bundle.Bundle, ...]]:
    """Everything between a row of the plan and its bundles, the first of which is `path`: their status and its reason,
    how many frames they have, and the bundles."""
    row, (gels, frames) = work.row, _gels(work)
    status: Literal["ok", "rejected"] = "ok"
    reason, done = "", 0
    notes: list[str] = []
    with ExitStack() as stack:
        recorders = [stack.enter_context(Recorder(work, gel, path.with_name(f"{gel.row.name}.h5"))) for gel in gels]
        while True:
            try:
                with work.clock.stage("solve"):
                    found = next(frames, None)
                if found is None:
                    break
                if row.recipe.folds == "end" and any(state.damped for state, _ in found):
                    raise mechanics.NotConverged(mechanics.Failure.folds)
                labelled = [recorder.labelled(*each) for recorder, each in zip(recorders, found, strict=True)]
                for recorder, frame in zip(recorders, labelled, strict=True):
                    recorder.writer.append(frame)
            except (mechanics.NotConverged, Rejected) as error:
                folded = isinstance(error, mechanics.NotConverged) and error.failure is mechanics.Failure.folds
                status, before = ("ok", "ends before ") if folded and done else ("rejected", "")
                reason = f"{before}frame {done + 1} of {row.frames}: {error}"
                break
            done += 1
            work.tell("frame", frame=done, frames=row.frames)
        if not reason and not any(recorder.touched for recorder in recorders):
            fine, said = scene_checks.verdict(row.recipe, min(recorder.gap for recorder in recorders))
            status, reason, notes = ("ok", "", [said]) if fine else ("rejected", said, [])
        return status, reason, done, tuple(recorder.finish(status, reason, notes) for recorder in recorders)


def run(
    rows: Sequence[Row], folder: Path, *, overwrite: bool = False, on_event: OnEvent = lambda event: None
) -> list[SceneResult]:
    """Every scene in order, in this process; tacgen.batch spreads them over others.

    Raises:
        UserError: before anything is computed, if a bundle of other inputs is in the way.
    """
    if not overwrite:
        resume.existing(rows, folder)
    return [run_scene(row, folder, overwrite=overwrite, on_event=on_event) for row in rows]
