"""A mesh presses as the shape it stands for, with friction, and fine detail does not stall the solver."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers import small_recipe
from helpers.presses import run

from tacgen import mechanics
from tacgen.base.errors import UserError
from tacgen.recipe import scene_of_row

pytestmark = pytest.mark.usefixtures("own_cache")
MOVES = "press: {depth_mm: 0.8, frames: 1}, slide: {x_mm: 0.4, frames: 2}"
SETS = "contact.friction=0.5", "quality={edge_mm: 0.8, dhat_mm: 0.05}"


def pressed(*sets: str) -> list[mechanics.State]:
    return run(scene_of_row.build(small_recipe.row(MOVES, *SETS, *sets))).states


@pytest.mark.slow
def test_a_ball_of_triangles_presses_as_a_ball(tmp_path: Path):
    trimesh.creation.icosphere(subdivisions=5, radius=1.0).export(tmp_path / "ball.stl")
    ball = pressed()
    triangles = pressed(f"indenter={{shape: mesh, file: {tmp_path / 'ball.stl'}, scale: 4}}")
    for one, other in zip(ball, triangles, strict=True):
        force, same = (state.traction_force.sum((0, 1)) for state in (one, other))
        assert np.linalg.norm(same - force) < 0.005 * np.linalg.norm(force)
        assert other.iterations <= one.iterations + 4
    assert np.linalg.norm(force) > 1


@pytest.mark.slow
def test_letters_are_reached_in_one_step():
    """Friction with normals that are not of length one stalled here."""
    press = "trajectory=[{press: {depth_mm: 0.4, frames: 2}}]"
    for state in pressed("indenter={shape: mesh, file: letters}", press):
        assert state.substeps == 1
        assert state.iterations <= 8
        assert state.min_gap > 0
        assert state.balance < 1e-3
        assert state.traction_force[..., 2].sum() < -0.5


def plate(folder: Path, thickness: float) -> tuple[str, str]:
    """A plate of 8 mm that is pressed by 0.2 mm at once."""
    trimesh.creation.box([8, 8, thickness]).export(folder / "plate.stl")
    indenter = f"indenter={{shape: mesh, file: {folder / 'plate.stl'}}}"
    return indenter, "trajectory=[{press: {depth_mm: 0.2, frames: 1}}]"


def test_a_plate_that_is_thinner_than_contact_reaches_is_refused(tmp_path: Path):
    """It bore no force at any depth: contact shrinks the indenter, and of this one nothing was left."""
    with pytest.raises(UserError, match=r"plate\.stl: has walls thinner than 0\.11 mm.*{dhat_mm: 0\.035}"):
        pressed(*plate(tmp_path, 0.1))


@pytest.mark.slow
def test_a_thin_plate_presses_as_a_thick_one_where_contact_reaches_less_far(tmp_path: Path):
    states = (pressed(*plate(tmp_path, thickness), "quality={edge_mm: 0.8, dhat_mm: 0.01}") for thickness in (0.1, 0.5))
    force, same = (state.traction_force.sum((0, 1))[2] for (state,) in states)
    assert force == pytest.approx(same, rel=0.1)
