"""A bar with the time left on a terminal; elsewhere, or with NO_COLOR, there is none."""

import os
import sys
from typing import Any, Self, TextIO

from tacgen.base.terminal import dropping


class TerminalBar:
    """Shows a bar while its block runs, where the stream is a terminal; what the stream does not take is dropped."""

    def __init__(self, stream: TextIO | None, total: float, counted: str = "") -> None:
        """`counted`: what is done of the total is shown as a number of these."""
        self.stream = stream or sys.stderr
        self.total, self.counted = total, counted
        self.bar: Any = None
        self.task: Any = None

    def __enter__(self) -> Self:
        if self.stream.isatty() and not os.environ.get("NO_COLOR"):
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

            counts = (MofNCompleteColumn(), TextColumn(self.counted)) if self.counted else ()
            columns = (TextColumn("{task.description}", markup=False), BarColumn(), *counts)
            left = (TimeElapsedColumn(), TextColumn("{task.fields[left]}"))
            self.bar = Progress(*columns, *left, console=Console(file=self.stream), transient=True)
            self.task = self.bar.add_task("starting", total=self.total, left="")
            with dropping(self.stream):
                self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            with dropping(self.stream):
                self.bar.stop()
