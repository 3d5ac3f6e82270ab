"""The driver of the method: it calls the kernel of the present phase until the frame is solved or has no solution."""

from collections.abc import Callable
from dataclasses import replace

from tacgen.mechanics import admission, bulk_newton, load_step_phases, load_stepping
from tacgen.mechanics.phases import FINAL_PHASES, PHASE_TRANSITIONS, Outcome, Phase
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.solve_state import SolveState

PHASE_KERNELS: dict[Phase, Callable[[Problem, SolveState], tuple[Outcome, SolveState]]] = {
    Phase.begin: load_step_phases.begin,
    Phase.renew: load_step_phases.renew,
    Phase.predict: load_step_phases.foresee,
    Phase.start: load_step_phases.start,
    Phase.step: bulk_newton.begin_step,
    Phase.factor: bulk_newton.factor,
    Phase.load: bulk_newton.load,
    Phase.contact: bulk_newton.contact,
    Phase.damp: bulk_newton.damp,
    Phase.search: bulk_newton.search,
    Phase.measure: bulk_newton.measure,
    Phase.whole: load_step_phases.whole,
    Phase.admit: admission.admit,
    Phase.halve: load_stepping.halve,
}


def following(now: SolveState, outcome: Outcome) -> SolveState:
    """The SolveState in the phase that follows from an outcome."""
    return replace(now, phase=PHASE_TRANSITIONS[now.phase][outcome])


def solve(problem: Problem, now: SolveState, until: Phase | None = None) -> SolveState:
    """Kernel after kernel until the frame is done or failed, or before the next kernel of the phase `until`."""
    while now.phase not in FINAL_PHASES:
        outcome, now = PHASE_KERNELS[now.phase](problem, now)
        now = following(now, outcome)
        if now.phase is until:
            return now
    return now
