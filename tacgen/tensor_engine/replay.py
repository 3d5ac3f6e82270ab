"""Work on rows of a batch recorded once, as a CUDA graph, and replayed: hundreds of launches become one.

For some dozens of scenes a GPU takes less time for an operation than its host to launch it. Work is a function of slots
(s,) that reads and writes a batch's tensors, and never waits for the device: where it goes on otherwise for a few
scenes, it asks `rare`, and is done again for these: where it had `room` for too few, by a recording with room for
many, else without. So work must not read what it writes, and a scene's results must not depend on the others of a call.
"""

import gc
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from torch import Tensor

from tacgen.tensor_engine import device as devices
from tacgen.tensor_engine.indices import index_of, listed

SIZES = (2, 4, 8, 16, 32, 64, 128, 256)  # rows of recordings
SMALL = 16  # rows of a call that would take hardly less time with fewer
SLOW = ("factor",)  # work that fills a GPU, and gives way to all other
Outputs = tuple[Tensor, ...]
Work = Callable[..., Outputs]  # of slots (s,) and numbers (s,); outputs have a row for each
_noted: "_Notes | None" = None  # while work is recorded


def padded(rows: int) -> int:
    """Rows of the recording for so many; each size takes the time of some calls to record."""
    return next((size for size in SIZES if size >= rows), -(-rows // SIZES[-1]) * SIZES[-1])


def fitting(waiting: int, most: int) -> int:
    """How many of the scenes that wait, at most `most`, go into one call. Rows that repeat the first one take as long
    as others, but where a call is small anyway."""
    rows = min(waiting, max(size for size in SIZES if size <= max(most, SIZES[0])))
    if rows <= SMALL or rows >= 0.75 * padded(rows):
        return rows
    return max(size for size in SIZES if size <= rows)


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
        self._where: Any = None  # stream and pool of memory, which recordings share since they never run at once

    def forget(self) -> None:
        """Give recordings up: tensors have moved, or there is no memory for more."""
        if self._recorded:
            self._recorded, self._where = {}, None
            devices.cleared(str(self.device))

    def __call__(self, key: Hashable, work: Work, s: Tensor, *numbers: Sequence[float]) -> Outputs:
        """Outputs of work for slots s and numbers of them, to be used before the next call; key: all else that it
        depends on. The first call with a key and a size of call is not recorded: libraries and constants are made."""
        return self._called(key, work, s, numbers, False) if self.on else self._eagerly(work, s, numbers)

    def _called(self, key: Hashable, work: Work, s: Tensor, numbers: Sequence[Sequence[float]], roomy: bool) -> Outputs:
        """Outputs of work by a recording, which has room for many or for few of what is rare."""
        rows = listed(s)
        at = key, (size := padded(len(rows))), roomy
        if at not in self._recorded:
            self._recorded[at] = None
            return self._eagerly(work, s, numbers)
        recorded = self._recorded[at] or self._record(work, size, len(numbers), roomy)
        if recorded is None:
            self.forget()  # those that are used will be recorded again
            recorded = self._record(work, size, len(numbers), roomy)
        if recorded is None:
            self.on = False  # else each call would look for memory again
            return self._eagerly(work, s, numbers)
        self._recorded[at] = recorded
        out, missed = recorded.replay(rows, numbers, isinstance(key, tuple) and key[0] in SLOW)
        self.count += 1
        if missed:
            self.again += len(missed)
            some, k = index_of([rows[k] for k in missed], self.device), torch.tensor(missed, device=self.device)
            theirs = [[each[k] for k in missed] for each in numbers]
            if recorded.bounded and not roomy:
                out = tuple(part.clone() for part in out)  # recordings share memory
                again = self._called(key, work, some, theirs, True)
            else:
                again = self._eagerly(work, some, theirs)
            for whole, part in zip(out, again, strict=True):
                whole[k] = part
        return out

    def _record(self, work: Work, size: int, numbers: int, roomy: bool) -> "_Recording | None":
        """A new recording; None: there is no memory for it."""
        if devices.full(self.device):
            return None
        if self._where is None and self.device.type == "cuda":
            self._where = torch.cuda.Stream(), torch.cuda.graph_pool_handle()
        try:
            return _Recording(work, size, numbers, self.device, self._where, roomy)
        except torch.OutOfMemoryError:
            return None

    def _eagerly(self, work: Work, s: Tensor, numbers: Sequence[Sequence[float]]) -> Outputs:
        given = [torch.tensor(each, dtype=torch.float64, device=self.device) for each in numbers]
        try:
            return work(s, *given)
        except torch.OutOfMemoryError:  # recordings have some
            self.forget()
        return work(s, *given)


class _Recording:
    """Work for a number of rows, on a GPU as a graph; a call with fewer repeats its first row."""

    def __init__(self, work: Work, size: int, numbers: int, device: torch.device, where: Any, roomy: bool) -> None:
        self.roomy = roomy
        self.size, self.graph = size, torch.cuda.CUDAGraph() if device.type == "cuda" else None
        self.run = partial(self._run, work)
        self.slots = torch.zeros(size, dtype=torch.long, device=device)
        self.numbers = torch.zeros(numbers, size, dtype=torch.float64, device=device)
        if self.graph is not None:
            self._capture(self.graph, *where)
            del self.run  # which holds the batch

    def _run(self, work: Work) -> None:
        with _noting(self.roomy) as notes:
            self.out = work(self.slots, *self.numbers)
        self.bounded = notes.bounded
        self.missed = torch.stack(notes.missed).any(0) if notes.missed else None

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

    def replay(
        self, rows: list[int], numbers: Sequence[Sequence[float]], slow: bool = False
    ) -> tuple[Outputs, list[int]]:
        """Outputs for these rows, and the places of those that met something rare; slow: whether it gives way."""
        more = self.size - len(rows)
        self.slots.copy_(torch.tensor(rows + rows[:1] * more))
        for at, each in zip(self.numbers, numbers, strict=True):
            at.copy_(torch.tensor([*each, *[each[0]] * more], dtype=torch.float64))
        again = self.run if self.graph is None else self.graph.replay
        with devices.giving_way(self.slots.device) if slow else nullcontext():
            again()
        out = tuple(part[: len(rows)] for part in self.out)
        if self.missed is None:
            return out, []
        return out, [k for k, missed in enumerate(self.missed[: len(rows)].tolist()) if missed]
