"""Scenes solved many at once on a GPU, while worker processes label, draw and write those that are solved. They draw
on the GPU, too, where it can draw what their renderer does.

A solution reaches its worker through a file in the dataset's folder, as soon as it is there. Scenes that would keep
others waiting are put off, and solved together when all of their chunk have had their turn. A scene for which the batch
engine lacks something, or which it does not solve, is solved by its worker as without a GPU, and its bundle says why.
"""

import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib import import_module
from importlib.metadata import version
from itertools import cycle
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any, NamedTuple

from tacgen.base.errors import UserError
from tacgen.base.version import __version__
from tacgen.batch import process_pool, solution_file
from tacgen.batch.local import SCENE_TASK, OnEvent, Pool
from tacgen.batch.worker_process import Limits
from tacgen.bundle import resume
from tacgen.bundle.resume import SceneResult
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.solved_scene import SolvedScene
from tacgen.outputs import IMAGE_OUTPUTS, STRESS_OUTPUTS
from tacgen.recipe.row import Row

if TYPE_CHECKING:
    from tacgen.tensor_engine.engine import Solved
    from tacgen.tensor_engine.planning import Planned

# scenes that are planned and solved together; as many solutions, of some 3 MB, may wait for a worker
MAX_PLANNED_SCENES = 2048
MAX_PROCESSES_PER_GPU = 8  # processes at most that solve on one GPU: more of them have fewer scenes in a call
GPU_MEMORY_SHARE = 0.85  # part of a GPU's memory that they share, of what is left beside workers that draw on it
# processes at most that plan scenes, and scenes that one is given at a time
MAX_PLANNERS, SCENES_PER_PLANNER_TASK = 8, 16
SOLUTION_POLL_S = 0.1  # between looks for new solutions
SOLUTIONS_FOLDER = ".solved"
Mapped = Callable[[Callable, Iterable], Iterable]
SOLVED_SCENE_TASK, PREPARE_TASK = f"{__name__}:run_scene", f"{__name__}:prepare"


class SolvedPart(NamedTuple):
    """Notes on the run from a part of a chunk, and names of its scenes that were put off."""

    notes: Sequence[str] = ()
    late: Sequence[str] = ()


