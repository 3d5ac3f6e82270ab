"""The phases of a load step before the steps of the bulk, and Newton's method on all unknowns instead of them.

Each function is one kernel of the method (see phases): it takes the numerics and the rows of scenes that wait for it,
and returns an outcome for each.
"""

from tacgen.mechanics.course import Newton
from tacgen.mechanics.failures import Failure
from tacgen.mechanics.numerics import Numerics
from tacgen.mechanics.phases import Outcome


def begin(n: Numerics, rows: list[int]) -> list[Outcome]:
    """Contact and bulk at the pose of the next load step, and whether the kept tangent serves its prediction."""
    for row in rows:
        n.courses[row].fresh()
    return n.place(rows)


def renew(n: Numerics, rows: list[int]) -> list[Outcome]:
    """The tangent at the last equilibrium, which also serves the first step: at a first guess the tangent is often
    indefinite, because of the guess's pressures."""
    return [Outcome.ready if definite else Outcome.indefinite for definite in n.renew(rows)]


def foresee(n: Numerics, rows: list[int]) -> list[Outcome]:
    """The prediction, if the options ask for it."""
    if n.options.predict:
        for row, there in zip(rows, n.predict(rows), strict=True):
            n.courses[row].predicted = there
    return [Outcome.ready] * len(rows)


def start(n: Numerics, rows: list[int]) -> list[Outcome]:
    """Newton's method at its start: what a softer barrier found, else the first place that is possible."""
    new, going = [row for row in rows if not n.courses[row].found], list(rows)
    for row, there in zip(new, n.choose(new) if new else (), strict=True):
        if not there:
            n.courses[row].fail(Failure.too_far)
            going.remove(row)
    for row in going:
        n.courses[row].newton = Newton(new=not n.options.keep_tangent)
    if going:
        n.start(going)
    ready = Outcome.ready if n.condensed else Outcome.not_condensed
    return [ready if row in going else Outcome.failure for row in rows]


def whole(n: Numerics, rows: list[int]) -> list[Outcome]:
    """Newton's method on all unknowns."""
    for row in rows:
        course = n.courses[row]
        course.failure = n.whole(row)
        course.found = course.failure is None
    return [Outcome.failure if n.courses[row].failure else Outcome.ended for row in rows]
