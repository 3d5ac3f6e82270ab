"""Steps of a calibration: what goes on and how much of the work is done, told to listeners, and work on all cores.

A function that takes seconds announces its work by `expect`, in seconds of a core, roughly, and calls `begin` before
each part; `on_workers` runs parts in processes of their own, which the parts' announcements leave.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import connection
from pathlib import Path
from typing import Any

from tacgen.base import machine
from tacgen.base.errors import UserError
from tacgen.batch.worker_process import Job, Worker

Listener = Callable[[str, float], None]  # what goes on, and the share of the expected work that is done
MAX_WORKERS = 16  # processes, however many cores there are: each takes seconds to start
MESSAGE_WAIT_S = 1.0  # longest wait for a message of a worker before listeners are told again [s]
INTERRUPTED = "interrupted"  # first word of the note on a fit that Ctrl-C has ended


class Work:
    """Expected and finished work [s of a core]."""

    def __init__(self) -> None:
        self.listeners: list[Listener] = []
        self.expected = self.done = self.now = 0.0
        self.text = ""  # of the step that was begun

    def tell(self, text: str) -> None:
        """Tell all listeners what goes on."""
        share = self.done / self.expected if self.expected else 0.0
        for listener in self.listeners:
            listener(text, min(share, 1.0))


_work = Work()


@contextmanager
def telling(listener: Listener) -> Iterator[None]:
    """Call the listener with each step that is begun in this block."""
    _work.listeners.append(listener)
    _work.expected = _work.done = _work.now = 0.0
    try:
        yield
    finally:
        _work.listeners.remove(listener)


def expect(seconds: float) -> None:
    """Announce work [s of a core]."""
    _work.expected += seconds


def begin(text: str, seconds: float) -> None:
    """Say that a step of so many expected seconds begins; the one before has ended."""
    _work.done, _work.now, _work.text = _work.done + _work.now, seconds, text
    _work.tell(text)


def go_on(text: str) -> None:
    """Say what goes on within the step that was begun."""
    _work.tell(f"{_work.text}: {text}")


def on_workers(
    function: Callable[..., Any], parts: Sequence[tuple[Any, ...]], texts: Sequence[str], seconds: float
) -> list[Any]:
    """The function's results for each part's arguments, in order, each on a core of its own.

    Args:
        function: of a module; its arguments and results can be pickled.
        texts: what goes on, a part each.
        seconds: expected work of a part.

    Raises UserError: as of the function.
    """
    count = min(machine.cores(), MAX_WORKERS, len(parts))
    if count < 2:
        found = []
        for text, part in zip(texts, parts, strict=True):
            begin(text, seconds)
            found.append(function(*part))
        return found
    begin(texts[0], 0.0)
    rows: list[Any] = [(function, part) for part in parts]  # what a worker's task is called with
    jobs = [Job(rows, k) for k in range(len(rows))]
    workers = [Worker("tacgen.calibrate.steps:run_part") for _ in range(count)]
    try:
        return _shared(workers, jobs, texts, seconds)
    finally:
        for worker in workers:
            worker.process.kill()
            worker.stop()


def _shared(workers: list[Worker], jobs: list[Job], texts: Sequence[str], seconds: float) -> list[Any]:
    """The results of jobs that workers make. Raises UserError: a worker ends, or a part is refused."""
    waiting, results, told = list(range(len(jobs))), dict[int, Any](), time.monotonic()
    at: dict[int, int] = {}  # number of the worker's part, by the worker's place
    while len(results) < len(jobs):
        for worker in connection.wait([one.link for one in workers], timeout=MESSAGE_WAIT_S):
            number = [one.link for one in workers].index(worker)  # type: ignore[arg-type]
            for kind, what in workers[number].listen():
                if kind == "done":
                    results[at[number]] = what
                    begin(f"{texts[at[number]]}: done", 0.0)
                    _work.done += seconds
                elif kind == "event":
                    _work.tell(f"{texts[at[number]]}: {what['text']}")
                    told = time.monotonic()
                elif kind == "refused":
                    raise UserError(what)
                elif kind != "ready":
                    raise UserError(f"{texts[at.get(number, 0)]}: {str(what).strip().splitlines()[-1]}")
                if kind in ("done", "ready") and waiting:
                    at[number] = waiting.pop(0)
                    workers[number].give(jobs[at[number]], Path(), False)
        if time.monotonic() - told > 5 * MESSAGE_WAIT_S and at:
            told = time.monotonic()
            running = [texts[k] for k in sorted(set(at.values()) - set(results))]
            _work.tell(" and ".join(running[:2]))
    return [results[k] for k in range(len(jobs))]


def run_part(job: tuple[Callable[..., Any], tuple[Any, ...]], folder: Path, *, overwrite: bool, on_event: Any) -> Any:
    """One part, as a worker runs it; its steps are passed on."""
    function, part = job
    with telling(lambda text, share: on_event({"text": text})):
        return function(*part)
