"""Folders that are written under another name and renamed when they are complete, with a list of their files.

However a process ends, the name stands for the old folder or the new one, or for none while the old one waits beside
it: the next one that writes there puts it back and removes what is left over.
"""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tacgen import atomic_file
from tacgen.bundle.stored_json import Stored, read
from tacgen.errors import UserError

LIST = ".tacgen-export.json"


class Listed(Stored):
    """What the list says: the kind of folder, and each file's path in it and size [bytes]."""

    kind: str
    files: dict[str, int]


@contextmanager
def written(folder: Path, kind: str = "") -> Iterator[Path]:
    """Where to write; it is renamed to `folder` when the block ends well, and removed otherwise.

    Args:
        kind: a folder of this kind may be replaced, if nothing was added or changed since. Without one a folder
            gets no list and must be empty, or not there.

    Raises:
        UserError: something else is in the way, or another process writes this very folder.
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
                content = json.dumps({"kind": kind, "files": sizes}, indent=1) + "\n"
                atomic_file.write(new / LIST, content.encode())
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
    """UserError unless `folder` is missing, empty, or all of it was written as this kind."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise UserError(f"{folder}: is not a folder")
    there = _files(folder)
    if not there:
        return
    if not kind or LIST not in there:
        raise UserError(f"{folder}: is not empty, it holds {min(there)}: choose another folder")
    listed = read(Listed, folder / LIST)
    if listed.kind != kind:
        raise UserError(f"{folder}: holds an export for {listed.kind}: choose another folder")
    strangers = [name for name, size in there.items() if name != LIST and listed.files.get(name, -1) != size]
    if strangers:
        raise UserError(f"{folder}: {min(strangers)} is not of the export: move it, or choose another folder")


def _files(folder: Path) -> dict[str, int | None]:
    """Path below the folder -> size [bytes] of a regular file; None of anything else, an empty folder too."""
    found: dict[str, int | None] = {}
    for path in folder.rglob("*"):
        plain = path.is_file() and not path.is_symlink()
        if plain or path.is_symlink() or not path.is_dir() or not any(path.iterdir()):
            found[path.relative_to(folder).as_posix()] = path.stat().st_size if plain else None
    return found
