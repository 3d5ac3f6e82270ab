"""A recipe may ask for an error of the force instead of an element edge."""

import numpy as np
import pytest

from benchmarks.reference_runs import row_of
from tacgen.base.errors import UserError
from tacgen.mechanics import Problem, mesh, states
from tacgen.mechanics.expected_error import Expected
from tacgen.mechanics.scene import Scene
from tacgen.recipe import scene_of_row
from tacgen.recipe.model import QUALITIES
from tacgen.recipe.scene_of_row import MIN_CHOSEN_EDGE_MM, _range_of

BALL = "{shape: sphere, radius_mm: 4}"
PRESS = "trajectory=[{press: {depth_mm: 0.8, frames: 1}}]"


def scene(quality: str, indenter: str = BALL, *sets: str) -> Scene:
    return scene_of_row.build(row_of(("outputs=[force]", f"indenter={indenter}", PRESS, f"quality={quality}", *sets)))


@pytest.mark.parametrize("error", [0.05, 0.02, 0.01])
def test_the_longest_edge_with_that_error_is_chosen(error: float) -> None:
    made = scene(f"{{force_error: {error}}}")
    expected = Expected.of(made)
    assert expected is not None
    assert 0.9 * error < expected.error <= 1.01 * error
    assert made.dhat == pytest.approx(_range_of(made.edge), rel=0.05)


def test_a_sharp_contact_gets_a_shorter_edge_than_a_round_one() -> None:
    box = "{shape: box, size_x_mm: 5, size_y_mm: 5, fillet_mm: 0.1}"
    assert scene("{force_error: 0.03}", box).edge < 0.8 * scene("{force_error: 0.03}").edge


def test_contact_acts_as_far_as_in_the_presets_at_their_edges() -> None:
    for quality in QUALITIES.values():
        assert _range_of(quality.edge_mm) == pytest.approx(quality.dhat_mm)
    edges = np.geomspace(0.1, 1.0, 50)
    assert (np.diff([_range_of(edge) for edge in edges]) > 0).all()


def test_what_is_not_touched_is_as_at_default() -> None:
    away = "trajectory=[{slide: {x_mm: 1, frames: 1}}]"
    assert scene("{force_error: 0.02}", BALL, away, "may_miss=true").edge == QUALITIES["default"].edge_mm


@pytest.mark.parametrize(
    ("sets", "line"),
    [
        (("quality={force_error: 0.0005}",), rf"force_error: 0.0005 asks for edges below {MIN_CHOSEN_EDGE_MM:g} mm"),
        (("quality={force_error: 0.02, edge_mm: 0.5}",), "force_error chooses edge_mm and dhat_mm: give it or them"),
        (("quality={force_error: 0.02}", "mesh=linear_tet"), "force_error: is not known for linear tetrahedra"),
        (("quality={force_error: 0.7}",), "force_error"),
    ],
)
def test_what_cannot_be_chosen_is_one_line(sets: tuple[str, ...], line: str) -> None:
    with pytest.raises(UserError, match=line):
        scene_of_row.build(row_of(("outputs=[force]", f"indenter={BALL}", PRESS, *sets)))


@pytest.mark.slow
def test_the_force_is_off_by_what_was_asked_for() -> None:
    def force(made: Scene) -> float:
        return -float(list(states(made, Problem.of(made, mesh.of(made))))[-1].traction_force.sum((0, 1))[2])

    right = force(scene("{edge_mm: 0.25, dhat_mm: 0.012}"))
    for error in (0.05, 0.02):
        assert abs(force(scene(f"{{force_error: {error}}}")) / right - 1) < 2 * error
