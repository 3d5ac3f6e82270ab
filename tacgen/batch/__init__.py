"""Batches: an engine makes many scenes in parallel, and the journal records the outcome of each.

Engines call one function, `pipeline.run_scene`, for each row of a plan, and know nothing else of the scenes.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tacgen import atomic_file
from tacgen.batch import dask_engine
from tacgen.batch.local import TASK, OnEvent, Pool
from tacgen.batch.worker_process import Limits
from tacgen.bundle.journal import Journal, Shard, write_plan
from tacgen.bundle.resume import SceneResult, refuse_foreign
from tacgen.errors import UserError
from tacgen.recipe.plan import Plan

__all__ = ["ENGINES", "Limits", "run"]


@contextmanager
def _local(workers: int, limits: Limits, task: str, scheduler: str) -> Iterator[Callable[..., list[SceneResult]]]:
    if scheduler:
        raise UserError(f"--scheduler {scheduler}: needs --engine dask")
    with Pool(workers, limits, task) as pool:
        yield pool.run


ENGINES = {"local": _local, "dask": dask_engine.engine}


def run(
    plan: Plan,
    folder: Path,
    *,
    workers: int = 1,
    overwrite: bool = False,
    shard: Shard | None = None,
    limits: Limits | None = None,
    engine: str = "local",
    scheduler: str = "",
    task: str = TASK,
    on_event: OnEvent = lambda event: None,
) -> list[SceneResult]:
    """Make every scene of a plan that is not finished yet. Called again, it resumes a run that was stopped.

    Args:
        plan: the scenes; with a shard, only its own.
        folder: of bundles, plan and journal; other runs may use it at the same time.
        workers: number of processes; with a scheduler, its workers are used instead.
        overwrite: make finished scenes again, and replace bundles of other inputs.
        shard: which part of the whole plan this is.
        limits: limits of a scene and of a worker.
        engine: a name in ENGINES.
        scheduler: address of a Dask scheduler.
        task: `module:function` with the signature of pipeline.run_scene.
        on_event: called with each event: frame, note, retry or outcome.

    Raises:
        UserError: a bundle of other inputs has a scene's name, or no worker starts.
        OSError: the disk is full or read-only, or permission is missing.
    """
    if engine not in ENGINES:
        raise UserError(f"--engine {engine}: must be one of {', '.join(ENGINES)}")
    folder.mkdir(parents=True, exist_ok=True)
    atomic_file.sweep(folder)
    if not overwrite:
        refuse_foreign(plan.rows, folder)
    write_plan(plan, folder, shard)
    with Journal(folder, shard) as journal:

        def record(event: dict[str, Any]) -> None:
            journal.write(event)
            on_event(event)

        try:
            with ENGINES[engine](workers, limits or Limits(), task, scheduler) as make:
                return make(plan.rows, folder, overwrite=overwrite, on_event=record)
        finally:
            atomic_file.sweep(folder)
