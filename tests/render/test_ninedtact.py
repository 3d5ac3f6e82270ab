"""9DTact: two layers on a conforming mesh, of which the camera sees the inner one; and sensors without lights."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers import small_recipe
from helpers.presses import Run, run
from ruamel.yaml import YAML

from tacgen.errors import UserError
from tacgen.fem.stress_recovery import FULL
from tacgen.optics.camera import PinholeCamera
from tacgen.outputs import gel_surface
from tacgen.outputs.cauchy_stress import Stresses
from tacgen.outputs.contact_maps import maps as maps_of
from tacgen.recipe import assets, loading, scene_of_row, sensor_checks
from tacgen.recipe.row import Row

LIT = ("coating", "walls", "leds")
FINE = 1.1674  # [N] on meshes of 0.25 and 0.2 mm edge (16 800 and 21 800 nodes), dhat 0.03 mm


@pytest.fixture(scope="module")
def row() -> Row:
    return small_recipe.row("press: {depth_mm: 1, frames: 4}", "sensor=ninedtact", "quality=default")


@pytest.fixture(scope="module")
def press(row: Row) -> Run:
    return run(scene_of_row.build(row))


@pytest.mark.slow
def test_force_of_a_press_at_default_quality(press: Run) -> None:
    assert len(press.problem.mesh.points) < 7000
    assert -press.forces[-1, 2] == pytest.approx(FINE, rel=0.015)
    assert press.states[-1].substeps == 1


@pytest.mark.slow
def test_the_maps_see_the_press(press: Run, row: Row) -> None:
    """0.0509 mm/px at the middle of the skin's outer side, and the force is in view."""
    camera = PinholeCamera.from_sensor(row.sensor)
    assert camera.shape == (345, 460)
    step = camera.project([[0.1, 0.0, 0.0]])[0] - camera.project([[0.0, 0.0, 0.0]])[0]
    assert 0.1 / step[0] == pytest.approx(0.0509, rel=1e-3)
    state = press.states[-1]
    maps = maps_of(press.problem, press.face.moved(state.x), state, camera)
    assert maps.force[..., 2].sum() == pytest.approx(press.forces[-1, 2], rel=1e-6)


@pytest.mark.slow
def test_traction_is_continuous_across_the_interface_and_stress_in_its_plane_is_not(press: Run) -> None:
    """The skin is three times as stiff as the base, and stretched as much: what acts in its plane differs."""
    problem, x = press.problem, press.states[-1].x
    made = Stresses(problem)
    rows, node, layer = made.at(x).rows, made.recovery.node, made.recovery.material
    shared, skin, base = np.intersect1d(node[layer == 1], node[layer == 0], return_indices=True)
    assert problem.mesh.points[shared, 2] == pytest.approx(-0.3)
    near = np.hypot(*x[shared, :2].T) < 3.0
    skin, base = (rows[layer == k][found][near][:, FULL] for k, found in ((1, skin), (0, base)))
    cells = problem.mesh.cells[(problem.mesh.layer == 1)][:, :4]  # their lower sides are the interface
    normal = np.zeros_like(x)
    for corners in cells:
        a, b = x[corners[2]] - x[corners[0]], x[corners[3]] - x[corners[1]]
        normal[corners] += np.cross(a, b)
    n = normal[shared[near]] / np.linalg.norm(normal[shared[near]], axis=1, keepdims=True)
    assert n[:, 2].min() > 0.7
    traction = [np.einsum("nij,nj->ni", side, n) for side in (skin, base)]
    across = np.eye(3) - n[:, :, None] * n[:, None]
    plane = [across @ side @ across for side in (skin, base)]
    size = np.linalg.norm(traction[0])
    assert np.linalg.norm(traction[0] - traction[1]) < 0.2 * size
    assert np.linalg.norm(plane[0] - plane[1]) > 0.6 * size
    tension = [np.trace(side, axis1=1, axis2=2) for side in plane]
    assert (tension[0] > tension[1]).mean() > 0.9


def test_the_camera_sees_the_skin_from_inside(press: Run, row: Row) -> None:
    seen = gel_surface.seen(press.problem.mesh, len(row.sensor.gel.clear_layers))
    assert seen.rest[:, 2] == pytest.approx(-0.3)
    now = seen.moved(press.states[-1].x)
    under, beside = now.at(np.array([[0.0, 0.0], [3.2, 0.0]]))[:, 2] + 0.3
    assert -1.0 < under < -0.8  # the skin thins a little
    assert beside > 0.03  # what was pressed away bulges around


def test_images_are_refused_where_no_lights_are_described(tmp_path: Path) -> None:
    dark = {k: v for k, v in loading.read_sensor(assets.sensor_path("ninedtact"))[1].data.items() if k not in LIT}
    YAML(typ="safe").dump({**dark, "name": "dark"}, tmp_path / "dark.yaml")
    (tmp_path / "r.yaml").write_text("extends: quickstart\nsensor: dark.yaml\noutputs: [force, rgb]\n")
    with pytest.raises(UserError) as caught:
        loading.read(tmp_path / "r.yaml")
    told = [line for line in caught.value.lines if not line.startswith(" ")]
    assert len(told) == 1
    assert re.search(r"r\.yaml:3:10: outputs: asks for rgb: the sensor dark has no coating, walls, leds", told[0])


def test_lights_come_all_together_or_a_plate_alone() -> None:
    plain = loading.read_sensor(assets.sensor_path("gelsight_mini"))[1].data
    without = {k: v for k, v in plain.items() if k not in ("coating", "walls", "leds")}
    sensor, wrong = sensor_checks.check(without)
    assert sensor is not None
    assert not sensor.lit
    assert wrong == []
    sensor, wrong = sensor_checks.check({k: v for k, v in plain.items() if k not in ("plate", "walls")})
    assert sensor is None
    assert [(p.path, p.message) for p in wrong] == [
        (("plate",), "is missing, and leds is there (thickness_mm, refractive_index)"),
        (("walls",), "is missing, and leds is there (albedo)"),
    ]
