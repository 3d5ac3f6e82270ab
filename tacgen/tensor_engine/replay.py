"""Work on rows of a batch recorded once, as a CUDA graph, and replayed: hundreds of launches become one.

For some dozens of scenes a GPU takes less time for an operation than its host to launch it. Work is a function of slots
(s,) that reads a batch's tensors, and never waits for the device; it returns what it tells the host (s,) or (s, c), and
how to write what it has found, either or both None. So a call is one launch and one wait: what other work would do
between two calls the recordings do, and what the host sends and is told are an array each.

Where work goes on otherwise for a few scenes, it asks `rare`, and is done again for these: where it had `room` for too
few, by a recording with room for many, else without. So what it reads it must not write, but at its end, which is left
out for these. Scenes that once needed room are given it from then on. A scene's results must not depend on the others
of a call.
"""

import gc
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from torch import Tensor

from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine.indices import index_of

RECORDED_ROWS = (2, 4, 8, 16, 32, 64, 128, 256)  # rows of recordings
MAX_UNTRIMMED_ROWS = 16  # rows of a call that would take hardly less time with fewer
SLOW_KERNELS = ("factor",)  # work that fills a GPU, and gives way to all other
Write = Callable[[Tensor | None], None]  # writes the rows of a mask (s,), or all
Work = Callable[..., tuple[Tensor | None, Write | None]]  # of slots (s,) and numbers (s,)
_noted: "_Notes | None" = None  # while work is recorded


