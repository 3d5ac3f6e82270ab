"""Files that get their name only when they are complete; remains of killed processes are deleted.

Locks are those of flock, which the system releases when a process ends, even by kill -9. The package filelock would
serve for claims only: part files are locked through the handle that writes them, and the search for dead writers must
create no file. On a file system without locks it creates marker files, which a killed process would leave behind.
"""

import fcntl
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tacgen.base.errors import UserError

# These names hold "tacgen", since files that match them are deleted: backup.tar.part-01 is a user's
PART_MARK = ".tacgen-part-"  # in the name of an incomplete file: x.h5.tacgen-part-<pid>
CLAIM_SUFFIX = ".tacgen-claim"  # suffix of the file that is locked while x.h5 is made: .x.h5.tacgen-claim


class Busy(UserError):
    """Another process is making this file."""


def is_part(path: Path) -> bool:
    """Whether this is the name of a part file."""
    name, mark, number = path.name.rpartition(PART_MARK)
    return bool(name and mark and number.isdigit())


def is_claim(path: Path) -> bool:
    """Whether this is the name of a claim file."""
    return path.name.startswith(".") and path.name.endswith(CLAIM_SUFFIX)


def claim_path(target: Path) -> Path:
    """The file that is locked by the process that makes `target`."""
    return target.with_name(f".{target.name}{CLAIM_SUFFIX}")


def sweep(folder: Path) -> list[Path]:
    """Delete part files and claims of processes that have ended, and return them.

    A writer holds a lock on its part file, which the system releases when the process ends. Unlike process ids this
    also works in containers, and in a folder that several machines write into.
    """
    deleted = []
    for path in [path for path in folder.iterdir() if is_part(path) or is_claim(path)]:
        with suppress(OSError):  # locked, deleted by another process, or no locks on this file system: leave it
            handle = os.open(path, os.O_RDWR)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.unlink(path)
                deleted.append(path)
            finally:
                os.close(handle)
    return deleted


def is_claimed(target: Path) -> bool:
    """Whether a running process is making `target`."""
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
    """Claim `target` for this process, or raise Busy at once; without effect on a file system without locks."""
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


def _alone(handle: int) -> None:
    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _locked(
    path: Path, tries: int, lock: Callable[[int], None] = _alone, wanted: Callable[[int], bool] = lambda _: True
) -> int | None:
    """A handle of the file, locked by `lock`; None if other processes hold the lock, or the file is not as `wanted`.

    `sweep` in another process may lock or delete the file between opening and locking, so it is tried several times.
    """
    for _ in range(tries):
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            lock(handle)
            if os.path.samestat(os.fstat(handle), os.stat(path)):
                if wanted(handle):
                    return handle
                os.close(handle)
                return None
        except (BlockingIOError, FileNotFoundError):  # another process locks or deletes it at this moment
            pass
        except OSError:  # a file system without locks
            return handle
        os.close(handle)
        time.sleep(0.02)
    return None


@contextmanager
def shared(target: Path, work: str, busy: str) -> Iterator[None]:
    """Claim `target` together with all processes that do the same `work`; where another is done, raise Busy at once.

    Without effect on a file system without locks.

    Args:
        busy: the message.
    """
    path = claim_path(target)
    handle = _shared(path, work.encode())
    if handle is None:
        raise Busy(busy)
    try:
        yield
    finally:
        with suppress(OSError):  # others are still at work
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.unlink(path)
        os.close(handle)


def _shared(path: Path, work: bytes) -> int | None:
    """A handle of the file, with a lock that processes of this `work` share; None if others hold the lock.

    Who is alone writes the work into the file, then shares the lock. That is not atomic: a process that comes between
    writes its own, so what is read under the shared lock decides.
    """

    def lock(handle: int) -> None:
        with suppress(BlockingIOError):
            _alone(handle)
            os.ftruncate(handle, 0)
            os.pwrite(handle, work, 0)
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)

    return _locked(path, 50, lock, lambda handle: os.pread(handle, len(work) + 1, 0) == work)


class Sink:
    """The file object that HDF5 writes a part file through.

    HDF5's own driver reports a full disk as a RuntimeError on close, and again when the interpreter exits. Here the
    first OSError is stored in `error` and later writes are ignored, so that HDF5 can close the file; `guard`, in which
    the caller works, raises it.
    """

    def __init__(self, target: Path) -> None:
        self.target = target
        self.path = target.with_name(f"{target.name}{PART_MARK}{os.getpid()}")
        self.error: OSError | None = None
        self.dead = False  # if set, all further writes are ignored
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
        """h5py requires this method of a file object, but reads by `readinto`."""
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
        """Raise the OSError of a failed write instead of the error that HDF5 makes of it."""
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

    def publish(self, *, sync: bool = True) -> None:
        """Rename the file atomically; before and after that, sync it and its folder to disk unless told not to."""
        if sync:
            os.fsync(self._handle)
        try:
            os.replace(self.path, self.target)
        except OSError as error:  # it names the part file, which nobody knows
            raise OSError(error.errno, error.strerror, str(self.target)) from None
        if sync:
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
def published(target: Path, *, sync: bool = True) -> Iterator[Sink]:
    """A sink for a file that gets its name if the block succeeds, and is deleted otherwise.

    Without `sync` a killed process still leaves it whole or not at all, but a loss of power may leave it empty: for
    files without which nothing is lost.

    Raises:
        OSError: with its errno; Busy: another process writes this very file.
    """
    sink = Sink(target)
    try:
        with sink.guard():
            yield sink
        sink.publish(sync=sync)
    except BaseException:
        sink.discard()
        raise


def write(target: Path, data: bytes, *, sync: bool = True) -> None:
    """Write a whole file at once; raises as `published` does, and syncs as it does."""
    with published(target, sync=sync) as sink:
        sink.write(memoryview(data))
