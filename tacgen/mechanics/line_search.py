"""Backtracking line search: Nocedal & Wright (2006), "Numerical optimization", ch. 3."""

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def backtrack(trial: Callable[[float], tuple[bool, T]], shortest: float, first: float = 1.0) -> tuple[float, T | None]:
    """The first of the fractions first, first/2, first/4... >= shortest of a step that a trial accepts, or 0.0; and the
    result of the last trial, or None if there was none."""
    fraction, result = first, None
    while fraction >= shortest:
        accepted, result = trial(fraction)
        if accepted:
            return fraction, result
        fraction /= 2
    return 0.0, result
