"""A cache of arrays on disk, by a hash of all inputs; each entry has a digest of its key and content."""

import hashlib
import io
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import atomic_file, regular_file

Array = np.ndarray
MAX_ENTRY_BYTES = 2**31  # largest entry [bytes]
SEAL_BYTES = hashlib.sha256().digest_size
_listeners: list[Callable[[str], None]] = []  # called with the kind of an entry before it is made


def cache_folder() -> Path:
    """The folder of cached results; TACGEN_CACHE_DIR overrides it."""
    from platformdirs import user_cache_path

    return Path(os.environ["TACGEN_CACHE_DIR"]) if os.environ.get("TACGEN_CACHE_DIR") else user_cache_path("tacgen")


def digest(parts: Iterable[Any]) -> str:
    """SHA-256 of arrays (with types and shapes) and of the repr of other objects."""
    content = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            content.update(f"{part.dtype.str} {part.shape}".encode())
            content.update(np.ascontiguousarray(part).tobytes())
        else:
            content.update(f"{part!r};".encode())
    return content.hexdigest()


def kept(kind: str, key: str, make: Callable[[], tuple[Array, ...]]) -> tuple[Array, ...]:
    """The arrays stored as `kind` under `key`; if there are none, those of `make`, which are then stored.

    If two processes make them at once, both use those that were stored first: `make` need not be reproducible.
    """
    return _unpacked(kept_bytes(kind, key, lambda: _packed(make())))


def kept_one(kind: str, key: str, make: Callable[[], Array]) -> Array:
    """The array stored as `kind` under `key`; if there is none, that of `make`, which is then stored."""
    return kept(kind, key, lambda: (make(),))[0]


def kept_bytes(kind: str, key: str, make: Callable[[], bytes]) -> bytes:
    """The bytes stored as `kind` under `key`; a damaged entry, or one of another key, is made again by `make`."""
    file = cache_folder() / kind / f"{key}.entry"
    content = read(file, key)
    if content is not None:
        return content
    tell(kind)
    return store(file, key, make())


@contextmanager
def telling(listener: Callable[[str], None]) -> Iterator[None]:
    """Call the listener with the kind of each entry that this block has to make, before it is made."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def tell(kind: str) -> None:
    """Say that an entry of this kind is made."""
    for listener in _listeners:
        listener(kind)


def read(file: Path, key: str) -> bytes | None:
    """The content of an entry; None if there is none, or if it is damaged or of another key."""
    try:
        entry = regular_file.read_bytes(file, MAX_ENTRY_BYTES)
    except OSError:
        return None
    seal, content = entry[:SEAL_BYTES], entry[SEAL_BYTES:]
    return content if seal == _seal(key, content) else None


def store(file: Path, key: str, made: bytes) -> bytes:
    """Store an entry and return its content: that of the first process, if two store it at once."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic_file.sweep(file.parent)
        if (content := read(file, key)) is not None:
            return content
        atomic_file.write(file, _seal(key, made) + made)
    except (OSError, atomic_file.Busy):
        pass  # without a writable cache the next run only takes longer
    return made


def _seal(key: str, content: bytes) -> bytes:
    seal = hashlib.sha256(key.encode())
    seal.update(content)
    return seal.digest()


def _packed(arrays: tuple[Array, ...]) -> bytes:
    """Arrays in NumPy's file format, concatenated."""
    out = io.BytesIO()
    for array in arrays:
        np.save(out, array, allow_pickle=False)
    return out.getvalue()


def _unpacked(content: bytes) -> tuple[Array, ...]:
    file, arrays = io.BytesIO(content), []
    while file.tell() < len(content):
        arrays.append(np.load(file, allow_pickle=False))
    return tuple(arrays)
