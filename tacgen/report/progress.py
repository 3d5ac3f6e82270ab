"""Progress on stderr, of a run and of a long command's steps: a bar with the time left on a terminal, lines elsewhere
or with NO_COLOR.
"""

import os
import sys
import time
from collections.abc import Iterable
from typing import Any, Self, TextIO

from tacgen.base.errors import printable
from tacgen.base.terminal import dropping
from tacgen.report.sheet import duration

COMPILING = "compiling: half a minute, once for this version on this machine"
HOLD_UPS = {  # events that hold up the next frame and happen once, and what is said of them
    "compiling": COMPILING,
    "tracing": "tracing light through the gel: seconds to minutes, once for this sensor and quality",
}
MIN_LINE_INTERVAL_S = 2.0  # least time between two lines, and before the first, where there is no terminal [s]
MIN_SHARE_FOR_ESTIMATE = 0.05  # of the work, from which the time left is estimated


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


class Progress(TerminalBar):
    """Shows the events of a run; progress is counted in frames.

    Without a terminal it prints a line for each scene, and for each frame only if there is a single scene. What the
    stream does not take is dropped, and the run goes on.
    """

    def __init__(self, scenes: int, frames: int, stream: TextIO | None = None, noted: Iterable[str] = ()) -> None:
        """`noted`: lines that were printed already, and are not repeated."""
        super().__init__(stream, frames, counted="frames")
        self.scenes = scenes
        self.under_way: dict[str, int] = {}  # scene -> number of its finished frames
        self.done = 0  # frames of finished scenes
        self.finished = 0
        self.noted = set(noted)
        # the estimate is made from the frames since `started`, the time of the first frame that nothing has held up
        self.started = time.monotonic()
        self.unmeasured = 0  # frames that existed before this run, or were made before something held it up
        self.ahead: set[str] = set()  # scenes whose first frame since then came before any scene was finished: not used
        self.measured = False  # whether a scene was finished since then

    def __call__(self, event: dict[str, Any]) -> None:
        """Show an event: a frame, a note, a retry or the end of a scene."""
        with dropping(self.stream):
            self._show(event)

    def _show(self, event: dict[str, Any]) -> None:
        name = event["scene"]
        if event["event"] == "frame":
            if not self.ahead:
                self.started = time.monotonic()
            if not self.measured:
                self.ahead.add(name)
            self.under_way[name] = event["frame"]
            self._say(f"{name}: frame {event['frame']} of {event['frames']}", lasting=False)
        elif event["event"] in HOLD_UPS:
            # the time left is estimated from later frames alone
            self.ahead, self.measured = set(), False
            self.unmeasured = self.done + sum(self.under_way.values())
            self._say_once(HOLD_UPS[event["event"]])
        elif event["event"] == "note":
            self._say_once(f"note: {event['note']}", name)
        elif event["event"] == "retry":
            self.under_way.pop(name, None)
            self.ahead.discard(name)
            self._say(f"{name}: once more: {event['reason']}")
        else:
            self.under_way.pop(name, None)
            self.finished += 1
            self.done += event["frames"]
            before = not event["seconds"] and event["status"] != "failed"  # made by an earlier run
            self.unmeasured += event["frames"] if before else 0
            self.measured = self.measured or not before
            good = event["status"] == "ok"
            state = "kept" if before and good else f"kept, {event['status']}" if before else event["status"]
            text = f"{name}: {state}" + (f": {event['reason']}" if event["reason"] else "")
            self._say(text, lasting=not good)

    def _say_once(self, text: str, scene: str = "") -> None:
        """Print a line that holds for all scenes of a run only once."""
        if text not in self.noted:
            self.noted.add(text)
            self._say(f"{scene}: {text}" if scene else text)

    def _say(self, text: str, *, lasting: bool = True) -> None:
        """Print a line. On a terminal, only `lasting` lines are printed; others appear in the bar."""
        at, text = self.done + sum(self.under_way.values()), printable(text)
        left = self._left(at)
        if self.bar is not None:
            if lasting:
                self.bar.console.print(text, markup=False, highlight=False)
            scenes = f"{self.finished} of {self.scenes} scenes" if self.scenes > 1 else text
            self.bar.update(self.task, completed=at, description=scenes, left=left)
        elif self.scenes == 1 or ": frame " not in text:
            print(text + (f" ({left})" if left else ""), file=self.stream, flush=True)

    def _left(self, frames: int) -> str:
        """`about 40 s left`, as soon as it can be estimated."""
        made = frames - self.unmeasured - len(self.ahead)
        if made <= 0 or frames >= self.total:
            return ""
        return f"about {duration((time.monotonic() - self.started) * (self.total - frames) / made)} left"


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
