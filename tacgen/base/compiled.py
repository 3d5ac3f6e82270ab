"""Numba with its own cache of machine code, shared by processes and never out of date.

Numba's cache checks only the file of a function: it would use old code after a change in another file whose functions
or constants are compiled into it, and it runs damaged files. Here each folder of code belongs to one state of all
packages with compiled functions, to the versions of the compilers, and to a processor; code is stored with a digest,
and damaged code is compiled again.
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
from numba.core.cpu import CPUTargetOptions
from numba.core.registry import cpu_target
from numba.core.serialize import dumps

from tacgen.base import array_cache, atomic_file

# with compiled functions; they use no other package's constants
COMPILED_PACKAGES = ("physics", "fem", "optics", "geometry", "mechanics")
COMPILATION_POLL_S = 0.1  # interval at which a waiting process checks whether another has finished [s]
F = TypeVar("F", bound=Callable[..., Any])
pickled: Callable[[Any], bytes] = dumps


@cache
def folder() -> Path:
    """The folder of the machine code of this source and this processor; NUMBA_CACHE_DIR overrides it."""
    root, state = Path(__file__).parents[1], hashlib.sha256(Path(__file__).read_bytes())
    for package in COMPILED_PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            state.update(file.read_bytes())
    tools = platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__
    processor = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    state.update(repr((tools, processor)).encode())
    kept = os.environ.get("NUMBA_CACHE_DIR")
    return (Path(kept) if kept else array_cache.cache_folder() / "compiled") / f"tacgen-{state.hexdigest()[:16]}"


class _Options(CPUTargetOptions):
    """Options of a function, none of them taken over from the function whose compilation asks for it."""

    def finalize(self, flags: Any, options: Any) -> None:
        for name, value in (("fastmath", False), ("error_model", "python")):
            if not flags.is_set(name):
                setattr(flags, name, value)
        super().finalize(flags, options)  # type: ignore[no-untyped-call]


cpu_target.options = _Options


def njit(*, cache: bool, **options: Any) -> Callable[[F], F]:
    """numba.njit without wrappers for calls from C; with `cache`, machine code is kept in `folder`.

    Only functions that Python calls are kept. One that compiled functions call is compiled with them, so that their
    code depends on the source alone, not on what was kept before.
    """
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
    """The cached machine code of one function: one entry for each signature."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.name = f"{function.__module__}.{function.__qualname__}-{function.__code__.co_firstlineno}"

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """A CompileResult for the types `sig`, or None."""
        target_context.refresh()
        found = array_cache.read(*self._entry(sig))
        rebuild: Any = CompileResult._rebuild
        return None if found is None else rebuild(target_context, *pickle.loads(found))

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a CompileResult, unless it contains addresses of this process."""
        if not data.library.has_dynamic_globals:
            array_cache.store(*self._entry(sig), pickled(data._reduce()))

    def _entry(self, sig: Any) -> tuple[Path, str]:
        """File and key of the entry."""
        key = f"{self.name} {sig!r}"
        return self.cache_path / f"{self.name}.{hashlib.sha256(key.encode()).hexdigest()[:16]}.entry", key

    @property
    def cache_path(self) -> Path:
        return folder()

    def enable(self) -> None:
        """Nothing to do: all entries are stored."""

    disable = flush = enable


@cache
def _writable() -> bool:
    """Whether the folder can be written, so that waiting for another process is useful."""
    try:
        folder().mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder(), os.W_OK | os.X_OK)


class _Watch(event.Listener):
    """Measures the time of compiling, or of waiting for a process that compiles, and reports when that begins.

    Python's garbage collector is paused meanwhile: it takes a sixth of the time of compiling and frees nothing. Numba's
    own loops and powers are forgotten before and after each function: it compiles them once, with the arithmetic
    (fastmath) of the first function that needs them, so that results would depend on what else is compiled.
    """

    def __init__(self) -> None:
        self.depth, self.begun, self.seconds, self.collected = 0, 0.0, 0.0, True
        self.tell: Callable[[], None] = lambda: None

    def on_start(self, event: Any = None) -> None:
        cpu_target.target_context.cached_internal_func.clear()
        if not self.depth:
            self.begun, self.collected = time.perf_counter(), gc.isenabled()
            gc.disable()
            self.tell()
        self.depth += 1

    def on_end(self, event: Any = None) -> None:
        cpu_target.target_context.cached_internal_func.clear()
        self.depth -= 1
        if not self.depth:
            self.seconds += time.perf_counter() - self.begun
            if self.collected:
                gc.enable()


_watch = _Watch()
event.register("numba:compile", _watch)  # type: ignore[no-untyped-call]


def seconds() -> float:
    """Time that this process has spent on compiling, or on waiting for a process that compiles [s]."""
    return _watch.seconds


@contextmanager
def compiling() -> Iterator[None]:
    """A block that compiles by another compiler than Numba; its time counts in `seconds`."""
    _watch.on_start()
    try:
        yield
    finally:
        _watch.on_end()


@contextmanager
def telling(tell: Callable[[], None]) -> Iterator[None]:
    """Call `tell` once if something is compiled in this block."""

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
    """A block that compiles `what`: one process runs it, others wait until its code is stored."""
    done = folder() / what
    with ExitStack() as claims:
        while _writable() and not done.exists():
            try:
                claims.enter_context(atomic_file.claim(done))
                break
            except atomic_file.Busy:
                _watch.on_start()
                time.sleep(COMPILATION_POLL_S)
                _watch.on_end()
        yield
        if _writable():
            done.touch()
