"""Opening of untrusted files: only regular files of a bounded size, without blocking."""

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

from tacgen.base.errors import UserError, why

_read: set[tuple[int, int]] | None = None  # device and inode of the files that the present command has opened


@contextmanager
def noting() -> Iterator[None]:
    """Note in this block which files are read, so that no output replaces one of them; see `was_read`."""
    global _read
    before, _read = _read, set()
    try:
        yield
    finally:
        _read = before


def was_read(status: os.stat_result) -> bool:
    """Whether this file has been read in the present block of `noting`."""
    return _read is not None and (status.st_dev, status.st_ino) in _read


def descriptor(path: Path, most: int, *, noted: bool = True) -> int:
    """The descriptor of an opened file.

    Args:
        most: largest size [bytes].
        noted: it is an input: no output of this command may replace it.

    Raises:
        OSError: it does not exist, is a folder, pipe, socket or device, or is larger; see its `strerror`.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe without a writer would block
    try:
        status = os.fstat(handle)
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "a pipe, socket or device, not a regular file", str(path))
        if status.st_size > most:
            size = f"{status.st_size / 1e6:.0f} MB, at most {most / 1e6:.0f} can be read"
            raise OSError(errno.EFBIG, size, str(path))
        if noted and _read is not None:
            _read.add((status.st_dev, status.st_ino))
    except BaseException:
        os.close(handle)
        raise
    return handle


def opened(path: Path, most: int, *, noted: bool = True) -> BufferedReader:
    """A file to read from; raises as `descriptor` does."""
    return os.fdopen(descriptor(path, most, noted=noted), "rb")


def read_bytes(path: Path, most: int, *, noted: bool = True) -> bytes:
    """All of a file. Raises OSError as `descriptor` does."""
    with opened(path, most, noted=noted) as file:
        return file.read(min(most, os.fstat(file.fileno()).st_size))  # Python makes room for as much as it is asked for


def content(path: Path, most: int) -> bytes:
    """All of a file that a person names. Raises UserError: it cannot be read."""
    try:
        return read_bytes(path, most)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise UserError(f"{path}: cannot be read: {why(error)}") from None
