"""What a GPU's board draws, and its memory in use, once a second, as `nvidia-smi` tells them."""

import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NamedTuple

QUERY = "nvidia-smi", "--query-gpu=power.draw,memory.used", "--format=csv,noheader,nounits", "-l", "1"


class Board(NamedTuple):
    """Of all GPUs together, second by second: watts and GB in use."""

    watts: list[float]
    memory: list[float]

    @property
    def joules(self) -> float:
        """Energy so far [J]."""
        return sum(self.watts)

    def __str__(self) -> str:
        if not self.watts:
            return "no GPU's board can be read"
        return (
            f"{self.joules / 1e3:.1f} kJ of the GPU's board, at most {max(self.watts):.0f} W, {max(self.memory):.1f} GB"
        )


@contextmanager
def watched() -> Iterator[Board]:
    """A board that is read until the end; an empty one where there is no `nvidia-smi`."""
    board = Board([], [])
    try:
        told = subprocess.Popen(QUERY, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    except OSError:
        yield board
        return
    thread = threading.Thread(target=_read, args=(told, board), daemon=True)
    with told:
        thread.start()
        try:
            yield board
        finally:
            told.terminate()
            thread.join()


def _read(told: subprocess.Popen[str], board: Board) -> None:
    """Add what is told line by line; GPUs are told one after another."""
    assert told.stdout is not None
    count = _count()
    for k, line in enumerate(told.stdout):
        with suppress(ValueError):
            watts, megabytes = map(float, line.split(","))
            if k % count == 0:
                board.watts.append(0.0)
                board.memory.append(0.0)
            board.watts[-1] += watts
            board.memory[-1] += megabytes / 1e3


def _count() -> int:
    found = subprocess.run(("nvidia-smi", "-L"), capture_output=True, text=True, check=False).stdout
    return max(len(found.splitlines()), 1)
