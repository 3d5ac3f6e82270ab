"""Opening of untrusted files: only regular files of a bounded size, without blocking."""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path


def descriptor(path: Path, most: int) -> int:
    """The descriptor of an opened file.

    Args:
        most: largest size [bytes].

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
