"""Worker processes that wait for the next run of the same task, so that runs of tests share the time of their start."""

import os
from collections import defaultdict

import pytest

from tacgen.batch import local
from tacgen.batch.worker_process import Worker
from tacgen.recipe.row import Row


class KeptWorkers:
    """Idle workers by task, environment and working folder."""

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
