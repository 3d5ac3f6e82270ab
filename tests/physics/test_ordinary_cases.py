"""Ordinary scenes that the former solver lost its way on, by name."""

import pytest

from benchmarks.reference_runs import row_of
from tacgen.scene import mesh
from tacgen.scene import scene as stage
from tacgen.solve import Problem, states

KEY = (
    "sensor=ninedtact",
    "indenter={shape: mesh, file: key}",
    "trajectory=[{press: {depth_mm: 0.681, frames: 4}}, {slide: {x_mm: -0.997, y_mm: 0.3, frames: 3}}]",
    "contact.friction=0.419",
    "start={x_mm: 0.73, y_mm: 1.39}",
    "outputs=[force]",
    "quality=draft",
)


@pytest.mark.slow
def test_a_key_pressed_and_slid_on_a_soft_gel_with_a_skin() -> None:
    """328 factorisations and 265 s of processor before, corners inside out; some 30 and 11 s now."""
    made = stage.build(row_of(KEY))
    problem = Problem.of(made, mesh.of(made))
    found = list(states(made, problem))
    assert len(found) == 7
    assert min(state.least_J for state in found) > 0.05
    assert max(state.residual for state in found) < 1e-3
    assert problem.factored < 100
    force = found[-1].traction_force.sum((0, 1))
    assert force[2] == pytest.approx(-9.4, rel=0.05)
