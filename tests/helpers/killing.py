"""A process that is killed at one of its calls to the disk, to see what it leaves."""

import os
import signal
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import Any

Functions = Sequence[tuple[Any, str]]  # modules and names
WRITES = [(os, name) for name in ("pwrite", "ftruncate", "fsync", "replace")]
DISK = [*WRITES, *((os, name) for name in ("open", "rename", "unlink", "mkdir", "rmdir"))]


def calls(work: Callable[[], Any], moment: int = 0, of: Functions = DISK) -> int | None:
    """How many calls of these functions `work` makes, in a forked process that is killed at its `moment`-th; 0: never.

    Returns:
        None where it was killed.

    Raises:
        RuntimeError: `work` failed otherwise.
    """
    answer, told = os.pipe()
    with warnings.catch_warnings():  # Python 3.12 warns of a fork beside other threads
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if not child:
        status = 1
        try:
            made = counted(moment, of)
            work()
            os.write(told, str(len(made)).encode())
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    os.close(told)
    status = os.waitpid(child, 0)[1]
    with os.fdopen(answer) as file:
        said = file.read()
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL:
        return None
    if not said:
        raise RuntimeError("the forked process failed")
    return int(said)


def counted(moment: int, of: Functions) -> list[str]:
    """Have this process killed at its `moment`-th call; the names of the calls that it makes from now on."""
    made: list[str] = []

    def count(name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **more: Any) -> Any:
            made.append(name)
            if len(made) == moment:
                os.kill(os.getpid(), signal.SIGKILL)
            return real(*args, **more)

        return call

    for module, name in of:
        setattr(module, name, count(name, getattr(module, name)))
    return made
