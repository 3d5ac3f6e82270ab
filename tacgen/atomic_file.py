"""A file that gets its name only when it is finished; what a killed process leaves is deleted.

Locks are flock's, which the system drops when a process ends, even by kill -9. The package filelock has them too, but
serves claims alone: part files are locked through the handle they are written by, and looking for dead writers must
create no file. Where a file system has no locks it leaves marker files, which a killed process would leave behind.
"""

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tacgen.errors import UserError

PART_MARK = ".part-"  # in the name of an unfinished file: x.h5.part-<pid>
CLAIM_SUFFIX = ".claim"  # of the file that is locked while x.h5 is made: .x.h5.claim


class Busy(UserError):
    """Another process is at work on this very file."""


def is_part(path: Path) -> bool:
    """Whether this is the name of a part file, a living writer's or a dead one's."""
    name, mark, number = path.name.rpartition(PART_MARK)
    return bool(name and mark and number.isdigit())


def is_claim(path: Path) -> bool:
    """Whether this is the name of a file that only says that a process is at work."""
    return path.name.startswith(".") and path.name.endswith(CLAIM_SUFFIX)


def claim_path(target: Path) -> Path:
    """The file that is locked by whoever works on `target`."""
    return target.with_name(f".{target.name}{CLAIM_SUFFIX}")


def sweep(folder: Path) -> list[Path]:
    """Delete part files whose writer is dead and claims of the dead, and return them.

    A writer holds a lock on its part file and the system drops it when the process ends, however it ends. So this is
    right where process ids are not: in containers, and on a folder that several machines write into.
    """
    deleted = []
    for path in [path for path in folder.iterdir() if is_part(path) or is_claim(path)]:
        with suppress(OSError):  # held, deleted by another, or a file system without locks: leave it
            handle = os.open(path, os.O_RDWR)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.unlink(path)
                deleted.append(path)
            finally:
                os.close(handle)
    return deleted


def is_claimed(target: Path) -> bool:
    """Whether a living process is at work on `target`."""
    try:
        handle = os.open(claim_path(target), os.O_RDWR)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        pass
    finally:
        os.close(handle)
    return False


@contextmanager
def claim(target: Path) -> Iterator[None]:
    """Be the only process at work on `target`, or raise Busy at once; a file system without locks cannot tell."""
    path = claim_path(target)
    handle = _locked(path, tries=3)
    if handle is None:
        raise Busy(f"{target}: another process is at work on it")
    try:
        yield
    finally:
        with suppress(FileNotFoundError):
            os.unlink(path)
        os.close(handle)


def _locked(path: Path, tries: int) -> int | None:
    """A handle of the file, locked; None while another holds it.

    A sweeper may hold or delete the file between opening and locking, so look again until both hold.
    """
    for _ in range(tries):
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(handle), os.stat(path)):
                return handle
        except (BlockingIOError, FileNotFoundError):
            pass
        except OSError:  # a file system without locks
            return handle
        os.close(handle)
        time.sleep(0.02)
    return None


class Sink:
    """The file object that HDF5 writes a part file through.

    HDF5's own driver reports a full disk as a RuntimeError on close, and again when the interpreter exits. Here the
    first OSError is kept in `error` and every later write is swallowed, so that HDF5 can close in peace; the caller
    works under `guard`, which raises it.
    """

    def __init__(self, target: Path) -> None:
        self.target = target
        self.path = target.with_name(f"{target.name}{PART_MARK}{os.getpid()}")
        self.error: OSError | None = None
        self.dead = False  # set to swallow all further writes
        self._at = 0
        handle = _locked(self.path, tries=50)
        if handle is None:
            raise Busy(f"{self.path}: another writer holds it")
        self._handle = handle
        os.ftruncate(handle, 0)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        if whence == os.SEEK_SET:
            self._at = offset
        else:
            self._at = os.lseek(self._handle, offset, whence)
        return self._at

    def tell(self) -> int:
        return self._at

    def read(self, size: int) -> bytes:
        """h5py knows a file object by this name and then reads through `readinto`."""
        buffer = bytearray(size)
        return bytes(buffer[: self.readinto(memoryview(buffer))])

    def readinto(self, buffer: memoryview) -> int:
        count = 0
        while count < len(buffer) and (part := os.preadv(self._handle, [buffer[count:]], self._at)):
            count += part
            self._at += part
        return count

    def write(self, data: memoryview) -> int:
        count = 0
        while count < len(data) and not self.dead:
            try:
                count += os.pwrite(self._handle, data[count:], self._at + count)
            except OSError as error:
                self._fail(error)
        self._at += len(data)
        return len(data)

    def truncate(self, size: int) -> int:
        if not self.dead:
            try:
                os.ftruncate(self._handle, size)
            except OSError as error:
                self._fail(error)
        return size

    @contextmanager
    def guard(self) -> Iterator[None]:
        """Turn whatever HDF5 makes of a failed write back into the OSError that caused it."""
        try:
            yield
        except Exception:
            if self.error is None:
                raise
        if self.error is not None:
            raise self.error

    def _fail(self, error: OSError) -> None:
        self.error, self.dead = OSError(error.errno, error.strerror, str(self.target)), True

    def flush(self) -> None:
        """Nothing is buffered here; `publish` syncs."""

    def publish(self) -> None:
        """Bring the file to the disk and give it its name, atomically."""
        os.fsync(self._handle)
        try:
            os.replace(self.path, self.target)
        except OSError as error:  # it names the part file, which nobody knows
            raise OSError(error.errno, error.strerror, str(self.target)) from None
        folder = os.open(self.target.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
        os.close(self._handle)

    def discard(self) -> None:
        """Delete the part file."""
        with suppress(FileNotFoundError):
            os.unlink(self.path)
        os.close(self._handle)


@contextmanager
def published(target: Path) -> Iterator[Sink]:
    """A sink for a file that has its name when the block ends well, and is deleted otherwise.

    Raises:
        OSError: with its errno; Busy: another process writes this very file.
    """
    sink = Sink(target)
    try:
        with sink.guard():
            yield sink
        sink.publish()
    except BaseException:
        sink.discard()
        raise


def write(target: Path, data: bytes) -> None:
    """Write a whole file at once; raises as `published` does."""
    with published(target) as sink:
        sink.write(memoryview(data))
