"""Numba, with its machine code kept under the cache folder: for every process and version, and never out of date.

Numba's own cache compares the file of a function alone, and would go on with old code after a change in another file
whose functions and constants are compiled into it. Here a folder of code belongs to one state of all packages that hold
compiled functions, to the versions of what compiles them, and to a processor.
"""

import gc
import hashlib
import os
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import llvmlite
import numba
import numpy as np
from llvmlite import binding
from numba.core import event

from tacgen import atomic_file
from tacgen.array_cache import cache_folder

PACKAGES = ("fem", "optics", "geometry", "contact")  # these hold compiled functions, and import no constants but theirs
WAIT_S = 0.1  # between looks at whether another process is done
F = TypeVar("F", bound=Callable[..., Any])
config: Any = numba.config


@cache
def folder() -> Path:
    """Where machine code of this state of the source is kept for this processor; NUMBA_CACHE_DIR overrides."""
    root, state = Path(__file__).parent, hashlib.sha256()
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            state.update(file.read_bytes())
    tools = platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__
    processor = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    state.update(repr((tools, processor)).encode())
    kept = os.environ.get("NUMBA_CACHE_DIR")
    return (Path(kept) if kept else cache_folder() / "compiled") / f"tacgen-{state.hexdigest()[:16]}"


def njit(*, cache: bool, **options: Any) -> Callable[[F], F]:
    """numba.njit without what only other compilers' code would call; with `cache`, into our folder."""
    return _kept(numba.njit, cache, {"no_cfunc_wrapper": True, **options})


def vectorize(*, cache: bool, **options: Any) -> Callable[[F], F]:
    """numba.vectorize, likewise."""
    return _kept(numba.vectorize, cache, options)


def _kept(decorator: Callable[..., Any], cache: bool, options: dict[str, Any]) -> Callable[[F], F]:
    """Numba looks up its folder when a function is decorated; other packages keep theirs."""

    def decorate(function: F) -> F:
        before = config.CACHE_DIR
        config.CACHE_DIR = str(folder())
        try:
            decorated: F = decorator(cache=cache and _writable(), **options)(function)
        finally:
            config.CACHE_DIR = before
        return decorated

    return decorate


@cache
def _writable() -> bool:
    """Whether code can be kept; else Numba would keep it in a place of its own choice."""
    try:
        folder().mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder(), os.W_OK | os.X_OK)


class _Watch(event.Listener):
    """Adds up the seconds for which something is compiled or waited for, and tells when that begins.

    Python's collector pauses meanwhile: Numba makes millions of objects that stay, and a sixth of its time went there.
    """

    def __init__(self) -> None:
        self.depth, self.begun, self.seconds, self.collected = 0, 0.0, 0.0, True
        self.tell: Callable[[], None] = lambda: None

    def on_start(self, event: Any = None) -> None:
        if not self.depth:
            self.begun, self.collected = time.perf_counter(), gc.isenabled()
            gc.disable()
            self.tell()
        self.depth += 1

    def on_end(self, event: Any = None) -> None:
        self.depth -= 1
        if not self.depth:
            self.seconds += time.perf_counter() - self.begun
            if self.collected:
                gc.enable()


_watch = _Watch()
event.register("numba:compile", _watch)  # type: ignore[no-untyped-call]


def seconds() -> float:
    """That this process has spent on compiling so far, or on waiting for another that compiles."""
    return _watch.seconds


@contextmanager
def telling(tell: Callable[[], None]) -> Iterator[None]:
    """Have `tell` called, once, if something has to be compiled in this block."""

    def once() -> None:
        _watch.tell = lambda: None
        tell()

    _watch.tell = once
    try:
        yield
    finally:
        _watch.tell = lambda: None


@contextmanager
def once(what: str) -> Iterator[None]:
    """A block that compiles `what`: the first process to come here runs it, others wait until its code is kept."""
    done = folder() / what
    with ExitStack() as claims:
        while _writable() and not done.exists():
            try:
                claims.enter_context(atomic_file.claim(done))
                break
            except atomic_file.Busy:
                _watch.on_start()
                time.sleep(WAIT_S)
                _watch.on_end()
        yield
        if _writable():
            done.touch()
