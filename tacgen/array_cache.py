"""Arrays kept under the cache folder by a hash of all they depend on."""

import hashlib
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray


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
    return _kept(cache_folder() / kind / f"{key}.npz", make)


def kept_one(kind: str, key: str, make: Callable[[], Array]) -> Array:
    """The same of a single array."""
    return _kept(cache_folder() / kind / f"{key}.npy", lambda: (make(),))[0]


def _kept(file: Path, make: Callable[[], tuple[Array, ...]]) -> tuple[Array, ...]:
    found = _read(file)
    if found is not None:
        return found
    made = make()
    part = file.with_suffix(f".part-{os.getpid()}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as out:
            if file.suffix == ".npy":
                np.save(out, made[0])
            else:
                np.savez(out, *made)
        if _read(file) is None:
            part.replace(file)
    except OSError:
        return made  # a cache that cannot be written only costs the next run some seconds
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    return _read(file) or made


def _read(file: Path) -> tuple[Array, ...] | None:
    try:
        with file.open("rb") as opened:
            found = np.load(opened, allow_pickle=False)
            return (found,) if isinstance(found, np.ndarray) else tuple(found[name] for name in found.files)
    except Exception:  # not there yet, or damaged: zipfile, zlib and NumPy each say so in their own way
        return None
