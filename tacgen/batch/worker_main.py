"""The main program of a worker process: makes scenes one after another and reports on them over a pipe.

Started by `worker_process.Worker` as `python -m tacgen.batch.worker_main FD PARENT`; imports only what a scene needs.
"""

import ctypes
import errno
import faulthandler
import importlib
import os
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from tacgen.base.atomic_file import Busy
from tacgen.base.errors import UserError

# Freed memory that glibc keeps, and size from which it takes an array's from the system anew [bytes]. By its own limits
# the pictures of a large sensor, some MB each, come back page by page: 22 instead of 13 ms a frame (9DTact, draft)
MALLOC_TRIM_BYTES, MALLOC_MMAP_BYTES = 2**26, 2**25
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of mallopt(3)
# least time between two returns of freed memory [s]: each costs 12 ms, most of it to get it again
MIN_MEMORY_RETURN_S = 2.0
BACKGROUND_NICENESS = 10  # added to the niceness of a thread that makes ready
DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)  # errors that all scenes would have


def main(link: Connection, parent: int) -> None:
    """Answer each job with an outcome until the parent closes the pipe.

    Sends ("ready", None), ("event", dict) during a scene, and one outcome per job: ("done", SceneResult),
    ("busy", None), ("refused", lines), ("full", (errno, text, file)), ("error", traceback).
    """
    faulthandler.enable()
    threading.Thread(target=_exit_with_parent, args=(parent,), daemon=True).start()
    _be_killed_first()
    _keep_freed_memory()
    setup = link.recv()
    sys.path[:] = setup["path"]
    task, first = _named(setup["task"]), threading.Thread(target=_before, args=(link.recv(),), daemon=True)
    first.start()
    link.send(("ready", None))
    _work(link, task, first.join)


def _named(function: str) -> Any:
    """A function by its `module:name`."""
    module, _, name = function.partition(":")
    return getattr(importlib.import_module(module), name)


def _before(call: Any) -> None:
    """Call a function with a row, if there is one, in the time that other processes leave."""
    if call is None:
        return
    function, row = call
    if sys.platform == "linux":  # elsewhere it is the whole process that would wait
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), BACKGROUND_NICENESS)
    with suppress(Exception):  # a scene that meets it again tells
        _named(function)(row)


def _work(link: Connection, task: Any, made_ready: Callable[[], None]) -> None:
    """Answer jobs until the pipe is closed, each when `made_ready` has returned."""
    returned = time.monotonic()
    while True:
        try:
            row, folder, overwrite = link.recv()
        except EOFError:
            return
        made_ready()
        link.send(_outcome(task, row, folder, overwrite, link))
        if time.monotonic() - returned >= MIN_MEMORY_RETURN_S:
            _return_memory()
            returned = time.monotonic()


def _outcome(task: Any, row: Any, folder: Any, overwrite: bool, link: Connection) -> tuple[str, Any]:
    try:
        return "done", task(row, folder, overwrite=overwrite, on_event=lambda event: link.send(("event", event)))
    except Busy:
        return "busy", None
    except UserError as error:
        return "refused", error.lines
    except OSError as error:
        if error.errno in DISK_ERRORS:
            return "full", (error.errno, error.strerror, str(error.filename or folder))
        return "error", traceback.format_exc()
    except Exception:
        return "error", traceback.format_exc()


def _exit_with_parent(parent: int) -> None:
    """End this process when the parent ends, even during a scene."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _keep_freed_memory() -> None:
    """Have the C library keep what is freed for the next scene's arrays, until `_return_memory`."""
    with suppress(OSError, AttributeError):  # another C library
        libc = ctypes.CDLL(None)
        libc.mallopt(M_TRIM_THRESHOLD, MALLOC_TRIM_BYTES)
        libc.mallopt(M_MMAP_THRESHOLD, MALLOC_MMAP_BYTES)


def _return_memory() -> None:
    """Return freed memory to the system: glibc keeps more of it after each scene, 150 MB after 200 small ones."""
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


def _be_killed_first() -> None:
    """Have Linux kill this process before the parent when memory runs out; the parent records it."""
    with suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("500")


if __name__ == "__main__":
    try:
        main(Connection(int(sys.argv[1])), int(sys.argv[2]))
    except (EOFError, OSError):  # of the pipe: the parent has ended, perhaps during a message
        sys.exit(1)
