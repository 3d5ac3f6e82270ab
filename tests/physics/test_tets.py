"""Quadratic tets against CalculiX and against hexes, at default quality, on every sensor that ships."""

import pytest
from helpers.presses import Run

from tacgen import solve
from tacgen.recipe import assets, plan
from tacgen.scene import mesh
from tacgen.scene import scene as stage

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
    made = stage.build(row)
    problem = solve.Problem.of(made, mesh.of(made))
    return Run(made, problem, list(solve.states(made, problem)))


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
