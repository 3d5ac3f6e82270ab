"""The one way in which files that others made are opened: regular files of a bounded size, without ever waiting."""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path


def descriptor(path: Path, most: int) -> int:
    """The number of an opened file.

    Args:
        most: largest size [bytes].

    Raises:
        OSError: there is none, it is a folder, pipe, socket or device, or larger; `strerror` says so in words.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe that nobody writes to would block
    try:
        found = os.fstat(handle)
        if stat.S_ISDIR(found.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "a pipe, socket or device, not a regular file", str(path))
        if found.st_size > most:
            size = f"{found.st_size / 1e6:.0f} MB, at most {most / 1e6:.0f} can be read"
            raise OSError(errno.EFBIG, size, str(path))
    except BaseException:
        os.close(handle)
        raise
    return handle


def opened(path: Path, most: int) -> BufferedReader:
    """A file to read from; raises as `descriptor` does."""
    return os.fdopen(descriptor(path, most), "rb")


def read_bytes(path: Path, most: int) -> bytes:
    """All of a file. Raises OSError as `descriptor` does."""
    with opened(path, most) as file:
        return file.read(most)
