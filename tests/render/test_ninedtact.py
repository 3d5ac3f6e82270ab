"""9DTact: two layers on a conforming mesh, of which the camera sees the inner one; and sensors without lights."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers import small_recipe
from helpers.presses import run
from ruamel.yaml import YAML

from tacgen.base.errors import UserError
from tacgen.outputs import gel_surface
from tacgen.recipe import assets, loading, scene_of_row, sensor_checks

LIT = ("coating", "walls", "leds")
FINE = 1.1674  # [N] on meshes of 0.25 and 0.2 mm edge (16 800 and 21 800 nodes), dhat 0.03 mm


@pytest.mark.slow
def test_force_of_a_press_at_default_quality() -> None:
    row = small_recipe.row("press: {depth_mm: 1, frames: 4}", "sensor=ninedtact", "quality=default")
    press = run(scene_of_row.build(row))
    assert len(press.problem.mesh.points) < 7000
    assert -press.forces[-1, 2] == pytest.approx(FINE, rel=0.015)
    assert press.states[-1].substeps == 1


def test_the_camera_sees_the_skin_from_inside() -> None:
    row = small_recipe.row("press: {depth_mm: 1, frames: 1}", "sensor=ninedtact", "quality=draft")
    press = run(scene_of_row.build(row))
    seen = gel_surface.seen(press.problem.mesh, len(row.sensor.gel.clear_layers))
    assert seen.rest[:, 2] == pytest.approx(-0.3)
    now = seen.moved(press.states[-1].x)
    under, beside = now.at(np.array([[0.0, 0.0], [3.2, 0.0]]))[:, 2] + 0.3
    assert -1.0 < under < -0.8  # the skin thins a little
    assert beside > 0.03  # what was pressed away bulges around


def test_images_are_refused_where_no_lights_or_half_of_them_are_described(tmp_path: Path) -> None:
    data = loading.read_sensor(assets.sensor_path("ninedtact"))[1].data
    _, wrong = sensor_checks.check({k: v for k, v in data.items() if k != "walls"})
    assert [(p.path, p.message) for p in wrong] == [(("walls",), "is missing, and leds is there (albedo)")]
    dark = {k: v for k, v in data.items() if k not in LIT}
    YAML(typ="safe").dump({**dark, "name": "dark"}, tmp_path / "dark.yaml")
    (tmp_path / "r.yaml").write_text("extends: quickstart\nsensor: dark.yaml\noutputs: [force, rgb]\n")
    with pytest.raises(UserError) as caught:
        loading.read(tmp_path / "r.yaml")
    told = [line for line in caught.value.lines if not line.startswith(" ")]
    assert len(told) == 1
    assert re.search(r"r\.yaml:3:10: outputs: asks for rgb: the sensor dark has no coating, walls, leds", told[0])
