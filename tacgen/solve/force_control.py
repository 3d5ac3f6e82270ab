"""Where a rising function meets a value, in few evaluations: a secant that is kept inside what is known."""

from collections.abc import Callable

POWER = 2 / 3  # of the value against u: straight for a ball that is pressed in by u
END = 1e-12  # u this close to the end is the end


class OutOfReach(ArithmeticError):
    """The function stays below the target as far as one may go; `most` is its largest value found."""

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
    steps: int = 30,
) -> None:
    """Evaluate a rising f until f(u) is `target` within the part `tol` of it; the last evaluation is the answer.

    Args:
        f: may return nan where it has no value, which is taken for too far.
        known: (u, f(u)), not evaluated again. guess: where to look first. low, high: the ends; f(low) < target.

    Raises:
        OutOfReach: f(high) < target. ArithmeticError: not met in so many steps.
    """
    bounded = known[1] >= target  # from above, by an evaluation
    below, above = ((low, 0.0), known) if bounded else (known, (high, float("nan")))
    last, u = known, guess
    for step in range(steps):
        inside = below[0] < u < above[0] or (u == high and not bounded)
        if not inside or step % 6 == 5:  # a secant that creeps up on the answer from one side is cut short
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
    raise ArithmeticError(f"{target:g} not met within {tol:g} of it in {steps} trials, from {below} to {above}")


def _next(target: float, last: tuple[float, float], now: tuple[float, float]) -> float:
    """The secant through the last two points; nan, which asks for the middle, where they give none."""
    rise = max(now[1], 0.0) ** POWER - max(last[1], 0.0) ** POWER
    run = now[0] - last[0]
    if not rise * run > 0:
        return float("nan")
    return float(now[0] + (target**POWER - max(now[1], 0.0) ** POWER) * run / rise)