def padded(rows: int) -> int:
    """Rows of the recording for so many; each size takes the time of some calls to record."""
    return next((size for size in RECORDED_ROWS if size >= rows), -(-rows // RECORDED_ROWS[-1]) * RECORDED_ROWS[-1])


def fitting(waiting: int, most: int) -> int:
    """How many of the scenes that wait, at most `most`, go into one call. Rows that repeat the first one take as long
    as others, but where a call is small anyway."""
    rows = min(waiting, max(size for size in RECORDED_ROWS if size <= max(most, RECORDED_ROWS[0])))
    if rows <= MAX_UNTRIMMED_ROWS or rows >= 0.75 * padded(rows):
        return rows
    return max(size for size in RECORDED_ROWS if size <= rows)


def rare(mask: Tensor) -> bool:
    """Whether a mask (s,) is set anywhere. While work is recorded False: the work is done again for scenes where that
    was wrong."""
    if _noted is None:
        return bool(mask.any())
    _noted.missed.append(mask)
    return False


def room(few: int, many: int) -> int:
    """Room that recorded work has for what most scenes have few of: `few`, or `many` where a scene needed more."""
    assert _noted is not None
    _noted.bounded = True
    return many if _noted.roomy else few


def recording() -> bool:
    """Whether work is recorded, and must not wait for the device."""
    return _noted is not None


@dataclass
class _Notes:
    """Notes on a recording: whether it has room for many, whether that matters, and masks of what must not occur."""

    roomy: bool
    bounded: bool = False
    missed: list[Tensor] = field(default_factory=list)


@contextmanager
def _noting(roomy: bool) -> Iterator[_Notes]:
    global _noted
    _noted = notes = _Notes(roomy)
    try:
        yield notes
    finally:
        _noted = None


class Replays:
    """Recordings of a batch's work on its device.

    on: whether work is padded and recorded; on a CPU it is then padded alone, for tests.
    """

    def __init__(self, device: torch.device, on: bool | None = None) -> None:
        self.device, self.on = device, device.type == "cuda" if on is None else on
        self.count = self.again = 0  # replays, and scenes of them that were done again
        self._recorded: dict[Hashable, _Recording | None] = {}
        self._wide = set[tuple[Hashable, int]]()  # kinds of work and slots of scenes that needed room for many
        self._pool: Any = None  # of memory, which recordings share since they never run at once
        self._streams: dict[bool, Any] = {}  # to record in: those of work that gives way, and of all other

    def forget(self) -> None:
        """Give recordings up: tensors have moved, or there is no memory for more."""
        if self._recorded:
            self._recorded, self._pool = {}, None
            devices.cleared(str(self.device))

    def __call__(self, key: Hashable, work: Work, rows: Sequence[int], *numbers: Sequence[float]) -> list[Any]:
        """Do work for slots `rows`, and numbers of them; key: all else that it depends on. By row what it tells, or 0.
        The first call with a key and a size of call is not recorded: libraries and constants are made."""
        if not self.on:
            return self._eagerly(work, rows, numbers)
        wide, told = [(_kind(key), row) in self._wide for row in rows], [0.0] * len(rows)
        for roomy in sorted({*wide}):
            at = [k for k, each in enumerate(wide) if each is roomy]
            found = self._called(key, work, [rows[k] for k in at], [[each[k] for k in at] for each in numbers], roomy)
            for k, one in zip(at, found, strict=True):
                told[k] = one
        return told

    def entered(self, row: int) -> None:
        """Another scene is in a slot."""
        self._wide = {each for each in self._wide if each[1] != row}

    def _called(
        self, key: Hashable, work: Work, rows: Sequence[int], numbers: Sequence[Sequence[float]], roomy: bool
    ) -> list[Any]:
        """Do work by a recording, which has room for many or for few of what is rare."""
        at = key, self._size(key, len(rows), roomy), roomy
        if at not in self._recorded:
            self._recorded[at] = None
            return self._eagerly(work, rows, numbers)
        recorded = self._recorded[at] or self._record(work, at, len(numbers))
        if recorded is None:
            self.forget()  # those that are used will be recorded again
            recorded = self._record(work, at, len(numbers))
        if recorded is None:
            self.on = False  # else each call would look for memory again
            return self._eagerly(work, rows, numbers)
        self._recorded[at] = recorded
        told, missed = recorded.replay(rows, numbers)
        self.count += 1
        if missed:
            self.again += len(missed)
            some, theirs = [rows[k] for k in missed], [[each[k] for k in missed] for each in numbers]
            if recorded.bounded and not roomy:
                self._wide.update((_kind(key), row) for row in some)
                again = self._called(key, work, some, theirs, True)
            else:
                again = self._eagerly(work, some, theirs)
            for k, one in zip(missed, again, strict=True):
                told[k] = one
        return told

    def _size(self, key: Hashable, rows: int, roomy: bool) -> int:
        """Rows of the recording for so many: twice as many as they need take less time than to record for fewer."""
        least = padded(rows)
        return next((size for size in (least, 2 * least) if self._recorded.get((key, size, roomy))), least)

    def _record(self, work: Work, at: tuple[Hashable, int, bool], numbers: int) -> "_Recording | None":
        """A new recording for a key, so many rows, and with room for many or few; None: there is no memory for it."""
        if devices.full(self.device):
            return None
        key, size, roomy = at
        if (slow := _kind(key) in SLOW_KERNELS) not in self._streams:
            self._streams[slow] = devices.stream(self.device, urgent=not slow)
        if self._pool is None and self.device.type == "cuda":
            self._pool = torch.cuda.graph_pool_handle()
        try:
            return _Recording(work, size, numbers, self.device, (self._streams[slow], self._pool), roomy)
        except torch.OutOfMemoryError:
            return None

    def _eagerly(self, work: Work, rows: Sequence[int], numbers: Sequence[Sequence[float]]) -> list[Any]:
        s = index_of(rows, self.device)
        given = [torch.tensor(each, dtype=torch.float64, device=self.device) for each in numbers]
        try:
            told, write = work(s, *given)
        except torch.OutOfMemoryError:  # recordings have some
            self.forget()
            told, write = work(s, *given)
        if write is not None:
            write(None)
        return [0.0] * len(rows) if told is None else told.tolist()


def _kind(key: Hashable) -> Hashable:
    """The kind of work of a key, which begins with it."""
    return key[0] if isinstance(key, tuple) else key


class _Recording:
    """Work for a number of rows, on a GPU as a graph; a call with fewer repeats its first row."""

    def __init__(self, work: Work, size: int, numbers: int, device: torch.device, where: Any, roomy: bool) -> None:
        self.roomy, self.size = roomy, size
        self.graph = torch.cuda.CUDAGraph() if device.type == "cuda" else None
        self.run, pinned = partial(self._run, work), self.graph is not None
        self.sent = torch.zeros(1 + numbers, size, dtype=torch.float64, pin_memory=pinned)  # slots and numbers
        self.given = self.sent.to(device)
        if self.graph is not None:
            self._capture(self.graph, *where)
            del self.run  # which holds the batch
            self.heard = torch.zeros(self.told.shape, dtype=self.told.dtype, pin_memory=True)

    def _run(self, work: Work) -> None:
        with _noting(self.roomy) as notes:
            told, write = work(self.given[0].long(), *self.given[1:])
            missed = torch.stack(notes.missed).any(0) if notes.missed else None
            if write is not None:
                write(None if missed is None else ~missed)
            parts = [part.view(self.size, -1) for part in (told, missed) if part is not None]
            self.told = torch.cat([each.to(self.given.dtype) for each in parts], 1) if parts else self.given[0, :, None]
        self.bounded, self.masked, self.wide = notes.bounded, missed is not None, told is not None and told.dim() > 1

    def _capture(self, graph: Any, stream: Any, pool: Any) -> None:
        now = torch.cuda.current_stream()
        stream.wait_stream(now)
        gc.disable()  # what it may delete must not be deleted meanwhile
        try:
            with torch.cuda.stream(stream):
                graph.capture_begin(pool=pool, capture_error_mode="thread_local")
                try:
                    self.run()
                finally:  # else nothing could be done any more
                    graph.capture_end()
        finally:
            gc.enable()
        now.wait_stream(stream)

    def replay(self, rows: Sequence[int], numbers: Sequence[Sequence[float]]) -> tuple[list[Any], list[int]]:
        """Do work: what it tells of these rows, and the places of those that met something rare."""
        more = self.size - len(rows)
        for at, each in zip(self.sent.numpy(), (rows, *numbers), strict=True):
            at[:] = [*each, *[each[0]] * more]
        self.given.copy_(self.sent, non_blocking=True)
        if self.graph is None:
            self.run()
            heard = self.told
        else:
            self.graph.replay()
            heard = self.heard.copy_(self.told, non_blocking=True)
            torch.cuda.current_stream().synchronize()
        told = heard[: len(rows)].tolist()
        missed = [k for k, each in enumerate(told) if each.pop()] if self.masked else []
        return told if self.wide else [each[0] if each else 0.0 for each in told], missed