@contextmanager
def engine(workers: int, limits: Limits, task: str, scheduler: str) -> Iterator[Callable[..., list[SceneResult]]]:
    """Worker processes, and others that solve for them.

    Raises:
        UserError: there is no PyTorch, or no GPU that it can use.
    """
    if scheduler:
        raise UserError(f"--scheduler {scheduler}: needs --engine dask")
    with ExitStack() as stack:
        mapped: Mapped = map
        if workers > 1:  # scenes are planned in processes too, which start while PyTorch is imported here
            planners, module = min(workers, MAX_PLANNERS), "tacgen.tensor_engine.planning"
            planning = process_pool.started(stack, planners, import_module, module)
            mapped = partial(planning.map, chunksize=SCENES_PER_PLANNER_TASK)
            process_pool.import_once("tacgen.tensor_engine.pool")
        devices = usable_devices()
        count = solvers(workers, len(devices))
        solving: Executor = stack.enter_context(ThreadPoolExecutor(1))
        if count > 1:
            solving = process_pool.started(stack, count, import_module, "tacgen.tensor_engine.pool", by="forkserver")
        ahead = stack.enter_context(ThreadPoolExecutor(1))
        made_by = SOLVED_SCENE_TASK if task == SCENE_TASK else task
        pool = stack.enter_context(Pool(workers, limits, made_by, first=PREPARE_TASK))

        def run(
            rows: Sequence[Row], folder: Path, *, overwrite: bool = False, on_event: OnEvent = lambda event: None
        ) -> list[SceneResult]:
            solutions = _Solutions(_unfinished(rows, folder, overwrite), folder, on_event)

            def begin(some: Sequence[Row], patient: bool) -> list[Future[SolvedPart]]:
                drawing = -(-workers // len(devices)) if some[0].recipe.outputs & IMAGE_OUTPUTS else 0
                return _begun(some, folder, devices, solving, count, mapped, drawing, patient)

            solved = ahead.submit(solutions.make, begin)

            def ready(row: Row) -> bool:
                return solutions.has(row) or (solved.done() and solved.result() is None)

            try:
                return pool.run(rows, folder, overwrite=overwrite, on_event=solutions.watch, ready=ready)
            finally:
                solutions.close()

        yield run


Begin = Callable[[Sequence[Row], bool], list[Future[SolvedPart]]]


class _Chunk(NamedTuple):
    """Rows that are solved together, in parts."""

    rows: Sequence[Row]
    parts: Sequence[Future[SolvedPart]]


class _Solutions:
    """Solutions of rows on their way to the workers, as files that are there until their scenes have ended."""

    def __init__(self, rows: Sequence[Row], folder: Path, on_event: OnEvent) -> None:
        self._rows, self._folder, self._on_event = rows, folder, on_event
        self._places = {row.name: _place(folder, row) for row in rows}
        self._ended, self._notes, self._closed = set[str](), deque[str](), Event()
        self._chunks = list[_Chunk]()  # those that are begun
        self._there, self._seen = set[str](), 0.0  # names of solutions when they were last looked for
        self._clear()  # what a killed run has left may be another recipe's
        (folder / SOLUTIONS_FOLDER).mkdir(exist_ok=True)

    def make(self, begin: Begin) -> None:
        """Write them, chunk by chunk, by a function that begins a chunk, patiently or not, and returns its parts.

        A chunk is begun while the one before is solved: a process without a part of that takes one of the next. Scenes
        that a chunk has put off are another chunk, so that which ones share a pattern does not depend on the time.
        """
        for k in range(0, len(self._rows), MAX_PLANNED_SCENES):
            while k - len(self._ended) > MAX_PLANNED_SCENES:
                if not self._wait(begin):
                    return
            some = self._rows[k : k + MAX_PLANNED_SCENES]
            self._chunks.append(_Chunk(some, begin(some, False)))
        while self._chunks and self._wait(begin):
            pass

    def _wait(self, begin: Begin) -> bool:
        """Wait a moment, or finish a chunk whose parts have ended; whether the run goes on."""
        for chunk in self._chunks:
            if all(part.done() for part in chunk.parts):
                self._finish(chunk, begin)
                return not self._closed.is_set()
        return not self._closed.wait(SOLUTION_POLL_S)

    def _finish(self, chunk: _Chunk, begin: Begin) -> None:
        """Begin with what a chunk has put off; a reason for each of its other scenes that has no solution."""
        late = set[str]()
        try:
            for part in chunk.parts:
                notes, names = part.result()
                self._notes += notes
                late.update(names)
        except BrokenProcessPool:
            self._notes.append("a process of the batch engine died; the scenes that it had are solved on the CPU")
        except CancelledError:
            pass
        self._chunks = [each for each in self._chunks if each is not chunk]
        if self._closed.is_set():  # the folder of solutions is gone
            return
        if again := [row for row in chunk.rows if row.name in late]:
            self._chunks.append(_Chunk(again, begin(again, True)))
        for row in chunk.rows:
            if not self._places[row.name].exists() and row.name not in self._ended | late:
                why = "solved by the CPU engine: the batch engine stopped before this scene"
                solution_file.write(self._places[row.name], SolvedScene("", why=why))

    def has(self, row: Row) -> bool:
        """Whether a row's solution is there, or none is needed."""
        if (now := time.monotonic()) > self._seen + SOLUTION_POLL_S:
            self._there, self._seen = {path.stem for path in (self._folder / SOLUTIONS_FOLDER).glob("*.npz")}, now
        return row.name not in self._places or row.name in self._there

    def watch(self, event: dict[str, Any]) -> None:
        """Pass on an event and the notes before it; the solution of a scene that has ended is deleted."""
        if event["event"] == "scene" and (place := self._places.get(event["scene"])):
            self._ended.add(event["scene"])
            place.unlink(missing_ok=True)
        self._tell()
        self._on_event(event)

    def close(self) -> None:
        """No more solutions are needed."""
        self._closed.set()
        for chunk in list(self._chunks):
            for part in chunk.parts:
                part.cancel()
        self._tell()
        self._clear()

    def _tell(self) -> None:
        while self._notes:
            self._on_event({"event": "note", "scene": "", "note": self._notes.popleft()})

    def _clear(self) -> None:
        """Delete the solutions of these rows; other shards may still need theirs."""
        for place in {*self._places.values()}.intersection((self._folder / SOLUTIONS_FOLDER).glob("*.npz")):
            place.unlink(missing_ok=True)
        with suppress(OSError):  # not empty, or not there
            os.rmdir(self._folder / SOLUTIONS_FOLDER)


def solvers(workers: int, devices: int) -> int:
    """Processes that solve: a GPU waits for the one that feeds it, so several share it, and half of the cores feed."""
    return max(devices, min(MAX_PROCESSES_PER_GPU * devices, workers // 2))


def usable_devices() -> list[str]:
    """The devices of PyTorch that solve. Raises UserError: none can."""
    try:
        from tacgen.tensor_engine import device
    except ImportError:
        raise UserError("--engine cuda needs PyTorch: pip install 'tacgen[torch]'") from None
    if not (found := device.usable()):
        raise UserError("--engine cuda: PyTorch finds no GPU that it can use; --engine local needs none")
    return found


def run_scene(
    row: Row, folder: Path, *, overwrite: bool = False, on_event: OnEvent = lambda event: None
) -> SceneResult:
    """As pipeline.run_scene, with the solution that there is for this scene."""
    from tacgen.batch import pipeline
    from tacgen.batch.recorder import SceneWork

    solution, device = solution_file.read(_place(folder, row)), None
    if solution is not None and solution.states:
        device = _drawing_device(row)
    return pipeline.run_work(SceneWork(row, on_event, solution, device), folder, overwrite=overwrite)


def prepare(row: Row) -> None:
    """Make ready in this process for pictures like a row's, which takes seconds, while other processes solve it."""
    from tacgen.batch import pipeline, recorder  # noqa: F401  # with all that a scene needs
    from tacgen.render import pictures

    if (device := _drawing_device(row)) is not None:
        pictures.prepare(recorder.picture_settings(row), device)


def _drawing_device(row: Row) -> str | None:
    """The GPU on which this process draws a scene's pictures, if it has some and a GPU can; the processes are spread
    over all GPUs."""
    from tacgen.render.images import clear

    if not (row.recipe.outputs & IMAGE_OUTPUTS and clear(row.sensor, row.recipe.render.method)):
        return None
    from tacgen.tensor_engine import device  # PyTorch, which takes seconds and memory

    found = device.usable()
    return found[os.getpid() % len(found)] if found else None


def scene_of(row: Row) -> Scene | str:
    """A row's scene, or what the batch engine lacks for it."""
    from tacgen.recipe import scene_of_row

    if row.other is not None:
        return "a grasp"
    try:
        scene = scene_of_row.build(row)
    except UserError:
        return "the scene cannot be built"  # its worker says why
    if scene.prony_terms and row.recipe.outputs & STRESS_OUTPUTS:  # internal variables are ten times as much as a frame
        return "stress of a viscous gel"
    return scene


def _unfinished(rows: Sequence[Row], folder: Path, overwrite: bool) -> list[Row]:
    """The rows whose bundles are not there, or will be made again."""

    def kept(row: Row) -> bool:
        try:
            made = resume.existing([row], folder)
        except UserError:  # of other inputs: its worker replaces it, or says so
            return False
        return len(made) == len(row.bundles) and not (overwrite and {*made.values()} != {__version__})

    return [row for row in rows if not kept(row)]


def _begun(
    rows: Sequence[Row], folder: Path, devices: Sequence[str], solving: Executor, count: int, mapped: Mapped,
    drawing: int, patient: bool,
) -> list[Future[SolvedPart]]:  # fmt: skip
    """Begin to write a solution for each row, or why there is none, in parts; where a process has died, a part that has
    failed. drawing: workers that draw on each device meanwhile. patient: no scene is put off."""
    from tacgen.tensor_engine.device import beside
    from tacgen.tensor_engine.planning import divided

    plans = list(mapped(_planned, enumerate(rows)))
    parts, share, begun = divided(plans, count), GPU_MEMORY_SHARE / -(-count // len(devices)), []
    try:
        for part, device in zip(parts, cycle(devices), strict=False):
            some, memory = {k: rows[k] for k in part}, share * beside(device, drawing)
            begun.append(solving.submit(_solve, some, [plans[k] for k in part], folder, device, memory, patient))
        return begun
    except BrokenProcessPool as error:
        failed = Future[SolvedPart]()
        failed.set_exception(error)
        return [failed]


def _planned(numbered: tuple[int, Row]) -> "Planned":
    """A row's scene with its pattern; one with forces on its coarse mesh, which comes first."""
    from tacgen.mechanics import presolve
    from tacgen.tensor_engine.planning import Planned

    number, row = numbered
    if isinstance(scene := scene_of(row), str):
        return Planned(number, why=scene)
    return Planned.of((number, scene if scene.forced is None else presolve.rough(scene)))


def _solve(
    rows: Mapping[int, Row], plans: Sequence["Planned"], folder: Path, device: str, share: float, patient: bool
) -> SolvedPart:
    """Write a solution for each of some rows that are not put off, or why there is none; `share`: the part of the
    device's memory for this process."""
    from tacgen.tensor_engine.device import chosen, named

    memory, late = chosen(device, share), list[str]()
    versions = ", ".join(f"{package} {version(package)}" for package in ("numpy", "scipy", "warp-lang"))
    by = f"batch engine on {named(device)}, {versions}"
    try:
        for k, solved, heights in _solutions(rows, plans, device, memory, patient):
            if solved.late:
                late.append(rows[k].name)
                continue
            solution = SolvedScene(by, solved.states, heights=heights)
            if solved.why is not None:
                solution = SolvedScene(by, why=f"solved by the CPU engine: {solved.why}")
            solution_file.write(_place(folder, rows[k]), solution, histories=rows[k].recipe.differentiable)
    except RuntimeError as error:  # PyTorch's, as when the GPU's memory is full: the workers solve what is left
        stopped = f"the batch engine stopped: {str(error).splitlines()[0]}; the other scenes are solved on the CPU"
        return SolvedPart([stopped], late)
    return SolvedPart(late=late)


def _solutions(
    rows: Mapping[int, Row], plans: Sequence["Planned"], device: str, memory: float, patient: bool
) -> Iterator[tuple[int, "Solved", Sequence[float]]]:
    """Solutions of some rows by their numbers, with the heights that presolve found."""
    from tacgen.mechanics import presolve
    from tacgen.tensor_engine import pool
    from tacgen.tensor_engine.planning import Planned

    solve = partial(pool.solved, device=device, memory=memory, patient=patient)
    rough = {plan.number for plan in plans if plan.scene and plan.scene.forced}
    ready, heights = [plan for plan in plans if plan.number not in rough], dict[int, list[float]]()
    for k, solved in solve([plan for plan in plans if plan.number in rough]):
        if solved.why is None and isinstance(scene := scene_of(rows[k]), Scene):
            heights[k] = [float(state.pose[2, 3]) for state in solved.states]
            ready.append(Planned.of((k, presolve.refined(scene, heights[k]))))
        else:
            yield k, solved, ()
    for k, solved in solve(ready):
        yield k, solved, heights.get(k, ())


def _place(folder: Path, row: Row) -> Path:
    return folder / SOLUTIONS_FOLDER / f"{row.name}.npz"
