"""One worker process seen from outside: its messages, when the last one came, how much memory it uses."""

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

from tacgen.recipe.plan import Row

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
WORKER_GB = 1.0  # memory that a worker is reckoned to need; most of default quality take half of that
START_S = 300.0  # longest time from start to `ready`, spent on imports [s]
PACKAGE_PARENT = str(Path(__file__).resolve().parents[2])


@dataclass(frozen=True)
class Limits:
    """Time and memory of a scene before its worker is stopped, and scenes before a worker is replaced."""

    silence_s: float = 1800.0  # longest time without a new frame
    memory_gb: float | None = None  # None: nine tenths of the machine's, shared evenly
    scenes: int = 200  # then the worker is replaced by a fresh one


@dataclass
class Job:
    """A scene to make: the one at a place among rows, resolved when its turn comes."""

    rows: Sequence[Row]
    place: int
    tries: int = 0
    not_before: float = 0.0  # of time.monotonic

    @cached_property
    def row(self) -> Row:
        """The scene."""
        return self.rows[self.place]


class Worker:
    """One process, the scene it is making, and when its last message came."""

    def __init__(self, task: str) -> None:
        self.link, theirs = connection.Pipe()
        paths = [PACKAGE_PARENT, *filter(None, [os.environ.get("PYTHONPATH")])]
        with _without_interrupts():
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "tacgen.batch.worker_main", str(theirs.fileno()), str(os.getpid())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=2,  # what a library prints must not end up between results
                env={**os.environ, **_threads(), "PYTHONPATH": os.pathsep.join(paths)},
            )
        theirs.close()
        self.ready = False
        self.job: Job | None = None
        self.last_message = time.monotonic()
        self.scenes_made = 0
        self._send({"path": sys.path, "task": task})

    def give(self, job: Job, folder: Path, overwrite: bool) -> None:
        """Have it make a scene."""
        job.tries += 1
        self.job, self.last_message = job, time.monotonic()
        self._send((job.row, folder, overwrite))

    def listen(self) -> list[tuple[str, Any]]:
        """Its messages since the last call; ("lost", reason) as the last one if the process has ended."""
        messages: list[tuple[str, Any]] = []
        try:
            while self.link.poll():
                messages.append(self.link.recv())
                self.last_message = time.monotonic()
        except (EOFError, OSError):
            messages.append(("lost", _exit_reason(self.stop())))
        return messages

    def excess(self, limits: Limits, memory_gb: float) -> str:
        """Which limit it broke, if any."""
        silence = time.monotonic() - self.last_message
        if self.job and silence > limits.silence_s:
            return f"no new frame for {limits.silence_s:g} s"
        if not self.ready and silence > START_S:
            return f"not started after {START_S:g} s"
        used = memory(self.process.pid)
        return f"{used:.2f} GB of memory used, {memory_gb:.2f} allowed" if used > memory_gb else ""

    def stop(self, patience: float = 0.5) -> int:
        """End the process, by force if it is still there after `patience` seconds, and return its exit code."""
        self.link.close()  # it ends by itself when it next looks for a job
        try:
            return self.process.wait(patience)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()

    def _send(self, message: Any) -> None:
        with suppress(OSError):  # `listen` finds out that a process has died
            self.link.send(message)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Ctrl-C reaches the whole group; a process that is started here never gets it, even before it can say so."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _threads() -> dict[str, str]:
    """Of BLAS and numba, one each unless the environment says another number; numba does not start with 0."""
    said = {name: os.environ.get(name, "") for name in THREADS}
    return {name: value if value.isdecimal() and int(value) > 0 else "1" for name, value in said.items()}


def memory(pid: int) -> float:
    """Resident memory of a process [GB]; 0 where the system does not tell."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e9
    except (OSError, ValueError, IndexError):
        return 0.0


def machine_memory() -> float:
    """Memory of this machine, or of the control group it is limited to [GB]."""
    sizes = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    with suppress(OSError, ValueError):
        sizes.append(int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return min(sizes) / 1e9


def cores() -> int:
    """Processor cores that this process may use: those it is bound to, or fewer if its control group has less time."""
    count = len(os.sched_getaffinity(0))
    with suppress(OSError, ValueError):  # "max" has no limit
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text().split()
        count = min(count, max(1, int(quota) // int(period)))
    return count


def usual_workers() -> int:
    """As many as there are cores, and memory for."""
    return max(1, min(cores(), int(machine_memory() / WORKER_GB)))


def _exit_reason(code: int) -> str:
    """`its worker was killed by SIGSEGV`"""
    if code >= 0:
        return f"its worker ended with exit code {code}"
    with suppress(ValueError):
        return f"its worker was killed by {signal.Signals(-code).name}"
    return f"its worker was killed by signal {-code}"
