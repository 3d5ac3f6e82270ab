"""Backtracking line search with Armijo's rule: Nocedal & Wright (2006), "Numerical optimization", ch. 3."""

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
ARMIJO_DECREASE = 1e-4  # smallest decrease over that predicted by the slope [-]


def armijo(new: float, old: float, predicted: float, rounding: float) -> bool:
    """Whether a function falls from `old` to `new` by enough of the `predicted` change, which is negative; an increase
    of `rounding` times its size counts as rounding."""
    return new <= old + ARMIJO_DECREASE * predicted + rounding * abs(old)


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
