"""Steps of a long command on stderr: a bar with the time left on a terminal, lines elsewhere or with NO_COLOR."""

import time
from typing import TextIO

from tacgen.base.errors import printable
from tacgen.base.terminal import dropping
from tacgen.report.sheet import duration
from tacgen.report.terminal_bar import TerminalBar

MIN_LINE_INTERVAL_S = 2.0  # least time between two lines, and before the first, where there is no terminal [s]
MIN_SHARE_FOR_ESTIMATE = 0.05  # of the work, from which the time left is estimated


class StepProgress(TerminalBar):
    """Shows what goes on, and the share of the work that is done."""

    def __init__(self, stream: TextIO | None = None) -> None:
        super().__init__(stream, 1.0)
        self.started = self.last_line = time.monotonic()

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
