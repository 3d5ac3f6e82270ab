"""Printing that cannot stop a run: what a closed pipe, a lost terminal or a full disk does not take is dropped."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

from tacgen.base.errors import printable


def open_standard_streams() -> None:
    """Open /dev/null in the place of closed standard streams.

    The next files opened would get their numbers, and messages of libraries and worker processes would end in these.
    """
    for number, mode in enumerate(("r", "w", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is this one
            os.set_inheritable(number, True)  # worker processes have the same streams
            stream = os.fdopen(number, mode, closefd=False)
            setattr(sys, ("stdin", "stdout", "stderr")[number], stream)


@contextmanager
def dropping(stream: TextIO) -> Iterator[None]:
    """Print in this block to `stream`; once that fails, /dev/null takes its place, also for what is buffered."""
    try:
        yield
    except (OSError, ValueError):  # ValueError: it was closed
        with suppress(OSError, ValueError):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, stream.fileno())
            os.close(null)


def say(text: str, *, err: bool = False) -> None:
    """Print a line to stdout or stderr if it takes one; control characters of file names and contents are escaped."""
    stream = sys.stderr if err else sys.stdout
    with dropping(stream):
        print(printable(text), file=stream, flush=True)


@contextmanager
def silent_errors() -> Iterator[None]:
    """Drop what libraries, also those in C, print to stderr in this block."""
    sys.stderr.flush()
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)
