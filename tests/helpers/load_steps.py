"""Load steps that tests watch or refuse."""

from collections.abc import Callable

import pytest

from tacgen.mechanics import NotConverged, solver
from tacgen.mechanics.course import Course, Leg
from tacgen.mechanics.numerics import Numerics
from tacgen.mechanics.phases import Outcome, Phase


def watched(
    monkeypatch: pytest.MonkeyPatch, refuse: Callable[[Course], NotConverged | None] = lambda now: None
) -> list[Leg]:
    """The load steps that will begin, in order; one for which `refuse` has a failure fails with it instead."""
    usual, done = solver.PHASE_KERNELS[Phase.start], list[Leg]()

    def start(n: Numerics, rows: list[int]) -> list[Outcome]:
        course = n.courses[0]
        if failure := refuse(course):
            course.failure = failure
            return [Outcome.failure]
        if not course.found:
            done.append(course.legs[0])
        return usual(n, rows)

    monkeypatch.setitem(solver.PHASE_KERNELS, Phase.start, start)
    return done
