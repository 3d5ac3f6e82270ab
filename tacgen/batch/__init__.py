"""Batches: an engine makes many scenes in parallel, and the journal records the outcome of each.

Engines call one function, `pipeline.run_scene`, for each row of a plan, and know nothing else of the scenes.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tacgen.base import atomic_file
from tacgen.base.errors import UserError
from tacgen.base.version import __version__
from tacgen.batch import cuda_engine, dask_engine
from tacgen.batch.local import SCENE_TASK, OnEvent, Pool
from tacgen.batch.worker_process import Limits
from tacgen.bundle import dataset, journal
from tacgen.bundle.bundle import read
from tacgen.bundle.journal import Journal, Shard
from tacgen.bundle.resume import SceneResult, existing
from tacgen.recipe.plan import Plan

__all__ = ["ENGINES", "Limits", "run"]


@contextmanager
def _local(workers: int, limits: Limits, task: str, scheduler: str) -> Iterator[Callable[..., list[SceneResult]]]:
    if scheduler:
        raise UserError(f"--scheduler {scheduler}: needs --engine dask")
    with Pool(workers, limits, task) as pool:
        yield pool.run


ENGINES = {"local": _local, "dask": dask_engine.engine, "cuda": cuda_engine.engine}


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
    task: str = SCENE_TASK,
    on_event: OnEvent = lambda event: None,
) -> list[SceneResult]:
    """Make every scene of a plan that is not finished yet. Called again, it resumes a run that was stopped.

    Args:
        plan: the scenes; with a shard, only its own.
        folder: of bundles, plan and journal; other runs of this plan may use it at the same time.
        workers: number of processes; with a scheduler, its workers are used instead.
        overwrite: replace bundles of other inputs, make those of another version of tacgen again, and remove those
            of earlier runs here that are not in the plan.
        shard: which part of the whole plan this is.
        limits: limits of a scene and of a worker.
        engine: a name in ENGINES.
        scheduler: address of a Dask scheduler.
        task: `module:function` with the signature of pipeline.run_scene.
        on_event: called with each event: frame, note, retry or outcome.

    Raises:
        UserError: a bundle of other inputs has a scene's name, a file that no run wrote has the name of the plan,
            journal or times, or no worker starts.
        atomic_file.Busy: a run of another plan is at work in the folder.
        OSError: the disk is full or read-only, or permission is missing.
    """
    if engine not in ENGINES:
        raise UserError(f"--engine {engine}: must be one of {', '.join(ENGINES)}")
    folder.mkdir(parents=True, exist_ok=True)
    with journal.claimed(plan, folder, shard) as table:
        atomic_file.sweep(folder)
        before = journal.made(folder) if overwrite else set()
        notes = [] if overwrite else _of_other_versions(existing(plan.rows, folder))
        journal.write_plan(table, folder, shard)
        notes += _unplanned(folder, shard, before)
        with Journal(folder, shard) as log:

            def record(event: dict[str, Any]) -> None:
                log.write(event)
                on_event(event)

            for note in notes:
                record({"event": "note", "scene": "", "note": note})
            try:
                with ENGINES[engine](workers, limits or Limits(), task, scheduler) as make:
                    return make(plan.rows, folder, overwrite=overwrite, on_event=record)
            finally:
                atomic_file.sweep(folder)


def _of_other_versions(versions: dict[str, str]) -> list[str]:
    """A note on the scenes that are kept though another version of tacgen made them."""
    others = {name: version for name, version in versions.items() if version != __version__}
    if not others:
        return []
    made = f"made by tacgen {', '.join(sorted(set(others.values())))}, this is {__version__}"
    return [f"kept, {made}: {dataset.some([*others])}; --overwrite makes them again"]


def _unplanned(folder: Path, shard: Shard | None, made: set[tuple[str, str]]) -> list[str]:
    """Notes on bundles that are not in the plan; those that earlier runs here made (name and input key) are removed.

    A shard is answerable for the scenes of its own numbers alone.
    """
    removed, left = [], []
    for path in dataset.unplanned(folder):
        number = re.fullmatch(r"scene-(\d+)(-[LR])?", path.stem)
        if shard is not None and not (number and int(number[1]) % shard[1] == shard[0]):
            continue
        if made and _is_of(path, made):
            path.unlink()
            path.with_suffix(".timing.json").unlink(missing_ok=True)
            removed.append(path.stem)
        else:
            left.append(path.stem)
    notes = [f"removed, no longer in the plan: {dataset.some(removed)}"] if removed else []
    return notes + ([f"left out, not in the plan: {dataset.some(left)}; readers pass over them"] if left else [])


def _is_of(path: Path, made: set[tuple[str, str]]) -> bool:
    try:
        return (path.stem, read(path).attrs["input_key"]) in made
    except UserError:
        return False
