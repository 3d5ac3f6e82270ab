"""Varied paths that lie in one another: parents first in whatever order they are listed, or refused in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

from tacgen.base.errors import UserError
from tacgen.recipe import assets, plan
from tacgen.recipe.loading import read
from tacgen.sensor.yaml_source import at, parse_path

HEAD = f"""\
extends: {assets.recipe_path("quickstart")}
name: batch
vary:
  method: sobol
  samples: 7
  seed: 3
  over:
"""
DEPTHS = "trajectory[0].press.depth_mm: {uniform: [0.3, 1.2]}"
MOVES = (
    "trajectory: {choice: [[{press: {depth_mm: 0.8, frames: 2}}],"
    " [{press: {depth_mm: 0.8, frames: 5}}, {hold: {frames: 1}}]]}"
)
STIFF = "sensor.gel.layers[0].youngs_modulus_mpa: {uniform: [0.1, 0.2]}"
LAYERS = (
    "sensor.gel.layers: {choice: [[{name: g, thickness_mm: 4, youngs_modulus_mpa: 0.3, poissons_ratio: 0.47,"
    " source: mine}]]}"
)


def varied(tmp_path: Path, *over: str, sets: tuple[str, ...] = ("outputs=[force]",)) -> plan.Plan:
    path = tmp_path / "batch.yaml"
    path.write_text(HEAD + "".join(f"    {line}\n" for line in over))
    return plan.expand(read(path, sets))


@pytest.mark.parametrize("over", [(DEPTHS, MOVES), (STIFF, LAYERS)], ids=["recipe", "sensor"])
def test_a_varied_child_holds_in_whatever_order_it_is_listed_with_its_parent(tmp_path: Path, over: tuple[str, str]):
    for found in varied(tmp_path, *over), varied(tmp_path, *reversed(over)):
        assert len(found.rows) == 7
        for row in found.rows:
            document = {**row.document(), "sensor": row.sensor_document()}
            name = over[0].partition(":")[0]
            assert at(document, parse_path(name)) == row.values[name]
            assert (tmp_path / "again.yaml").write_text(json.dumps(row.document()))
            (again,) = plan.load(tmp_path / "again.yaml").rows
            assert (again.recipe, again.sensor) == (row.recipe, row.sensor)


def test_a_grid_of_parents_leaves_their_children_what_was_drawn(tmp_path: Path):
    whole = varied(tmp_path, DEPTHS, sets=("outputs=[force]", f"vary.grid={{{MOVES}}}"))
    assert {row.frames for row in whole.rows} == {2, 6}
    for row in whole.rows:
        assert row.recipe.trajectory[0].press.depth_mm == row.values["trajectory[0].press.depth_mm"]


def test_parents_come_first_in_overrides_of_the_sensor_too(tmp_path: Path):
    layer = "{name: g, thickness_mm: 4, youngs_modulus_mpa: 0.3, poissons_ratio: 0.47, source: mine}"
    own = f"sensor_overrides={{'gel.layers[0].youngs_modulus_mpa': 0.15, gel.layers: [{layer}]}}"
    (row,) = plan.load(assets.recipe_path("quickstart"), [own]).rows
    assert row.sensor.gel.layers[0].youngs_modulus_mpa == 0.15


def test_a_scene_with_a_varied_parent_of_an_override_can_be_made_again(tmp_path: Path):
    sets = ("outputs=[force]", "sensor.gel.layers[0].youngs_modulus_mpa=0.15", "sensor.coating.specular=0.03")
    coat = "sensor.coating: {choice: [{roughness: 0.3}]}"
    for row in varied(tmp_path, LAYERS, coat, sets=sets).rows:
        assert row.sensor.gel.layers[0].youngs_modulus_mpa == 0.3
        assert (row.sensor.coating.roughness, row.sensor.coating.specular) == (0.3, 0.03), "mappings are merged"
        (tmp_path / "again.yaml").write_text(json.dumps(row.document()))
        assert plan.load(tmp_path / "again.yaml").rows[0].sensor == row.sensor


def test_values_of_the_sensor_reach_both_fingers(tmp_path: Path):
    vary = f"vary:\n  samples: 2\n  over:\n    {STIFF}\n"
    (tmp_path / "grasp.yaml").write_text(f"extends: {assets.recipe_path('grasp')}\ngrasp: {{right: digit}}\n{vary}")
    for row in plan.load(tmp_path / "grasp.yaml", ["outputs=[force]"]).rows:
        for finger in row.bundles:
            modulus = finger.sensor.gel.layers[0].youngs_modulus_mpa
            assert modulus == row.values["sensor.gel.layers[0].youngs_modulus_mpa"], finger.name


INNER = (
    "trajectory[1]: {choice: [{slide: {x_mm: {uniform: [0.2, 1]}, y_mm: {uniform: [3, 4]}, frames: 3}},"
    " {twist: {angle_deg: {integers: [5, 6]}, frames: 2}}, {hold: {frames: 1}}]}"
)

SIXTY_FOUR = ("vary.samples=64", "outputs=[force]")


def test_a_choice_holds_distributions_of_its_own(tmp_path: Path):
    """Some slides, some twists: each is drawn within its own ranges, and the other paths as without them."""
    rows = varied(tmp_path, DEPTHS, INNER, sets=SIXTY_FOUR).rows
    slides = [row.recipe.trajectory[1].slide for row in rows if row.recipe.trajectory[1].slide]
    twists = [row.recipe.trajectory[1].twist for row in rows if row.recipe.trajectory[1].twist]
    assert min(len(slides), len(twists)) >= 20
    x, y = [move.x_mm for move in slides], [move.y_mm for move in slides]
    assert (0.2 < min(x) < 0.3, 0.9 < max(x) < 1, 3 < min(y) < 3.1, 3.9 < max(y) < 4) == (True,) * 4
    assert abs(np.corrcoef(x, y)[0, 1]) < 0.4
    assert {move.angle_deg for move in twists} == {5, 6}
    for row in (rows[3], rows[40]):
        (again,) = plan.load(tmp_path / "batch.yaml", SIXTY_FOUR, (row.index, 64)).rows
        assert (again.values, again.key) == (row.values, row.key)


def test_distributions_inside_choices_are_the_same_on_all_sensors(tmp_path: Path):
    rows = varied(tmp_path, DEPTHS, INNER, sets=("sensors=[gelsight_mini, digit]", "outputs=[force]")).rows
    for one, other in zip(rows[::2], rows[1::2], strict=True):
        assert one.sensor.name != other.sensor.name
        assert one.recipe.trajectory == other.recipe.trajectory


def test_a_grid_takes_no_distribution_inside_a_choice(tmp_path: Path):
    with pytest.raises(UserError, match=r"choice\[0\].slide.x_mm: a grid takes no distribution inside a choice"):
        varied(tmp_path, INNER, sets=("vary.method=grid", "vary.samples=null"))


@pytest.mark.parametrize(
    ("over", "line"),
    [
        ((DEPTHS, "trajectory: {choice: [[{hold: {}}]]}"),
         "batch.yaml:8:5: scene-00000: trajectory[0].press.depth_mm: has no place in the trajectory that is drawn"),
        (("dynamics: {choice: [null]}", "dynamics.density_kg_m3: {uniform: [900, 1000]}"),
         "batch.yaml:9:5: scene-00000: dynamics.density_kg_m3: has no place in the dynamics that is drawn"),
        (("indenter.radius_mm: {uniform: [1, 2]}", "indenter: {choice: [{shape: box, size_x_mm: 3, size_y_mm: 2}]}"),
         "batch.yaml:8:5: scene-00000: indenter.radius_mm: is a key of shape: sphere"),
        (("trajectory: {choice: [[{press: {depth_mm: {uniform: [1.2, 0.3]}}}]]}",),
         "batch.yaml:8:57: vary.over.trajectory.choice[0][0].press.depth_mm.uniform: must be [low, high]"),
        (("trajectory: {choice: [[{press: {depth_mm: {choice: [{uniform: [0.3, 1.2]}, 1]}}}]]}",),
         "batch.yaml:8:47: vary.over.trajectory.choice[0][0].press.depth_mm: holds a distribution inside a choice"),
        (("trajectory[0].press: {choice: [{depth_mm: {uniform: [4, 5]}, frames: 2}]}",),
         "batch.yaml:8:5: scene-00000: trajectory[0].press.depth_mm: must be less than the gel is thick"),
        (("trajectory[0].press.depth_mm: {uniform: [0.3, 1]}", "trajectory[00].press.depth_mm: {choice: [0.4]}"),
         "batch.yaml:9:5: vary.over[trajectory[00].press.depth_mm]: is trajectory[0].press.depth_mm, which is varied"),
    ],
)  # fmt: skip
def test_what_cannot_be_varied_together_is_one_line(tmp_path: Path, over: tuple[str, ...], line: str):
    with pytest.raises(UserError) as caught:
        varied(tmp_path, *over)
    (told,) = [text.removeprefix(f"{tmp_path}/") for text in caught.value.lines if not text.startswith("    ")]
    assert told.startswith(line), told
