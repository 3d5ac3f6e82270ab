"""Machine code that is kept for the next process: one process compiles it, others wait, and the time is counted."""

import hashlib
import os
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from tacgen.base import array_cache, atomic_file

COMPILED_ENTRY = "machine code"  # kind of an entry, as array_cache.telling tells it
COMPILATION_POLL_S = 0.1  # interval at which a waiting process checks whether another has finished [s]
_counted = threading.local()


def folder() -> Path:
    """The folder of machine code; TACGEN_CODE_DIR overrides it."""
    known = os.environ.get("TACGEN_CODE_DIR")
    return Path(known) if known else array_cache.cache_folder() / "code"


def seconds() -> float:
    """Time that this thread has spent on compiling, or on waiting for a process that compiles [s]."""
    return float(getattr(_counted, "seconds", 0.0))


def kept(name: str, key: str, make: Callable[[], bytes]) -> bytes:
    """The code stored under a name and a key; if there is none, or if it is damaged, that of `make`, which is then
    stored. Without a folder that can be written each process makes it."""
    file = folder() / f"{name}-{hashlib.sha256(key.encode()).hexdigest()[:16]}.entry"
    if (content := array_cache.read(file, key)) is not None:
        return content
    begun = time.perf_counter()
    array_cache.tell(COMPILED_ENTRY)
    with ExitStack() as claims:
        while _writable(file.parent):
            try:
                claims.enter_context(atomic_file.claim(file.with_suffix(".code")))
                break
            except atomic_file.Busy:
                time.sleep(COMPILATION_POLL_S)
        if (content := array_cache.read(file, key)) is None:
            content = array_cache.store(file, key, make())
    _counted.seconds = seconds() + time.perf_counter() - begun
    return content


def _writable(place: Path) -> bool:
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(place, os.W_OK | os.X_OK)
