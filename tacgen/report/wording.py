"""Counts and durations as text, and short names of paths."""

from collections.abc import Iterable


def counted(n: int, noun: str) -> str:
    """`1 scene`, `2 scenes`."""
    return f"{n} {noun}" + ("" if n == 1 else "s")


def duration(seconds: float) -> str:
    """`40 s`, `12 min`, `3.1 h`."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def short(paths: Iterable[str]) -> dict[str, str]:
    """Path -> its shortest end that no other path has: `leds[0].power` and `leds[1].power`."""
    steps = {path: path.split(".") for path in paths}

    def alone(path: str, n: int) -> bool:
        return sum(other[-n:] == steps[path][-n:] for other in steps.values()) == 1

    return {
        path: ".".join(own[-next((n for n in range(1, len(own)) if alone(path, n)), len(own)) :])
        for path, own in steps.items()
    }
