"""The search behind a player's tuned settings: its constants of stiffness and damping, one set for all cases, at which
the mean error of its forces is least."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from benchmarks.referee.case import Array, Case
from benchmarks.referee.player import Answer, NotPlayed

WORST = 10.0  # an error is not counted as more: 1 is that of saying 0
TOUCHING_N = 1e-3  # frames whose force is less have no error as a part of it [N]
SEED = 0  # of the first half of the trials

Settings = Mapping[str, Any]


class Tunable(Protocol):
    """A module of a player: where the search goes, and what it makes of a point."""

    LOW: Sequence[float]
    HIGH: Sequence[float]

    def settings_at(self, x: Sequence[float]) -> Settings: ...


def error(play: Callable[[Case], Answer], forces: Mapping[Case, Array]) -> float:
    """Mean of the errors of a player's forces against `forces` (n, 3) of each case that it plays, as parts of them."""
    means = []
    for case, right in forces.items():
        try:
            said = play(case).force
        except NotPlayed:
            continue
        size = np.linalg.norm(right, axis=1)
        off = np.linalg.norm(said - right, axis=1)[size > TOUCHING_N] / size[size > TOUCHING_N]
        means.append(np.nan_to_num(np.minimum(off, WORST), nan=WORST).mean())
    return float(np.mean(means))


def search(
    module: Tunable,
    play: Callable[[Case, Settings], Answer],
    forces: Mapping[Case, Array],
    trials: int,
    say: Callable[[str], None],
) -> tuple[Settings, float]:
    """The best settings and their error after `trials` plays of all cases: half of them spread evenly between LOW and
    HIGH, then from the best of these by Nelder and Mead."""
    low, high = np.array(module.LOW), np.array(module.HIGH)

    def at(x: Array) -> Settings:
        return module.settings_at(tuple(low + (high - low) * np.clip(x, 0, 1)))

    def cost(x: Array) -> float:
        settings = at(x)
        found = error(lambda case: play(case, settings), forces)
        say(f"{found:.4f} {dict(settings)}")
        return found

    spread = qmc.Sobol(len(low), rng=SEED).random(trials // 2)
    costs = [cost(x) for x in spread]
    best = spread[int(np.argmin(costs))]
    steps = best + np.diag(np.where(best < 0.5, 0.15, -0.15))
    simplex = np.concatenate([best[None], steps])
    done = minimize(
        cost, best, method="Nelder-Mead", options={"maxfev": trials - trials // 2, "initial_simplex": simplex}
    )
    return at(done.x), float(done.fun)
