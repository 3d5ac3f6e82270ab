"""The file that a command writes for its user: never in the place of an input, a pipe or somebody's file, and complete.

A page that tacgen wrote ends with a comment that holds the digest of its text. The next version replaces it as long as
nobody has changed it.
"""

import hashlib
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tacgen import atomic_file, regular_file
from tacgen.errors import UserError

SIGNATURE = re.compile(rb"\n<!-- written by tacgen; sha256 of the text above: ([0-9a-f]{64}) -->\n\Z")
LARGEST_PAGE = 2**28  # [bytes]


@contextmanager
def written(target: Path, inputs: Iterable[Path] = (), *, overwrite: bool = False) -> Iterator[Path]:
    """A path beside `target`, with the same suffix, to write to; it gets the target's name if the block succeeds.

    Args:
        inputs: files, and folders with all that is in them, that must not be replaced.
        overwrite: replace an existing file. A page that tacgen wrote, unchanged since, is replaced in any case.

    Raises:
        UserError: the target is an input, exists already, or is not a regular file; another process writes it.
        OSError: it cannot be written.
    """
    target = Path(os.path.realpath(target))  # a link stays, and what it points to is replaced
    refuse(target, inputs, overwrite=overwrite)
    target.parent.mkdir(parents=True, exist_ok=True)
    new = target.with_name(f".{target.stem}.tacgen-new{target.suffix}")
    with atomic_file.claim(target):
        try:
            yield new
            with new.open("rb") as file:
                os.fsync(file.fileno())
            os.replace(new, target)
        except OSError as error:
            if error.filename != str(new):
                raise
            raise OSError(error.errno, error.strerror, str(target)) from None
        finally:
            new.unlink(missing_ok=True)


def refuse(target: Path, inputs: Iterable[Path] = (), *, overwrite: bool = False) -> None:
    """UserError if `target` must not be written; arguments as of `written`. To be called before long work, too."""
    try:
        status = os.stat(target)
    except FileNotFoundError:
        return
    if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
        raise UserError(f"{target}: is a pipe, socket or device: name a file")
    if stat.S_ISDIR(status.st_mode):
        raise UserError(f"{target}: is a folder: name a file")
    if is_unchanged_page(target):
        return
    for path in inputs:
        if path.is_dir() and target.resolve().is_relative_to(path.resolve()) and target.suffix in (".h5", ".json"):
            raise UserError(f"{target}: belongs to the data set that is read: choose another name")
        if path.exists() and os.path.samestat(os.stat(path), status):
            raise UserError(f"{target}: is an input of this command: choose another name")
    if not overwrite:
        raise UserError(f"{target}: is there already; --overwrite replaces it")


def signed(text: str) -> bytes:
    """A page with the comment that tells it from one that somebody wrote or changed."""
    content = text.rstrip("\n").encode()
    digest = hashlib.sha256(content).hexdigest()
    return content + f"\n<!-- written by tacgen; sha256 of the text above: {digest} -->\n".encode()


def is_unchanged_page(path: Path) -> bool:
    """Whether `path` is a page that tacgen wrote and nobody changed."""
    try:
        content = regular_file.read_bytes(path, LARGEST_PAGE)
    except OSError:
        return False
    match = SIGNATURE.search(content)
    return match is not None and hashlib.sha256(content[: match.start()]).hexdigest().encode() == match[1]
