"""How far a run is, on stderr: a bar with the time left on a terminal, plain lines elsewhere or with NO_COLOR."""

import os
import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any, TextIO

from tacgen.plan import Row


class Progress:
    """Takes what the pipeline says while it runs; frames are what is counted.

    Two things are understood: a line of text, and a finished scene (with name, status, reason). A line that ends
    in `frame 3 of 15` moves the bar.
    """

    def __init__(self, rows: Sequence[Row], stream: TextIO | None = None) -> None:
        self.stream = stream or sys.stderr
        self.total = sum(row.frames for row in rows)
        self.frames = {row.name: row.frames for row in rows}
        self.done = 0  # frames of finished scenes
        self.started = time.monotonic()
        self.bar: Any = None
        self.task: Any = None

    def __enter__(self) -> "Progress":
        if self.stream.isatty() and not os.environ.get("NO_COLOR"):
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
            from rich.progress import Progress as Bar

            columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
            times = (TextColumn("frames"), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
            self.bar = Bar(*columns, *times, console=Console(file=self.stream), transient=True)
            self.task = self.bar.add_task("starting", total=self.total)
            self.bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.bar is not None:
            self.bar.stop()

    def __call__(self, event: object) -> None:
        """Show an event of the pipeline."""
        if isinstance(event, str):
            self._line(event)
        else:
            self._finished(event)

    def _line(self, text: str) -> None:
        words = text.replace("/", " of ").split()
        frame = 0
        if len(words) >= 4 and words[-4] == "frame" and words[-2] == "of" and words[-3].isdigit():
            frame = int(words[-3])
        if self.bar is None:
            print(f"{text}{self._left(self.done + frame)}", file=self.stream, flush=True)
        elif frame:
            self.bar.update(self.task, completed=self.done + frame, description=text)
        else:
            self.bar.update(self.task, description=text)

    def _finished(self, result: Any) -> None:
        self.done += self.frames.get(result.name, 0)
        text = f"{result.name}: {result.status}" + (f": {result.reason}" if result.reason else "")
        if self.bar is None:
            print(f"{text}{self._left(self.done)}", file=self.stream, flush=True)
        else:
            self.bar.update(self.task, completed=self.done, description=text)
            if result.status != "ok":
                self.bar.console.print(text, markup=False, highlight=False)

    def _left(self, frames: int) -> str:
        """` (about 40 s left)`, once there is something to judge by."""
        if not 0 < frames < self.total:
            return ""
        seconds = (time.monotonic() - self.started) * (self.total - frames) / frames
        return f" (about {seconds:.0f} s left)" if seconds < 120 else f" (about {seconds / 60:.0f} min left)"
