"""The driver of the method: it calls the kernel of the present phase until the frame is solved or has no solution."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tacgen.mechanics import admission, bulk_newton, load_step, load_stepping
from tacgen.mechanics.phases import FINAL, TRANSITIONS, Outcome, Phase
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.solve_state import Leg, SolveState
from tacgen.mechanics.state import History

Array = np.ndarray
KERNELS: dict[Phase, Callable[[Problem, SolveState], tuple[Outcome, SolveState]]] = {
    Phase.begin: load_step.begin,
    Phase.renew: load_step.renew,
    Phase.predict: load_step.foresee,
    Phase.start: load_step.start,
    Phase.step: bulk_newton.begin_step,
    Phase.factor: bulk_newton.factor,
    Phase.load: bulk_newton.load,
    Phase.contact: bulk_newton.contact,
    Phase.damp: bulk_newton.damp,
    Phase.search: bulk_newton.search,
    Phase.measure: bulk_newton.measure,
    Phase.whole: load_step.whole,
    Phase.admit: admission.admit,
    Phase.halve: load_stepping.halve,
}


def following(now: SolveState, outcome: Outcome) -> SolveState:
    """The SolveState in the phase that follows from an outcome."""
    return replace(now, phase=TRANSITIONS[now.phase][outcome])


def solve(problem: Problem, now: SolveState, until: Phase | None = None) -> SolveState:
    """Kernel after kernel until the frame is done or failed, or before the next kernel of the phase `until`."""
    while now.phase not in FINAL:
        outcome, now = KERNELS[now.phase](problem, now)
        now = following(now, outcome)
        if now.phase is until:
            return now
    return now


def advance(
    problem: Problem, history: History, a: Array, b: Array, turn: Array, index: int, duration: float, **how: Any
) -> SolveState:
    """From pose a to pose b (4, 4) at constant speed, rotating by `turn` (3,) [rad], in `duration` [s].

    how: other fields of SolveState; with an `effort`, all load steps share the count of Newton steps, which begins
    with it.
    """
    legs = load_stepping.divided(problem, history, a, b, turn, duration, shared="effort" in how)
    return solve(problem, SolveState(index, history, legs, **how))


def equilibrium(
    problem: Problem, history: History, b: Array, index: int, duration: float = math.inf, **how: Any
) -> SolveState:
    """The gel under the indenter at pose b (4, 4), one load step on from `history`, which is not halved.

    duration: [s], with inertia or viscosity. how: other fields of SolveState.
    """
    leg = Leg(b, b, np.zeros(3), duration, budget="effort" not in how)
    return solve(problem, SolveState(index, history, (leg,), may_halve=False, **how))
