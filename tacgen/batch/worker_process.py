"""A worker process as seen by the parent: its messages, the time of the last one, its memory."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from multiprocessing import connection
from pathlib import Path
from typing import Any

from tacgen.base.machine import cores, environment
from tacgen.recipe.row import Row

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
WORKER_GB = 1.0  # assumed memory of a worker for `--workers auto`; most scenes at `default` need half of it
WORKER_START_TIMEOUT_S = 300.0  # longest time from start to `ready`, for imports [s]


@dataclass(frozen=True)
class Limits:
    """Limits of time and memory of a scene, beyond which its worker is stopped, and of scenes per worker."""

    silence_s: float = 1800.0  # longest time without a new frame
    memory_gb: float | None = None  # None: an equal share of 90 % of the machine's memory
    scenes: int = 1000  # then the worker is replaced, as a precaution: a new one takes 3 s of a core to start


@dataclass
class Job:
    """A scene to make: row number `place`, which is resolved only when it is needed."""

    rows: Sequence[Row]
    place: int
    tries: int = 0
    not_before: float = 0.0  # of time.monotonic

    @cached_property
    def row(self) -> Row:
        """The scene."""
        return self.rows[self.place]


class Worker:
    """A process, its current job, and the time of its last message."""

    def __init__(self, task: str, first: tuple[str, Row] | None = None) -> None:
        """`first`: a function, by its `module:name`, that it calls with a row before its first job."""
        self.link, theirs = connection.Pipe()
        with _without_interrupts():
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "tacgen.batch.worker_main", str(theirs.fileno()), str(os.getpid())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=2,  # to stderr: prints of libraries must not mix with results
                env=environment(**_threads()),
            )
        theirs.close()
        self.ready = False
        self.job: Job | None = None
        self.last_message = time.monotonic()
        self.scenes_made = 0
        self._send({"path": sys.path, "task": task})
        self._send(first)

    def give(self, job: Job, folder: Path, overwrite: bool) -> None:
        """Send it a job."""
        job.tries += 1
        self.job, self.last_message = job, time.monotonic()
        self._send((job.row, folder, overwrite))

    def listen(self) -> list[tuple[str, Any]]:
        """Its messages since the last call; the last one is ("lost", reason) if the process has ended."""
        messages: list[tuple[str, Any]] = []
        try:
            while self.link.poll():
                messages.append(self.link.recv())
                self.last_message = time.monotonic()
        except (EOFError, OSError):
            messages.append(("lost", _exit_reason(self.stop(patience=5.0))))  # a busy machine ends it slowly
        return messages

    def excess(self, limits: Limits, memory_gb: float) -> str:
        """The limit that it exceeds, as text; empty if none."""
        silence = time.monotonic() - self.last_message
        if self.job and silence > limits.silence_s:
            return f"no new frame for {limits.silence_s:g} s"
        if not self.ready and silence > WORKER_START_TIMEOUT_S:
            return f"not started after {WORKER_START_TIMEOUT_S:g} s"
        used = memory(self.process.pid)
        return f"{used:.2f} GB of memory used, {memory_gb:.2f} allowed" if used > memory_gb else ""

    def stop(self, patience: float = 0.5) -> int:
        """End the process, killing it after `patience` seconds, and return its exit code."""
        self.link.close()  # the process ends by itself when it waits for a job
        try:
            return self.process.wait(patience)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()

    def _send(self, message: Any) -> None:
        with suppress(OSError):  # `listen` reports a process that has died
            self.link.send(message)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block Ctrl-C, which is sent to the whole process group, for a process that is started in this block."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _threads() -> dict[str, str]:
    """Environment variables for threads of BLAS: 1 unless set to a positive number."""
    said = {name: os.environ.get(name, "") for name in THREAD_VARIABLES}
    return {name: value if value.isdecimal() and int(value) > 0 else "1" for name, value in said.items()}


def memory(pid: int) -> float:
    """Resident memory of a process [GB]; 0 if not available."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e9
    except (OSError, ValueError, IndexError):
        return 0.0


def machine_memory() -> float:
    """Memory of this machine, or the limit of its control group [GB]."""
    sizes = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    with suppress(OSError, ValueError):
        sizes.append(int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return min(sizes) / 1e9


def usual_workers() -> int:
    """The number of workers for `auto`: by cores and memory."""
    return max(1, min(cores(), int(machine_memory() / WORKER_GB)))


def _exit_reason(code: int) -> str:
    """`its worker was killed by SIGSEGV`"""
    if code >= 0:
        return f"its worker ended with exit code {code}"
    with suppress(ValueError):
        return f"its worker was killed by {signal.Signals(-code).name}"
    return f"its worker was killed by signal {-code}"
