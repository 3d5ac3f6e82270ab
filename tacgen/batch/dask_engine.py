"""Dask distributed: scenes on the workers of a cluster, each in a monitored process as on one machine."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from tacgen.base.errors import UserError
from tacgen.batch.local import OnEvent, Pool, failed, outcome
from tacgen.batch.worker_process import Limits
from tacgen.bundle.resume import SceneResult
from tacgen.recipe.row import Row

SCHEDULER_TIMEOUT_S = 30  # longest wait for a scheduler
_thread = threading.local()  # on a Dask worker: the pool of this thread


@contextmanager
def engine(workers: int, limits: Limits, task: str, scheduler: str) -> Iterator[Callable[..., list[SceneResult]]]:
    """Connect to the scheduler of a cluster, or start a local cluster of `workers` processes for the block.

    Raises:
        UserError: Dask is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise UserError("--engine dask needs Dask: pip install 'tacgen[dask]'") from None
    with ExitStack() as stack:
        if scheduler:
            try:
                client = stack.enter_context(Client(scheduler, timeout=SCHEDULER_TIMEOUT_S))
            except (OSError, ValueError, ImportError) as error:
                raise UserError(f"--scheduler {scheduler}: {str(error).splitlines()[0]}") from None
        else:
            local = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
            client = stack.enter_context(Client(stack.enter_context(local)))

        def run(
            rows: Sequence[Row], folder: Path, *, overwrite: bool = False, on_event: OnEvent = lambda event: None
        ) -> list[SceneResult]:
            return _run(client, (limits, task), rows, folder.resolve(), overwrite, on_event)

        yield run


def _run(
    client: Any, how: tuple[Limits, str], rows: Sequence[Row], folder: Path, overwrite: bool, on_event: OnEvent
) -> list[SceneResult]:
    """Submit all rows and collect the results. If a Dask worker is lost, another one makes its scene."""
    from distributed import KilledWorker, as_completed

    futures = {client.submit(make, row, folder, overwrite, how, pure=False): k for k, row in enumerate(rows)}
    results: dict[int, SceneResult] = {}
    try:
        for future in as_completed(list(futures)):
            place = futures.pop(future)
            if future.cancelled():
                raise UserError("the Dask scheduler is gone; finished scenes are kept, run again to go on")
            try:
                result, events = future.result()
            except KilledWorker as error:
                reason = f"its Dask worker was lost, {error.allowed_failures + 1} times in a row"
                result = failed(rows[place], folder, reason)
                events = [outcome(result)]
            results[place] = result
            for event in events:
                on_event(event)
            future.release()
    finally:
        client.cancel(list(futures))
    return [results[place] for place in range(len(rows))]


def make(row: Row, folder: Path, overwrite: bool, how: tuple[Limits, str]) -> tuple[SceneResult, list[dict[str, Any]]]:
    """On a Dask worker: make a scene in this thread's process, which is kept; returns its events but frames."""
    from distributed import get_worker

    if getattr(_thread, "how", None) != how:
        if hasattr(_thread, "pool"):
            _thread.pool.__exit__()
        (limits, task), most = how, get_worker().memory_manager.memory_limit  # [bytes]; None without a limit
        _thread.how, _thread.pool = how, Pool(1, limits, task, memory_gb=most / 1e9 if most else None)
    events: list[dict[str, Any]] = []

    def on_event(event: dict[str, Any]) -> None:
        if event["event"] != "frame":
            events.append(event)

    return _thread.pool.run([row], folder, overwrite=overwrite, on_event=on_event)[0], events
