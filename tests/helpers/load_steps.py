"""Load steps that tests watch or refuse."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from tacgen.mechanics import NotConverged, Problem, solver
from tacgen.mechanics.phases import Outcome, Phase
from tacgen.mechanics.solve_state import Leg, SolveState


def watched(
    monkeypatch: pytest.MonkeyPatch, refuse: Callable[[SolveState], NotConverged | None] = lambda now: None
) -> list[Leg]:
    """The load steps that will begin, in order; one for which `refuse` has a failure fails with it instead."""
    usual, done = solver.PHASE_KERNELS[Phase.start], list[Leg]()

    def start(problem: Problem, now: SolveState) -> tuple[Outcome, SolveState]:
        if failure := refuse(now):
            return Outcome.failure, replace(now, failure=failure)
        if now.found is None:
            done.append(now.legs[0])
        return usual(problem, now)

    monkeypatch.setitem(solver.PHASE_KERNELS, Phase.start, start)
    return done
