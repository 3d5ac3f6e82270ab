"""Steps of a long command on stderr: a bar with the time left on a terminal, lines elsewhere or with NO_COLOR."""

import os
import sys
import time
from typing import Any, TextIO

from tacgen.base.errors import printable
from tacgen.base.terminal import dropping
from tacgen.report.sheet import duration

MIN_LINE_INTERVAL_S = 2.0  # least time between two lines, and before the first, where there is no terminal [s]
MIN_SHARE_FOR_ESTIMATE = 0.05  # of the work, from which the time left is estimated


class StepProgress:
    """Shows what goes on, and the share of the work that is done."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self.stream = stream or sys.stderr
        self.started = self.last_line = time.monotonic()
        self.bar: Any = None
        self.task: Any = None

    def __enter__(self) -> "StepProgress":
        if self.stream.isatty() and not os.environ.get("NO_COLOR"):
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bar

            columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
            left = TextColumn("{task.fields[left]}")
            self.bar = Bar(*columns, left, console=Console(file=self.stream), transient=True)
            self.task = self.bar.add_task("starting", total=1.0, left="")
            with dropping(self.stream):
                self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            with dropping(self.stream):
                self.bar.stop()

    def __call__(self, text: str, share: float) -> None:
        """Show a step, and the share of the work that is done, from 0 to 1."""
        now, text = time.monotonic(), printable(text)
        left = ""
        if MIN_SHARE_FOR_ESTIMATE <= share < 1:
            left = f"about {duration((now - self.started) * (1 - share) / share)} left"
        with dropping(self.stream):
            if self.bar is not None:
                self.bar.update(self.task, completed=share, description=text, left=left)
            elif now - self.last_line >= MIN_LINE_INTERVAL_S:
                self.last_line = now
                print(text + (f" ({left})" if left else ""), file=self.stream, flush=True)
