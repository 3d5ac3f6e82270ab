"""The transition table: complete, reachable, and sure to end; and what kernels really do is in it."""

import copy
import pickle
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.presses import force, gel, poses, problem_of, scene

from tacgen.geometry.analytic_sdf import BoxSdf, CylinderSdf, Shape, SphereSdf
from tacgen.geometry.pose import Pose
from tacgen.mechanics import NotConverged, Problem, SolverOptions, phases, plain, solver
from tacgen.mechanics.course import Course
from tacgen.mechanics.linear_solvers import NotPositiveDefinite
from tacgen.mechanics.load_stepping import to_pose
from tacgen.mechanics.one_scene import OneScene
from tacgen.mechanics.phases import COUNTED_PHASES, FINAL_PHASES, PHASE_TRANSITIONS, Outcome, Phase

Edge = tuple[Phase, Outcome]


def reached(start: Phase, without: frozenset[Phase] = frozenset()) -> set[Phase]:
    """The phases that can follow one, on paths that pass none of `without`."""
    seen, ahead = set[Phase](), [start]
    while ahead:
        for phase in PHASE_TRANSITIONS.get(ahead.pop(), {}).values():
            if phase not in seen | without:
                seen.add(phase)
                ahead.append(phase)
    return seen


def test_every_phase_has_a_kernel_and_a_row_or_is_final() -> None:
    assert set(PHASE_TRANSITIONS) == set(solver.PHASE_KERNELS) == set(Phase) - FINAL_PHASES
    assert all(PHASE_TRANSITIONS.values())


@pytest.mark.parametrize("phase", Phase)
def test_every_phase_is_reached_and_leads_to_both_ends(phase: Phase) -> None:
    assert phase is Phase.begin or phase in reached(Phase.begin)
    if phase not in FINAL_PHASES:
        assert reached(phase) >= FINAL_PHASES


@pytest.mark.parametrize("phase", [phase for phase in Phase if phase not in COUNTED_PHASES])
def test_every_cycle_passes_a_phase_that_is_counted(phase: Phase) -> None:
    assert phase not in reached(phase, frozenset(COUNTED_PHASES))


def begun(shape: Shape, options: SolverOptions, depth: float, x: float = 0.0) -> tuple[Problem, Course]:
    """A press by `depth` and a slide by x at once, on a small pad, before the first kernel."""
    made = scene(shape, poses([(x, 0.0, -depth)]), pad=gel(8, 8, 2.0), friction=0.6, edge=1.0)
    problem = problem_of(made, 2.0, options)
    rest = problem.rest(Pose.of(made.start))
    return problem, to_pose(problem, rest, made.start, made.poses[0], np.zeros(3), 0, np.inf)


def indefinite(*_: object) -> None:
    raise NotPositiveDefinite


USUAL = SolverOptions()
AT_ONCE = replace(USUAL, sink=np.inf, slide=np.inf, slide_sharp=np.inf)
BOX = BoxSdf(1.6, 1.6, 0.1)
BALL = SphereSdf(2.5)
RUNS: dict[str, tuple[tuple[Any, ...], str, object]] = {  # press and options; what is replaced, and by what
    "two load steps": ((BALL, replace(USUAL, sink=0.3), 0.3), "", None),
    "far away": ((BALL, USUAL, -3.0), "", None),
    "punch, pressed deep": ((CylinderSdf(1.2, 0.2), replace(USUAL, sink=np.inf), 1.2), "", None),
    "folds end it": ((BOX, replace(USUAL, through_folds=False, sink=np.inf), 0.9, 1.2), "", None),
    "in circles": ((BOX, replace(AT_ONCE, max_contact=1), 0.9, 1.2), "", None),
    "all unknowns": ((BALL, plain(), 0.2), "", None),
    "all unknowns, out of steps": ((BALL, replace(plain(), max_newton=1, halvings=1), 0.2), "", None),
    "out of steps": ((BALL, replace(USUAL, max_newton=1, halvings=1), 0.3), "", None),
    "out of effort": ((BALL, replace(USUAL, max_effort=1), 0.3), "", None),
    "out of balance": ((BALL, replace(USUAL, residual_max=1e-300, halvings=0), 0.3), "", None),
    "no damping": ((BOX, replace(AT_ONCE, halvings=0), 0.9, 1.2), "bulk_newton.MAX_DAMPING", -1.0),
    "no step lowers the energy": ((BALL, replace(USUAL, halvings=0), 0.3), "measures.MIN_ENERGY_GAIN", 1e9),
    "too far": ((BALL, USUAL, 0.3), "one_scene.blocked", lambda *_: True),
    "no tangent": ((BALL, replace(USUAL, halvings=0), 0.3), "bulk.Tangent.take", indefinite),
}


def edges(name: str) -> set[Edge]:
    """What the kernels return in a run, phase by phase."""
    press, patched, by = RUNS[name]
    seen = set[Edge]()
    with pytest.MonkeyPatch.context() as patch:
        if patched:
            patch.setattr(f"tacgen.mechanics.{patched}", by)
        problem, now = begun(*press)
        scene = OneScene(problem, now)
        while now.phase not in FINAL_PHASES:
            (outcome,) = solver.PHASE_KERNELS[now.phase](scene, [0])
            seen.add((now.phase, outcome))
            now.phase = PHASE_TRANSITIONS[now.phase][outcome]
    assert (now.phase is Phase.failed) == (now.failure is not None)
    if now.failure is not None:
        with pytest.raises(NotConverged, match=re.escape(str(now.failure))):
            now.reached()
    return seen


def test_kernels_return_all_that_the_table_has_and_no_more() -> None:
    assert set.union(*map(edges, RUNS)) == {(phase, end) for phase, row in PHASE_TRANSITIONS.items() for end in row}


def test_what_is_kept_between_two_load_steps_goes_on_in_another_process() -> None:
    """Only the factor is missing, which is taken anew: the same answer within the tolerances."""
    problem, now = begun(BALL, replace(USUAL, sink=0.1), 0.3)
    assert len(now.legs) > 2
    scene = OneScene(problem, now)
    solver.go_on(scene, until=Phase.begin)
    half = copy.copy(now)
    assert half.state is not None
    kept = pickle.dumps(now)
    solver.go_on(scene)
    other, _ = begun(BALL, replace(USUAL, sink=0.1), 0.3)
    whole, again = now, solver.solve(other, pickle.loads(kept))
    assert again.history.x == pytest.approx(whole.history.x, abs=1e-4)
    forces = [force(now.reached()[1])[2] for now in (whole, again)]
    assert forces[1] == pytest.approx(forces[0], rel=1e-4)
    assert (again.state or half.state).substeps == (whole.state or half.state).substeps


def test_a_load_step_begins_without_the_facets_of_the_one_before() -> None:
    problem, course = begun(BALL, replace(USUAL, sink=0.1), 0.3)
    one = OneScene(problem, course)
    solver.go_on(one, until=Phase.step)
    solver.go_on(one, until=Phase.begin)
    assert one.touching is not None
    solver.go_on(one, until=Phase.step)
    assert one.touching is None


def test_the_printed_table_is_the_table() -> None:
    page = (Path(__file__).parents[2] / "docs" / "MECHANICS.md").read_text(encoding="utf-8")
    assert phases.table() in page
