"""Seconds that a scene spends in each of its stages."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from tacgen.base import compiled


class Clock:
    """Seconds by `now` spent in each stage without the stages within it, and apart from them on compiling."""

    now = staticmethod(time.perf_counter)

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start, before, counted = self.now(), compiled.seconds(), dict(self.seconds)
        try:
            yield
        finally:
            compiling = compiled.seconds() - before - self.seconds.get("compile", 0.0) + counted.get("compile", 0.0)
            inside = sum(self.seconds.values()) - sum(counted.values())
            for key, seconds in ((name, self.now() - start - inside - compiling), ("compile", compiling)):
                if seconds:
                    self.seconds[key] = self.seconds.get(key, 0.0) + seconds
