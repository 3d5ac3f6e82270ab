"""The search behind a player's tuned settings: its constants of stiffness and damping, one set for all cases, at which
the mean error of its forces is least.

    python -m benchmarks.referee.tune NAME [--trials N] [--cases TEXT ...]
"""

import argparse
import importlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from benchmarks.referee import players, reference
from benchmarks.referee.case import CASES, Array, Case
from benchmarks.referee.player import NotPlayed
from benchmarks.referee.playing import Settings
from benchmarks.referee.score import score
from tacgen.base.terminal import say

WORST, SEED = 10.0, 0  # an error is not counted as more, where 1 is that of saying 0; of the first half of the trials


def error(module: Any, cases: Sequence[Case], settings: Settings) -> float:
    """Mean over the cases that a player plays of the mean error of its forces, as a part of them."""
    means = []
    for case in cases:
        with suppress(NotPlayed):
            off = score(case, module.run(case, settings), reference.kept()[case.name]).force
            means.append(np.nan_to_num(np.minimum(off, WORST), nan=WORST).mean())
    return float(np.mean(means))


def search(module: Any, cost: Callable[[Settings], float], trials: int, tell: Callable[[str], None]) -> Settings:
    """The best settings of `trials`: half of them spread evenly between the module's LOW and HIGH, then from the best
    of these by Nelder and Mead."""
    low, high = np.array(module.LOW), np.array(module.HIGH)

    def at(x: Array) -> Settings:
        return dict(module.settings_at((low + (high - low) * np.clip(x, 0, 1)).tolist()))

    def told(x: Array) -> float:
        tell(f"{(found := cost(at(x))):.4f} {at(x)}")
        return found

    spread = qmc.Halton(len(low), rng=SEED).random(trials // 2)
    best = spread[int(np.argmin([told(x) for x in spread]))]
    corners = np.concatenate([best[None], best + np.diag(np.where(best < 0.5, 0.15, -0.15))])
    options = {"maxfev": trials - trials // 2, "initial_simplex": corners}
    return at(minimize(told, best, method="Nelder-Mead", options=options).x)


def main() -> None:
    """Search, and say the error before and after."""
    ask = argparse.ArgumentParser("python -m benchmarks.referee.tune", description=__doc__)
    ask.add_argument("name", choices=players.MODULES)
    ask.add_argument("--trials", type=int, default=40)
    ask.add_argument("--cases", nargs="+", default=[""], help="parts of their names; all if left out")
    told = ask.parse_args()
    module = importlib.import_module(f"{players.__name__}.{players.MODULES[told.name]}")
    cases = [case for case in CASES if case.name in reference.kept() and any(part in case.name for part in told.cases)]
    best = search(module, lambda settings: error(module, cases, settings), told.trials, say)
    before, after = (error(module, cases, settings) for settings in (module.DEFAULT, best))
    say(f"mean error {before:.1%} before, {after:.1%} after {told.trials} trials: {dict(best)}")


if __name__ == "__main__":
    main()
