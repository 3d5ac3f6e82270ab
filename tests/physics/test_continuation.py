"""Load steps that are merely long are halved, not damped: frames are unique unless the gel folds."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.reference_runs import row_of
from tacgen.mechanics import DEFAULT_OPTIONS, Problem, SolverOptions, State, mesh, states
from tacgen.mechanics.admission import folds_on
from tacgen.mechanics.course import Leg
from tacgen.mechanics.load_stepping import may_damp
from tacgen.recipe import scene_of_row

PRESSED = {
    "a flat punch": "{shape: cylinder, radius_mm: 3, fillet_mm: 0.6}",
    "a sharper punch": "{shape: cylinder, radius_mm: 2, fillet_mm: 0.3}",
    "a box": "{shape: box, size_x_mm: 5, size_y_mm: 4, fillet_mm: 0.5}",
    "a capsule": "{shape: capsule, radius_mm: 1.6, length_mm: 8}",
}


def pressed(indenter: str, frames: int, options: SolverOptions = DEFAULT_OPTIONS) -> list[State]:
    """The frames of a press by .9 mm at `draft`."""
    press = f"trajectory=[{{press: {{depth_mm: 0.9, frames: {frames}}}}}]"
    made = scene_of_row.build(
        row_of((f"indenter={indenter}", press, "contact.friction=0.6", "quality=draft", "outputs=[force]"))
    )
    return list(states(made, Problem.of(made, mesh.of(made), options)))


def force(found: list[State]) -> float:
    return -float(found[-1].traction_force.sum((0, 1))[2])


@pytest.mark.parametrize(
    "name", [name if name == "a box" else pytest.param(name, marks=pytest.mark.slow) for name in PRESSED]
)
def test_a_press_has_one_force_and_no_fold_in_however_many_frames(name: str) -> None:
    found = [pressed(PRESSED[name], frames) for frames in (1, 2, 10)]
    assert all(state.unique and not state.damped for states in found for state in states)
    assert [force(each) for each in found] == pytest.approx([force(found[-1])] * 3, rel=0.005)


def test_without_halving_a_long_load_step_is_damped() -> None:
    """Why it is halved: the force is the same, and the frame is marked as a fold."""
    (damped,) = pressed(PRESSED["a box"], 1, replace(DEFAULT_OPTIONS, fold_halvings=0))
    (halved,) = pressed(PRESSED["a box"], 1)
    assert damped.damped > 0
    assert not damped.unique
    assert force([halved]) == pytest.approx(force([damped]), rel=0.003)


def test_a_gel_has_folded_until_it_is_untouched_and_may_be_damped_at_once() -> None:
    touched = pressed(PRESSED["a box"], 1)[-1].after
    assert touched is not None
    assert touched.normal_force.any()
    lifted = replace(touched, normal_force=np.zeros_like(touched.normal_force))
    leg = Leg(np.eye(4), np.eye(4), np.zeros(3), np.inf)
    for history, after_fold in ((touched, True), (lifted, False)):
        assert folds_on(history, 1)
        assert not folds_on(history, 0)
        assert folds_on(replace(history, folded=True), 0) == after_fold
    assert [may_damp(touched, leg._replace(halved=times), DEFAULT_OPTIONS) for times in (0, 1, 2)] == [
        False,
        False,
        True,
    ]
    assert may_damp(replace(touched, folded=True), leg, DEFAULT_OPTIONS)
    assert not may_damp(replace(touched, folded=True), leg, replace(DEFAULT_OPTIONS, through_folds=False))
