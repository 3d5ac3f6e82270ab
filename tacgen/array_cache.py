"""Arrays kept under the cache folder by a hash of all they depend on; an entry carries a digest of key and content."""

import hashlib
import io
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from tacgen import atomic_file, regular_file

Array = np.ndarray
LARGEST = 2**31  # bytes of an entry
SEAL = hashlib.sha256().digest_size


def cache_folder() -> Path:
    """Where tacgen keeps what it can compute again; TACGEN_CACHE_DIR overrides."""
    from platformdirs import user_cache_path

    return Path(os.environ["TACGEN_CACHE_DIR"]) if os.environ.get("TACGEN_CACHE_DIR") else user_cache_path("tacgen")


def digest(parts: Iterable[Any]) -> str:
    """SHA-256 of arrays (with their types and shapes) and of whatever else has a repr."""
    content = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            content.update(f"{part.dtype.str} {part.shape}".encode())
            content.update(np.ascontiguousarray(part).tobytes())
        else:
            content.update(f"{part!r};".encode())
    return content.hexdigest()


def kept(kind: str, key: str, make: Callable[[], tuple[Array, ...]]) -> tuple[Array, ...]:
    """The arrays stored as `kind` under `key`, or what `make` gives, stored for the next time.

    Of two processes that make them at once the first keeps its own, and both go on with those: what is made may
    differ from run to run.
    """
    return _unpacked(kept_bytes(kind, key, lambda: _packed(make())))


def kept_one(kind: str, key: str, make: Callable[[], Array]) -> Array:
    """The same of a single array."""
    return kept(kind, key, lambda: (make(),))[0]


def kept_bytes(kind: str, key: str, make: Callable[[], bytes]) -> bytes:
    """The same of bytes: those that were stored under this very key, unchanged, or they are made again."""
    file = cache_folder() / kind / f"{key}.entry"
    found = read(file, key)
    return store(file, key, make()) if found is None else found


def read(file: Path, key: str) -> bytes | None:
    """What an entry holds; None where there is none, or it is not what was stored under its key."""
    try:
        entry = regular_file.read_bytes(file, LARGEST)
    except OSError:
        return None
    seal, content = entry[:SEAL], entry[SEAL:]
    return content if seal == _seal(key, content) else None


def store(file: Path, key: str, made: bytes) -> bytes:
    """Make an entry, and give what it holds: of two processes at once the first keeps its own."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic_file.sweep(file.parent)
        if (found := read(file, key)) is not None:
            return found
        atomic_file.write(file, _seal(key, made) + made)
    except (OSError, atomic_file.Busy):
        pass  # a cache that cannot be written only costs the next run some seconds
    return made


def _seal(key: str, content: bytes) -> bytes:
    seal = hashlib.sha256(key.encode())
    seal.update(content)
    return seal.digest()


def _packed(arrays: tuple[Array, ...]) -> bytes:
    """Arrays in NumPy's format, one after the other."""
    out = io.BytesIO()
    for array in arrays:
        np.save(out, array, allow_pickle=False)
    return out.getvalue()


def _unpacked(content: bytes) -> tuple[Array, ...]:
    file, found = io.BytesIO(content), []
    while file.tell() < len(content):
        found.append(np.load(file, allow_pickle=False))
    return tuple(found)
