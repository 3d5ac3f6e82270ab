"""Worker processes on this machine. If one dies, hangs or uses too much memory, only its scene is affected."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from itertools import islice
from multiprocessing import connection
from pathlib import Path
from threading import Thread
from typing import Any

from tacgen.base.errors import UserError
from tacgen.batch.scene_order import COMPARED_SCENES, SceneOrder
from tacgen.batch.worker_process import Job, Limits, Worker, machine_memory
from tacgen.bundle.resume import SceneResult
from tacgen.recipe.row import Row

SCENE_TASK = "tacgen.batch.pipeline:run_scene"
MAX_TRIES = 2  # a scene whose worker died this often is recorded as failed
POLL_S = 0.2  # longest wait for messages, and interval of checks of the limits [s]
BUSY_RETRY_S = 0.5  # delay before a scene that another run is making is tried again [s]
MAX_FAILED_STARTS = 3  # consecutive workers that end before their first scene; then the run ends

OnEvent = Callable[[dict[str, Any]], None]
Ready = Callable[[Row], bool]  # whether a scene may be begun


class Pool:
    """Worker processes that are kept between calls of `run`, until the block ends."""

    def __init__(
        self,
        workers: int = 1,
        limits: Limits | None = None,
        task: str = SCENE_TASK,
        memory_gb: float | None = None,
        first: str = "",
    ) -> None:
        """`first`: a function that workers call with the first row before their first scene, to make ready."""
        self.size, self.limits, self.task, self.first = workers, limits or Limits(), task, first
        self.memory_gb = self.limits.memory_gb or memory_gb or 0.9 * machine_memory() / workers
        self.workers: list[Worker] = []
        self.last_check = time.monotonic()
        self.failed_starts = 0

    def __enter__(self) -> "Pool":
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self.workers:
            worker.process.kill()
        for worker in self.workers:
            worker.stop()
        self.workers = []

    def run(
        self,
        rows: Sequence[Row],
        folder: Path,
        *,
        overwrite: bool = False,
        on_event: OnEvent = lambda event: None,
        enough: Callable[[], bool] = lambda: False,
        ready: Ready = lambda row: True,
    ) -> list[SceneResult]:
        """Make the scenes of all rows, with results in the same order. `on_event` is called as in `batch.run`. As soon
        as `enough` is true it returns the results that there are; the others' workers end with the pool. A scene is
        begun once its row is `ready`.

        A scene whose worker was lost is tried once more. After that, or if it cannot be made, its status is `failed`.

        Raises:
            OSError: the disk is full or read-only, so that all other scenes would fail too.
            UserError: workers do not start.
        """
        batch = _Batch(rows, folder, on_event, ready, in_order=self.size == 1)
        first = (self.first, rows[0]) if self.first and len(rows) else None
        while len(batch.results) < len(rows) and not enough():
            self._assign_jobs(batch, overwrite, first)
            for worker, kind, what in self._messages():
                if kind == "event":
                    on_event(what)
                elif kind == "ready":
                    worker.ready, self.failed_starts = True, 0
                else:
                    job, worker.job = worker.job, None
                    self._release(worker, kind, what)
                    if job is not None:
                        batch.settle(job, kind, what)
        return [result for _, result in sorted(batch.results.items())]

    def _assign_jobs(self, batch: "_Batch", overwrite: bool, first: tuple[str, Row] | None) -> None:
        """Start as many workers as there are jobs, up to the limit, and give each idle worker a job; `first`: a
        function, and a row for which workers call it before."""
        busy = sum(worker.job is not None for worker in self.workers)
        while len(self.workers) < min(self.size, busy + len(batch.waiting)):
            self.workers.append(Worker(self.task, first))
        for worker in self.workers:
            if worker.ready and worker.job is None:
                if (job := batch.next()) is None:
                    break
                worker.give(job, batch.folder, overwrite)

    def _messages(self) -> list[tuple[Worker, str, Any]]:
        """Messages received within POLL_S: worker, kind, content. Workers that exceed a limit are stopped: `lost`."""
        readable = connection.wait([worker.link for worker in self.workers], timeout=POLL_S)
        messages = [(w, kind, what) for w in self.workers if w.link in readable for kind, what in w.listen()]
        if time.monotonic() - self.last_check > POLL_S:
            self.last_check = time.monotonic()
            for worker in self.workers:
                if worker.link not in readable and (excess := worker.excess(self.limits, self.memory_gb)):
                    worker.process.kill()
                    worker.stop()
                    messages.append((worker, "lost", f"its worker was stopped: {excess}"))
        return messages

    def _release(self, worker: Worker, kind: str, what: Any) -> None:
        """Remove a worker that is lost or has made its maximum of scenes."""
        worker.scenes_made += 1
        if kind == "lost":
            self.workers.remove(worker)
            self.failed_starts += not worker.ready
            if self.failed_starts >= MAX_FAILED_STARTS:
                raise UserError(f"workers end before their first scene: {what}")
        elif worker.scenes_made >= self.limits.scenes:
            self.workers.remove(worker)
            Thread(target=worker.stop, args=(5.0,)).start()  # its process takes a while to end


class _Batch:
    """The waiting jobs and the results of a call of `Pool.run`."""

    def __init__(
        self, rows: Sequence[Row], folder: Path, on_event: OnEvent, ready: Ready = lambda row: True, *, in_order: bool
    ) -> None:
        self.waiting = deque(Job(rows, place) for place in range(len(rows)))
        self.results: dict[int, SceneResult] = {}  # by place among the rows
        self.folder, self.on_event, self.ready = folder, on_event, ready
        self.order, self.window = SceneOrder(), 1 if in_order else COMPARED_SCENES

    def next(self) -> Job | None:
        """Take the job that should be begun first, if one may be begun now."""
        now = time.monotonic()
        ready = (job for job in self.waiting if self.ready(job.row))
        jobs = [job for job in islice(ready, self.window) if job.not_before <= now]
        if not jobs:
            return None
        job = jobs[self.order.longest([job.row for job in jobs])]
        self.waiting.remove(job)
        return job

    def settle(self, job: Job, kind: str, what: Any) -> None:
        """Store the result of a job, queue it again, or record the scene as failed."""
        if kind == "full":
            raise OSError(*what)
        if kind == "busy":
            job.tries, job.not_before = job.tries - 1, time.monotonic() + BUSY_RETRY_S
            self.waiting.append(job)
        elif kind == "done":
            self.order.learn(job.row, what.seconds)
            self._keep(job, what)
        else:
            reason = "; ".join(what) if kind == "refused" else str(what).strip().splitlines()[-1]
            details = {"traceback": what} if kind == "error" else {}
            if kind != "refused" and job.tries < MAX_TRIES:
                self.waiting.append(job)
                self.on_event({"event": "retry", "scene": job.row.name, "reason": reason, **details})
            else:
                self._keep(job, failed(job.row, self.folder, reason), **details)

    def _keep(self, job: Job, result: SceneResult, **details: Any) -> None:
        self.results[job.place] = result
        keys = {each.name: each.key for each in job.row.bundles}
        self.on_event({**outcome(result), "keys": keys, "tries": job.tries, **details})


def failed(row: Row, folder: Path, reason: str) -> SceneResult:
    """The result of a scene that could not be made."""
    return SceneResult(row.name, folder / f"{row.name}.h5", "failed", reason, row.frames)


def outcome(result: SceneResult) -> dict[str, Any]:
    """The event that ends a scene."""
    plain = {name: getattr(result, name) for name in ("status", "reason", "frames", "seconds")}
    return {"event": "scene", "scene": result.name, "path": str(result.path), **plain}
