"""Fixtures that many test modules share."""

import gc
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from tacgen.base.array_cache import cache_folder
from tacgen.batch import local
from tacgen.batch.worker_process import Worker
from tacgen.recipe.row import Row

pytest_plugins = ["helpers.processor_time"]
gc.set_threshold(100_000)  # by the usual 700, a twentieth of the tests' time goes into searching for garbage
# tests with caches of their own share the compiled code, and so do the processes that they start
os.environ.setdefault("TACGEN_CODE_DIR", str(cache_folder() / "code"))


@pytest.fixture(scope="session")
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of all processes of this run of pytest."""
    base = tmp_path_factory.getbasetemp()
    return (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "cache"


@pytest.fixture(scope="module")
def own_cache(_cache: Path) -> Iterator[None]:
    """A cache that was empty when the tests began, so that none depends on what was kept before."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TACGEN_CACHE_DIR", str(_cache))
        yield


class KeptWorkers:
    """Idle workers by task, environment and working folder, so that runs of tests share the time of their start."""

    def __init__(self) -> None:
        self.idle: dict[object, list[Worker]] = defaultdict(list)

    def keep(self, patch: pytest.MonkeyPatch) -> None:
        """From now on pools leave their idle workers to later ones."""
        leave = local.Pool.__exit__

        def begun(task: str, first: tuple[str, Row] | None = None) -> Worker:
            there = self.idle[_place(task)]
            return there.pop() if there else Worker(task, first)

        def end(pool: local.Pool, *error: object) -> None:
            idle = [worker for worker in pool.workers if worker.ready and worker.job is None]
            pool.workers = [worker for worker in pool.workers if worker not in idle]
            self.idle[_place(pool.task)] += idle
            leave(pool, *error)

        patch.setattr(local, "Worker", begun)
        patch.setattr(local.Pool, "__exit__", end)

    def stop(self) -> None:
        """End them."""
        for worker in (worker for workers in self.idle.values() for worker in workers):
            worker.stop()


def _place(task: str) -> object:
    known = {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}
    return task, os.getcwd(), tuple(sorted(known.items()))


@pytest.fixture(scope="session")
def _workers() -> Iterator[KeptWorkers]:
    workers = KeptWorkers()
    yield workers
    workers.stop()


@pytest.fixture
def kept_workers(_workers: KeptWorkers, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs get the worker processes of earlier runs of this session: for tests that are not about these."""
    _workers.keep(monkeypatch)
