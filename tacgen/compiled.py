"""Numba, with its machine code kept under the cache folder: for every process and version, and never out of date.

Numba's own cache compares the file of a function alone, and would go on with old code after a change in another file
whose functions and constants are compiled into it; and it runs whatever its files hold. Here a folder of code belongs
to one state of all packages that hold compiled functions, to the versions of what compiles them, and to a processor,
and code carries a digest: what is not as it was stored is compiled again.
"""

import gc
import hashlib
import os
import pickle
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite
import numba
import numpy as np
from llvmlite import binding
from numba.core import caching, event
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from tacgen import array_cache, atomic_file

PACKAGES = ("fem", "optics", "geometry", "contact")  # these hold compiled functions, and import no constants but theirs
WAIT_S = 0.1  # between looks at whether another process is done
F = TypeVar("F", bound=Callable[..., Any])
pickled: Callable[[Any], bytes] = dumps


@cache
def folder() -> Path:
    """Where machine code of this state of the source is kept for this processor; NUMBA_CACHE_DIR overrides."""
    root, state = Path(__file__).parent, hashlib.sha256(Path(__file__).read_bytes())
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            state.update(file.read_bytes())
    tools = platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__
    processor = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    state.update(repr((tools, processor)).encode())
    kept = os.environ.get("NUMBA_CACHE_DIR")
    return (Path(kept) if kept else array_cache.cache_folder() / "compiled") / f"tacgen-{state.hexdigest()[:16]}"


def njit(*, cache: bool, **options: Any) -> Callable[[F], F]:
    """numba.njit without what only other compilers' code would call; with `cache`, into our folder."""
    compiler: Any = numba.njit

    def decorate(function: F) -> F:
        decorated = compiler(no_cfunc_wrapper=True, **options)(function)
        if cache:
            decorated._cache = _Code(function)
        return cast(F, decorated)

    return decorate


def vectorize(*, cache: bool) -> Callable[[F], F]:
    """numba.vectorize, likewise."""

    def decorate(function: F) -> F:
        decorated: Any = numba.vectorize(function)  # type: ignore[no-untyped-call]
        if cache:
            decorated._dispatcher.cache = _Code(function)
        return cast(F, decorated)

    return decorate


class _Code(caching._Cache):
    """The machine code of one function: an entry of the cache for each signature."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.name = f"{function.__module__}.{function.__qualname__}-{function.__code__.co_firstlineno}"

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """A CompileResult for the types `sig`, or None."""
        target_context.refresh()
        found = array_cache.read(*self._entry(sig))
        rebuild: Any = CompileResult._rebuild
        return None if found is None else rebuild(target_context, *pickle.loads(found))

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a CompileResult, unless it holds addresses of this process."""
        if not data.library.has_dynamic_globals:
            array_cache.store(*self._entry(sig), pickled(data._reduce()))

    def _entry(self, sig: Any) -> tuple[Path, str]:
        """File and key."""
        key = f"{self.name} {sig!r}"
        return self.cache_path / f"{self.name}.{hashlib.sha256(key.encode()).hexdigest()[:16]}.entry", key

    @property
    def cache_path(self) -> Path:
        return folder()

    def enable(self) -> None:
        """Entries are kept from the first."""

    disable = flush = enable


@cache
def _writable() -> bool:
    """Whether code can be kept, and is worth waiting for."""
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
