"""Quadratic tets against CalculiX and against hexes, at default quality, on every sensor that ships."""

import pytest
from helpers.presses import Run

from tacgen import mechanics
from tacgen.mechanics import mesh
from tacgen.recipe import assets, plan, scene_of_row

CALCULIX = (
    "sensor=gelsight_mini",
    "sensor.gel.layers[0].youngs_modulus_mpa=0.15",
    "sensor.gel.layers[0].poissons_ratio=0.48",
)


pytestmark = pytest.mark.usefixtures("own_cache")


def press(*sets: str) -> Run:
    """A ball of 4 mm, 1 mm deep, without friction."""
    path = "trajectory=[{press: {depth_mm: 1.0, frames: 1}}]"
    row = plan.load(assets.recipe_path("quickstart"), ("outputs=[force]", "contact.friction=0", path, *sets)).rows[0]
    made = scene_of_row.build(row)
    problem = mechanics.Problem.of(made, mesh.of(made))
    return Run(made, problem, list(mechanics.states(made, problem)))


@pytest.mark.slow
def test_the_force_is_calculixs() -> None:
    found = press(*CALCULIX, "mesh=tet")
    assert len(found.problem.mesh.points) < 8000
    assert -found.forces[-1, 2] == pytest.approx(1.0, abs=0.015)


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ["gelsight_mini", "digit", "ninedtact"])
def test_the_force_is_that_of_hexes(sensor: str) -> None:
    hexes, tets = (-press(f"sensor={sensor}", f"mesh={kind}").forces[-1, 2] for kind in ("hex", "tet"))
    assert tets == pytest.approx(hexes, rel=0.01)
