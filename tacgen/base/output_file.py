"""The files that commands write for their user: never in the place of an input, pipe or somebody's file, and complete.

Two kinds are known as tacgen's own, and replaced by their like as long as nobody has changed them: a page ends with a
comment that holds the digest of its text; the digests of other results stand in RESULTS_RECORD beside them.
"""

import hashlib
import json
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

from tacgen.base import atomic_file, regular_file
from tacgen.base.errors import UserError

PAGE_SIGNATURE = re.compile(rb"\n<!-- written by tacgen; sha256 of the text above: ([0-9a-f]{64}) -->\n\Z")
MAX_PAGE_BYTES = 2**28  # [bytes]
Kind = Literal["", "page", "result"]
DATA_SET_SUFFIXES = (".h5", ".json", ".jsonl", ".md")  # suffixes of the files of a data set
RESULTS_RECORD = ".tacgen-written.json"  # in the folder of results: their names, and the SHA-256 of each


@contextmanager
def written(
    target: Path, inputs: Iterable[Path] = (), *, overwrite: bool = False, within: Path | None = None, kind: Kind = ""
) -> Iterator[Path]:
    """A path beside `target`, with the same suffix, to write to; it gets the target's name if the block succeeds.

    Args:
        inputs: files, and folders with all that is in them, that must not be replaced. What the command has read
            (`regular_file.noting`) is not replaced in any case.
        overwrite: replace an existing file.
        within: the folder that the file must be in, links followed.
        kind: a page or result replaces one that tacgen wrote, unchanged since, in any case. RESULTS_RECORD has the
        results.

    Raises:
        UserError: the target is an input, exists already, is not a regular file, or lies elsewhere; another process
            writes it.
        OSError: it cannot be written.
    """
    asked: dict[str, Any] = {"inputs": list(inputs), "overwrite": overwrite, "kind": kind}
    refuse(target, **asked, within=within)
    target = Path(os.path.realpath(target))  # a link stays, and what it points to is replaced
    target.parent.mkdir(parents=True, exist_ok=True)
    new = target.with_name(f".{target.stem}.tacgen-new{target.suffix}")
    with atomic_file.claim(target):
        try:
            new.unlink(missing_ok=True)  # it might be a link
            yield new
            refuse(target, **asked)  # it may have been read or made meanwhile
            with new.open("rb") as file:
                os.fsync(file.fileno())
                digest = hashlib.file_digest(file, "sha256").hexdigest() if kind == "result" else ""
            os.replace(new, target)
            if digest:
                known = _recorded(target.parent) | {target.name: digest}
                atomic_file.write(target.parent / RESULTS_RECORD, (json.dumps(known, indent=1) + "\n").encode())
        except OSError as error:
            if error.filename != str(new):
                raise
            raise OSError(error.errno, error.strerror, str(target)) from None
        finally:
            new.unlink(missing_ok=True)


def put(target: Path, content: bytes, inputs: Iterable[Path] = (), **how: Any) -> None:
    """Write a whole file, unless it is there with this content; options and exceptions as of `written`."""
    if how.get("kind") == "result" or not holds(target, content):
        with written(target, inputs, **how) as new:
            add(new, content)


def add(path: Path, content: bytes | str) -> Path:
    """Write a file that is not there yet, and the folders above it: at a path of `written`, or in a new folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("xb") as file:
        file.write(content if isinstance(content, bytes) else content.encode())
    return path


def holds(target: Path, content: bytes) -> bool:
    """Whether a file is there with this content."""
    try:
        return regular_file.read_bytes(target, len(content), noted=False) == content
    except OSError:
        return False


def refuse(
    target: Path, inputs: Iterable[Path] = (), *, overwrite: bool = False, within: Path | None = None, kind: Kind = ""
) -> None:
    """UserError if `target` must not be written; arguments as of `written`. To be called before long work, too."""
    if within is not None and not Path(os.path.realpath(target)).is_relative_to(os.path.realpath(within)):
        raise UserError(f"{target}: leads out of {within}, and nothing is written outside of it")
    try:
        status = os.stat(target)
    except FileNotFoundError:
        return
    inputs = list(inputs)
    if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
        raise UserError(f"{target}: is a pipe, socket or device: name a file")
    if stat.S_ISDIR(status.st_mode):
        raise UserError(f"{target}: is a folder: name a file")
    for path in inputs:
        if path.is_dir() and target.resolve().is_relative_to(path.resolve()) and target.suffix in DATA_SET_SUFFIXES:
            raise UserError(f"{target}: belongs to the data set that is read: choose another name")
    same = (path for path in inputs if path.exists() and os.path.samestat(os.stat(path), status))
    if regular_file.was_read(status) or any(same):
        raise UserError(f"{target}: is an input of this command: choose another name")
    if not (overwrite or _is_own(target, kind)):
        raise UserError(f"{target}: is there already; --overwrite replaces it")


def _is_own(path: Path, kind: Kind) -> bool:
    """Whether tacgen wrote the file, which is of this kind, and nobody has changed it."""
    if kind == "page":
        return path.suffix == ".html" and is_unchanged_page(path)  # the card of a data set is signed, too
    if kind == "result" and (known := _recorded(path.parent).get(path.name)):
        with suppress(OSError), regular_file.opened(path, MAX_PAGE_BYTES, noted=False) as file:
            return hashlib.file_digest(file, "sha256").hexdigest() == known
    return False


def _recorded(folder: Path) -> dict[str, str]:
    """The contents of RESULTS_RECORD; empty where there is none, or where it is damaged."""
    with suppress(OSError, ValueError, RecursionError):
        found = json.loads(regular_file.read_bytes(folder / RESULTS_RECORD, MAX_PAGE_BYTES, noted=False))
        return found if isinstance(found, dict) else {}
    return {}


def signed(text: str) -> bytes:
    """A page with the comment that tells it from one that somebody wrote or changed."""
    content = text.rstrip("\n").encode()
    digest = hashlib.sha256(content).hexdigest()
    return content + f"\n<!-- written by tacgen; sha256 of the text above: {digest} -->\n".encode()


def is_unchanged_page(path: Path) -> bool:
    """Whether `path` is a page that tacgen wrote and nobody changed."""
    try:
        content = regular_file.read_bytes(path, MAX_PAGE_BYTES, noted=False)
    except OSError:
        return False
    match = PAGE_SIGNATURE.search(content)
    return match is not None and hashlib.sha256(content[: match.start()]).hexdigest().encode() == match[1]


@contextmanager
def gone_if_refused(folder: Path) -> Iterator[None]:
    """Folders that are made here go again where an error comes before anything is in them."""
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        yield
    except UserError:
        with suppress(OSError):  # something is in it
            for each in made:
                each.rmdir()
        raise
