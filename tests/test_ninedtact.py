"""9DTact: two layers on a conforming mesh, and a sensor file that describes no lights yet."""

import re
from pathlib import Path

import numpy as np
import pytest
from physics.presses import Run

from tacgen import assets, fields, load, mesh, plan, solve
from tacgen import scene as stage
from tacgen.errors import UserError
from tacgen.optics.layers import Camera

RECIPE = """\
tacgen: 1
name: nine
sensor: ninedtact
indenter: {shape: sphere, radius_mm: 4.0}
trajectory: [{press: {depth_mm: 1.0, frames: 1}}]
outputs: [force, traction, height, stress]
"""
FINE = 1.1674  # [N] on meshes of 0.25 and 0.2 mm edge (16 800 and 21 800 nodes), dhat 0.03 mm


def row_of(folder: Path, sets: tuple[str, ...] = ()) -> plan.Row:
    path = folder / "nine.yaml"
    path.write_text(RECIPE)
    found = load.read(path, sets)
    return plan.expand(found.recipe, found.sensor, loaded=found).rows[0]


@pytest.fixture(scope="module")
def row(tmp_path_factory: pytest.TempPathFactory) -> plan.Row:
    return row_of(tmp_path_factory.mktemp("nine"))


@pytest.fixture(scope="module")
def press(row: plan.Row) -> Run:
    made = stage.build(row)
    problem = solve.Problem.of(made, mesh.build(made.gel, mesh.footprint(made), made.edge))
    return Run(made, problem, list(solve.states(made, problem)))


def test_force_of_a_press_at_default_quality(press: Run) -> None:
    assert len(press.problem.mesh.points) < 7000
    assert -press.forces[-1, 2] == pytest.approx(FINE, rel=0.015)
    assert press.states[-1].substeps == 1


def test_the_maps_see_the_press(press: Run, row: plan.Row) -> None:
    """A camera without a plate: 0.0505 mm/px at the middle, and the force is in view."""
    camera = Camera.from_sensor(row.sensor)
    assert camera.shape == (345, 460)
    step = camera.project([[0.1, 0.0, 0.0]])[0] - camera.project([[0.0, 0.0, 0.0]])[0]
    assert 0.1 / step[0] == pytest.approx(0.0505, rel=1e-3)
    grid, state = press.problem.mesh, press.states[-1]
    surface = fields.Surface(grid.points, grid.facets["coated"])
    maps = fields.maps(press.problem, surface.moved(state.x), state, camera)
    assert (maps.stress[..., 2] * maps.area).sum() == pytest.approx(press.forces[-1, 2], rel=1e-6)


def test_nodal_stress_does_not_average_across_the_interface(press: Run) -> None:
    """At the interface it lies within what the skin's integration points around say; the base says something else."""
    problem, x = press.problem, press.states[-1].x
    base, skin = problem.elastic
    shared = np.intersect1d(base.elements.conn, skin.elements.conn)
    assert problem.mesh.points[shared, 2] == pytest.approx(-0.3)
    node = fields.stress(problem, x).node[:, 0]  # xx jumps where moduli do; traction does not
    bounds = []
    for part in (base, skin):
        sigma = part.cauchy(x)[0][..., 0, 0]
        low, high = np.full(len(x), np.inf), np.full(len(x), -np.inf)
        np.minimum.at(low, part.elements.conn, sigma.min(1)[:, None])
        np.maximum.at(high, part.elements.conn, sigma.max(1)[:, None])
        bounds.append((low[shared], high[shared]))
    (base_low, base_high), (skin_low, skin_high) = bounds
    value = node[shared]
    assert (value >= skin_low - 1e-12).all()
    assert (value <= skin_high + 1e-12).all()
    apart = (skin_low > base_high) | (skin_high < base_low)
    assert apart.sum() > 20
    assert ((value > base_high) | (value < base_low))[apart].all()


def test_images_are_refused_where_no_lights_are_described(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text(RECIPE.replace("force, traction, height, stress", "force, rgb"))
    with pytest.raises(UserError) as caught:
        load.read(tmp_path / "r.yaml")
    told = [line for line in caught.value.lines if not line.startswith(" ")]
    assert len(told) == 1
    assert re.search(r"r\.yaml:6:10: outputs: asks for rgb: .*ninedtact describes no lights yet$", told[0])


def test_lights_come_all_together_or_a_plate_alone() -> None:
    plain = load.read_sensor(assets.sensor_path("gelsight_mini"))[1].data
    without = {k: v for k, v in plain.items() if k not in ("coating", "walls", "leds")}
    sensor, wrong = load.check_sensor(without)
    assert sensor is not None
    assert not sensor.lit
    assert wrong == []
    sensor, wrong = load.check_sensor({k: v for k, v in plain.items() if k not in ("plate", "walls")})
    assert sensor is None
    assert [(p.path, p.message) for p in wrong] == [
        (("plate",), "is missing, and leds is there"),
        (("walls",), "is missing, and leds is there"),
    ]
