"""Scenes solved many at once on a GPU, chunk after chunk, while worker processes label, draw and write those before.

A solution reaches its worker through a file in the dataset's folder. A scene for which the batch engine lacks
something, or which it does not solve, is solved by its worker as without a GPU, and its bundle says why.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path

from tacgen import __version__
from tacgen.batch import solution_file
from tacgen.batch.local import TASK, OnEvent, Pool
from tacgen.batch.worker_process import Limits
from tacgen.bundle import resume
from tacgen.bundle.resume import SceneResult
from tacgen.errors import UserError
from tacgen.mechanics.scene import Scene
from tacgen.mechanics.solved_scene import SolvedScene
from tacgen.recipe.row import Row

CHUNK = 1024  # scenes that are solved before the first of them is written: some 3 MB of solution each
FOLDER = ".solved"
Mapped = Callable[[Callable, Iterable], Iterable]
SOLVED = f"{__name__}:run_scene"


@contextmanager
def engine(workers: int, limits: Limits, task: str, scheduler: str) -> Iterator[Callable[..., list[SceneResult]]]:
    """Worker processes, and a thread that solves for them.

    Raises:
        UserError: there is no PyTorch, or no GPU that it can use.
    """
    if scheduler:
        raise UserError(f"--scheduler {scheduler}: needs --engine dask")
    device = usable_device()
    with ExitStack() as stack:
        mapped: Mapped = map
        if workers > 1:  # scenes are made ready in processes too
            mapped = stack.enter_context(ProcessPoolExecutor(workers, mp_context=get_context("spawn"))).map
        solver = stack.enter_context(ThreadPoolExecutor(1))
        pool = stack.enter_context(Pool(workers, limits, SOLVED if task == TASK else task))

        def run(
            rows: Sequence[Row], folder: Path, *, overwrite: bool = False, on_event: OnEvent = lambda event: None
        ) -> list[SceneResult]:
            def solve(k: int) -> list[str]:
                return _solve(_unfinished(rows[k : k + CHUNK], folder, overwrite), folder, device, mapped)

            (folder / FOLDER).mkdir(exist_ok=True)
            results: list[SceneResult] = []
            try:
                ahead = solver.submit(solve, 0)
                for k in range(0, len(rows), CHUNK):
                    for note in ahead.result():
                        on_event({"event": "note", "scene": "", "note": note})
                    ahead = solver.submit(solve, k + CHUNK)
                    results += pool.run(rows[k : k + CHUNK], folder, overwrite=overwrite, on_event=on_event)
            finally:
                _clear(folder, rows)
            return results

        yield run


def usable_device() -> str:
    """The device of PyTorch that solves. Raises UserError: none can."""
    try:
        from tacgen.tensor_engine import device
    except ImportError:
        raise UserError("--engine cuda needs PyTorch: pip install 'tacgen[torch]'") from None
    if (found := device.usable()) is None:
        raise UserError("--engine cuda: PyTorch finds no GPU that it can use; --engine local needs none")
    return found


def run_scene(row: Row, folder: Path, *, overwrite: bool = False, on_event: OnEvent | None = None) -> SceneResult:
    """As pipeline.run_scene, with the solution that there is for this scene."""
    from tacgen import pipeline

    solution = solution_file.read(_place(folder, row))
    return pipeline.run_scene(row, folder, overwrite=overwrite, on_event=on_event, solution=solution)


def scene_of(row: Row) -> Scene | str:
    """A row's scene, or what the batch engine lacks for it."""
    from tacgen.recipe import scene_of_row

    if row.other is not None:
        return "a grasp"
    if row.recipe.uncertainty is not None:  # its derivatives need the histories of load steps
        return "derivatives of labels"
    if row.recipe.contact.formulation != "distance":
        return f"contact by {row.recipe.contact.formulation}"
    try:
        return scene_of_row.build(row)
    except UserError:
        return "the scene cannot be built"  # its worker says why


def _unfinished(rows: Sequence[Row], folder: Path, overwrite: bool) -> list[Row]:
    """The rows whose bundles are not there, or will be made again."""

    def kept(row: Row) -> bool:
        try:
            made = resume.existing([row], folder)
        except UserError:  # of other inputs: its worker replaces it, or says so
            return False
        return len(made) == len(row.bundles) and not (overwrite and {*made.values()} != {__version__})

    return [row for row in rows if not kept(row)]


def _solve(rows: Sequence[Row], folder: Path, device: str, mapped: Mapped) -> list[str]:
    """Write a solution for each row, or why there is none; returns notes on the run."""
    if not rows:
        return []
    from tacgen.tensor_engine import pool
    from tacgen.tensor_engine.device import named

    found = list(mapped(scene_of, rows))
    scenes = {k: scene for k, scene in enumerate(found) if isinstance(scene, Scene)}
    versions = ", ".join(f"{package} {version(package)}" for package in ("numpy", "scipy", "numba"))
    numbers, by = list(scenes), f"batch engine on {named(device)}, {versions}"
    why = {k: one for k, one in enumerate(found) if isinstance(one, str)}
    notes: list[str] = []
    try:
        for number, solved in pool.solved(scenes.values(), device, mapped=mapped):
            k = numbers[number]
            if solved.why is None:
                solution_file.write(_place(folder, rows[k]), SolvedScene(by, solved.states))
                scenes.pop(k)
            else:
                why[k] = str(solved.why)
    except RuntimeError as error:  # PyTorch's, as when the GPU's memory is full: the workers solve what is left
        notes = [f"the batch engine stopped: {str(error).splitlines()[0]}; the other scenes are solved on the CPU"]
    for k in scenes.keys() | why.keys():
        said = why.get(k, "it stopped before this scene")
        solution_file.write(_place(folder, rows[k]), SolvedScene(by, why=f"solved by the CPU engine: {said}"))
    return notes


def _place(folder: Path, row: Row) -> Path:
    return folder / FOLDER / f"{row.name}.npz"


def _clear(folder: Path, rows: Sequence[Row]) -> None:
    """Delete the solutions of these rows; other shards may still need theirs."""
    for row in rows:
        _place(folder, row).unlink(missing_ok=True)
    with suppress(OSError):  # not empty
        os.rmdir(folder / FOLDER)
