"""The driver of the method, for any engine: it calls the kernel of the present phase until frames are solved or have no
solution."""

from collections.abc import Callable

from tacgen.mechanics import admission, bulk_newton, load_step_phases, load_stepping
from tacgen.mechanics.course import Course
from tacgen.mechanics.numerics import Numerics
from tacgen.mechanics.one_scene import OneScene
from tacgen.mechanics.phases import FINAL_PHASES, PHASE_TRANSITIONS, Outcome, Phase
from tacgen.mechanics.problem import Problem

PHASE_KERNELS: dict[Phase, Callable[[Numerics, list[int]], list[Outcome]]] = {
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


def advance(n: Numerics, phase: Phase, rows: list[int]) -> None:
    """Call the kernel of a phase for the scenes in rows that wait for it."""
    for row, outcome in zip(rows, PHASE_KERNELS[phase](n, rows), strict=True):
        n.courses[row].phase = PHASE_TRANSITIONS[phase][outcome]


def go_on(scene: OneScene, until: Phase | None = None) -> None:
    """Kernel after kernel until a frame is done or failed, or before the next kernel of the phase `until`."""
    course = scene.course
    while course.phase not in FINAL_PHASES:
        advance(scene, course.phase, [0])
        if course.phase is until:
            return


def solve(problem: Problem, course: Course) -> Course:
    """A frame on a core: its course at the end."""
    go_on(OneScene(problem, course))
    return course
