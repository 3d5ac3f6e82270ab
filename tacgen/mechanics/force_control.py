"""Root of an increasing function in few evaluations: a secant method that is kept inside the known bracket."""

from collections.abc import Callable

POWER = 2 / 3  # exponent of the value that makes it linear in u for a ball pressed in by u (Hertz) [-]
END = 1e-12  # distance of u from an end at which it counts as the end
TRIALS = 30  # most evaluations


class OutOfReach(ArithmeticError):
    """The function is below the target on the whole interval; `most` is the largest value that was found."""

    def __init__(self, most: float) -> None:
        super().__init__(f"at most {most:g}")
        self.most = most


def meet(
    f: Callable[[float], float],
    target: float,
    *,
    known: tuple[float, float],
    guess: float,
    low: float,
    high: float,
    tol: float,
) -> None:
    """Evaluate an increasing f until f(u) is `target` within the relative tolerance `tol`; the last u is the result.

    Args:
        f: may return nan where it has no value, which counts as above the target.
        known: (u, f(u)), not evaluated again. guess: first u. low, high: the interval; f(low) < target.

    Raises:
        OutOfReach: f(high) < target. ArithmeticError: not found within TRIALS evaluations.
    """
    bounded = known[1] >= target  # whether an evaluation is an upper bound
    below, above = ((low, 0.0), known) if bounded else (known, (high, float("nan")))
    last, u = known, guess
    for step in range(TRIALS):
        inside = below[0] < u < above[0] or (u == high and not bounded)
        if not inside or step % 6 == 5:  # bisection, if the secant approaches from one side only
            u = (below[0] + above[0]) / 2
        v = f(u)
        if abs(v - target) <= tol * target:
            return
        if v < target and u >= high - END:
            raise OutOfReach(v)
        if v < target:
            below = (u, v)
        else:
            above, bounded = (u, v), True
        u, last = _next(target, last, (u, v)), (u, v)
        if not bounded:
            u = min(u, high, last[0] + max(4 * (last[0] - known[0]), (high - last[0]) / 4))
    raise ArithmeticError(f"{target:g} not met within {tol:g} of it in {TRIALS} trials, from {below} to {above}")


def _next(target: float, last: tuple[float, float], now: tuple[float, float]) -> float:
    """The secant through the last two points; nan, which requests bisection, if there is none."""
    rise = max(now[1], 0.0) ** POWER - max(last[1], 0.0) ** POWER
    run = now[0] - last[0]
    if not rise * run > 0:
        return float("nan")
    return float(now[0] + (target**POWER - max(now[1], 0.0) ** POWER) * run / rise)
