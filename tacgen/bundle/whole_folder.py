"""Folders that are written under a temporary name and renamed when complete, with a list of their files.

If a process is killed, the name refers to the old folder or the new one, or to none while the old one is still there
under a temporary name: the next process that writes there restores it and removes remains.
"""

import hashlib
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import Field

from tacgen.base import atomic_file, regular_file
from tacgen.base.errors import UserError
from tacgen.bundle.stored_json import Stored, read

EXPORT_LIST_FILE = ".tacgen-export.json"
MAX_EDITABLE_BYTES = 2**20  # [bytes] size of files up to which somebody may have edited them


class Listed(Stored):
    """Contents of the list: the kind of folder, the path and size [bytes] of each file, and SHA-256 of small ones."""

    kind: str
    files: dict[str, int]
    digests: dict[str, str] = Field(default_factory=dict)


@contextmanager
def written(folder: Path, kind: str = "") -> Iterator[Path]:
    """A temporary folder to write into. It is renamed to `folder` if the block succeeds, and removed otherwise.

    Args:
        kind: a folder of this kind is replaced if no file was added or changed since. Without a kind no list is
            written, and an existing folder must be empty.

    Raises:
        UserError: something else is in the way, or another process is writing the same folder.
    """
    folder = folder.resolve()
    if not folder.name:
        raise UserError(f"{folder}: is not empty: choose another folder")
    new, old = (folder.with_name(f".{folder.name}.tacgen-{age}") for age in ("new", "old"))
    folder.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file.claim(folder):
        _put_back(old, folder)
        _removed(new, old)
        _refuse(folder, kind)
        new.mkdir()
        try:
            yield new
            if kind:
                sizes = {name: size for name, size in _files(new).items() if size is not None}
                digests = {name: _digest(new / name) for name, size in sizes.items() if size <= MAX_EDITABLE_BYTES}
                content = json.dumps({"kind": kind, "files": sizes, "digests": digests}, indent=1) + "\n"
                atomic_file.write(new / EXPORT_LIST_FILE, content.encode())
            if folder.exists():
                folder.rename(old)
            new.rename(folder)
        finally:
            _put_back(old, folder)
            _removed(new, old)


def _put_back(old: Path, folder: Path) -> None:
    if old.exists() and not folder.exists():
        old.rename(folder)


def _removed(*folders: Path) -> None:
    for folder in folders:
        if folder.exists():
            shutil.rmtree(folder)


def _refuse(folder: Path, kind: str) -> None:
    """UserError unless `folder` is missing, empty, or was written entirely as this kind."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise UserError(f"{folder}: is not a folder")
    there = _files(folder)
    if not there:
        return
    if not kind or EXPORT_LIST_FILE not in there:
        raise UserError(f"{folder}: is not empty, it holds {min(there)}: choose another folder")
    listed = read(Listed, folder / EXPORT_LIST_FILE)
    if listed.kind != kind:
        raise UserError(f"{folder}: holds an export for {listed.kind}: choose another folder")
    known = {**listed.files, EXPORT_LIST_FILE: there[EXPORT_LIST_FILE]}
    strangers = [name for name, size in there.items() if known.get(name, -1) != size]
    edited = (name for name, digest in listed.digests.items() if name in there and _digest(folder / name) != digest)
    if strangers := strangers or [*edited]:
        raise UserError(f"{folder}: {min(strangers)} is not of the export: move it, or choose another folder")


def _digest(path: Path) -> str:
    with regular_file.opened(path, MAX_EDITABLE_BYTES, noted=False) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _files(folder: Path) -> dict[str, int | None]:
    """Path below the folder -> size [bytes] of a regular file; None for anything else, including empty folders."""
    sizes: dict[str, int | None] = {}
    for path in folder.rglob("*"):
        plain = path.is_file() and not path.is_symlink()
        if plain or path.is_symlink() or not path.is_dir() or not any(path.iterdir()):
            sizes[path.relative_to(folder).as_posix()] = path.stat().st_size if plain else None
    return sizes
