"""Errors of predicted forces by range of the force, and where predictions no longer grow."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

Array = np.ndarray
RANGE_EDGES_N = (0.0, 2.0, 5.0, 10.0, 14.0, 20.0, 30.0, 45.0, np.inf)  # [N]
MIN_RANGE_FORCES = 5  # forces in a range, below which it is joined with the next one
SATURATION_SLOPE = 0.5  # growth of the mean prediction per growth of the mean force, below which it is saturated


def ranges(true: Array, said: Array, floor: float) -> list[dict[str, float]]:
    """Errors by range of the true force.

    Args:
        true: forces (n,) [N].
        said: predictions of them (n,) [N].
        floor: what one who does not look would say: the mean of the forces learned from [N].

    Returns:
        A range each: `low` and `high` [N], the number of forces `n`, mean absolute error `mae`, mean error `bias`, the
        error `guess` of the floor, and the means `true` and `said`, all [N].
    """
    out, first = [], 0
    for last in range(1, len(RANGE_EDGES_N)):
        here = (true >= RANGE_EDGES_N[first]) & (true < RANGE_EDGES_N[last])
        rest = int((true >= RANGE_EDGES_N[last]).sum())
        if (here.sum() < MIN_RANGE_FORCES and rest) or 0 < rest < MIN_RANGE_FORCES or not here.any():
            continue
        off, high = said[here] - true[here], RANGE_EDGES_N[last]
        out.append({
            "low": RANGE_EDGES_N[first], "high": high if np.isfinite(high) else float(true[here].max()),
            "n": int(here.sum()),
            "mae": float(np.abs(off).mean()), "bias": float(off.mean()),
            "guess": float(np.abs(floor - true[here]).mean()),
            "true": float(true[here].mean()), "said": float(said[here].mean()),
        })  # fmt: skip
        first = last
    return out


def saturation(found: Sequence[dict[str, float]]) -> float | None:
    """The mean force [N] of the range from which on predictions grow by less than SATURATION_SLOPE of what forces do,
    up to the last one; None if they grow to the end."""
    saturated = None
    for before, after in pairwise(found):
        growth = (after["said"] - before["said"]) / (after["true"] - before["true"])
        if growth >= SATURATION_SLOPE:
            saturated = None
        elif saturated is None:
            saturated = before["true"]
    return saturated


def lines(true: Array, said: Array, learned: Array) -> list[str]:
    """The table as text, with the coverage of the forces learned from (m,) [N], and the saturation."""
    found = ranges(true, said, float(learned.mean()))
    out = ["force [N] | judged | learned from | mean error | bias | mean of the learned"]
    for one in found:
        share = float(((learned >= one["low"]) & (learned <= one["high"])).mean())
        out.append(f"{one['low']:g} to {one['high']:.3g} | {one['n']} | {100 * share:.1f} % | {one['mae']:.2f} |"
                   f" {one['bias']:+.2f} | {one['guess']:.2f}")  # fmt: skip
    most, where = float(true.max()), saturation(found)
    out.append(f"predictions stop growing at {where:.3g} N" if where is not None else
               f"predictions grow up to {most:.3g} N, the largest judged")  # fmt: skip
    if (beyond := float((true > learned.max()).mean())) > 0:
        out.append(f"{100 * beyond:.0f} % of the judged forces are larger than any learned from")
    return out


def plain(true: Array, said: Array, learned: Array) -> dict[str, Any]:
    """As JSON values."""
    found = ranges(true, said, float(learned.mean()))
    return {"ranges": found, "saturation_n": saturation(found), "largest_learned_n": float(learned.max())}
