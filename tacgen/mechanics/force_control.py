"""Root of an increasing function in few evaluations: a secant method that is kept inside the known bracket."""

from collections.abc import Callable, Generator
from enum import Enum
from typing import TypeVar

HERTZ_LINEAR_POWER = 2 / 3  # exponent of the value that makes it linear in u for a ball pressed in by u (Hertz) [-]
END_TOL = 1e-12  # distance of u from an end at which it counts as the end
MAX_FORCE_TRIALS = 30  # most evaluations
T = TypeVar("T")


class End(Enum):
    """How a search ended."""

    met = "met"
    out_of_reach = "out of reach"  # the function is below the target on the whole interval, as its last value shows
    not_found = "not found"  # within MAX_FORCE_TRIALS evaluations
    stopped = "stopped"  # by the function


def meet(
    f: Callable[[float], Generator[T, None, float | None]],
    target: float,
    *,
    known: tuple[float, float],
    guess: float,
    low: float,
    high: float,
    tol: float,
) -> Generator[T, None, End]:
    """Evaluate an increasing f until f(u) is `target` within the relative tolerance `tol`; the last u is the result.

    Args:
        f: yields what it needs done, which is passed on, and returns its value; nan where it has none, which counts as
            above the target; or None to stop the search.
        known: (u, f(u)), not evaluated again. guess: first u. low, high: the interval; f(low) < target.
    """
    bounded = known[1] >= target  # whether an evaluation is an upper bound
    below, above = ((low, 0.0), known) if bounded else (known, (high, float("nan")))
    last, u = known, guess
    for step in range(MAX_FORCE_TRIALS):
        inside = below[0] < u < above[0] or (u == high and not bounded)
        if not inside or step % 6 == 5:  # bisection, if the secant approaches from one side only
            u = (below[0] + above[0]) / 2
        if (v := (yield from f(u))) is None:
            return End.stopped
        if abs(v - target) <= tol * target:
            return End.met
        if v < target and u >= high - END_TOL:
            return End.out_of_reach
        if v < target:
            below = (u, v)
        else:
            above, bounded = (u, v), True
        u, last = _next(target, last, (u, v)), (u, v)
        if not bounded:
            u = min(u, high, last[0] + max(4 * (last[0] - known[0]), (high - last[0]) / 4))
    return End.not_found


def _next(target: float, last: tuple[float, float], now: tuple[float, float]) -> float:
    """The secant through the last two points; nan, which requests bisection, if there is none."""
    rise = max(now[1], 0.0) ** HERTZ_LINEAR_POWER - max(last[1], 0.0) ** HERTZ_LINEAR_POWER
    run = now[0] - last[0]
    if not rise * run > 0:
        return float("nan")
    return float(now[0] + (target**HERTZ_LINEAR_POWER - max(now[1], 0.0) ** HERTZ_LINEAR_POWER) * run / rise)
