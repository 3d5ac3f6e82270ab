"""Plans: numbers depend on seed and scene only, every varied scene is checked, keys tell inputs apart."""

import gc
import json
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from tacgen.base.errors import UserError
from tacgen.bundle import schema
from tacgen.recipe import assets, plan, plan_table
from tacgen.recipe.loading import Loaded, checked, read
from tacgen.recipe.model import Recipe, Vary
from tacgen.recipe.row import KEY_FORMAT, Row, scene_seed
from tacgen.sensor.validation_messages import validate

BATCH = f"""\
extends: {assets.recipe_path("quickstart")}
name: batch
vary:
  method: METHOD
  samples: 7
  seed: 3
  over:
    indenter.radius_mm: {{uniform: [2, 6]}}
    trajectory[0].press.frames: {{integers: [1, 3]}}
    contact.friction: {{choice: [0, 0.5, 1]}}
    sensor.gel.layers[0].youngs_modulus_mpa: {{loguniform: [0.05, 0.5]}}
"""
METHODS = ("random", "sobol", "lhs", "halton")


def loaded(tmp_path: Path, text: str, sets: tuple[str, ...] = ()) -> Loaded:
    path = tmp_path / "batch.yaml"
    path.write_text(text)
    return read(path, sets)


def failure(tmp_path: Path, text: str) -> list[str]:
    with pytest.raises(UserError) as caught:
        plan.expand(loaded(tmp_path, text))
    return [line.removeprefix(f"{tmp_path}/") for line in caught.value.lines if not line.startswith("    ")]


@pytest.mark.parametrize("method", METHODS)
def test_a_row_drawn_alone_is_the_row_of_the_whole(tmp_path: Path, method: str):
    found = loaded(tmp_path, BATCH.replace("METHOD", method))
    whole = plan.expand(found).rows
    assert len({json.dumps(row.values) for row in whole}) == 7, "scenes must differ"
    for index in (6, 0, 3):
        assert [*plan.expand(found, [index]).rows] == [whole[index]]
    assert [*plan.expand(found, [5, 1, 6]).rows] == [whole[5], whole[1], whole[6]]


@pytest.mark.parametrize("method", METHODS)
def test_values_lie_where_they_should_and_reach_recipe_and_sensor(tmp_path: Path, method: str):
    for row in plan.expand(loaded(tmp_path, BATCH.replace("METHOD", method), ("vary.samples=32",))).rows:
        radius, frames, friction, modulus = row.values.values()
        assert 2 <= radius <= 6
        assert frames in (1, 2, 3)
        assert friction in (0, 0.5, 1)
        assert 0.05 <= modulus <= 0.5
        assert row.recipe.indenter.radius_mm == radius
        assert row.recipe.trajectory[0].frames == frames
        assert row.sensor.gel.layers[0].youngs_modulus_mpa == modulus
        assert row.recipe.vary is None


def test_a_plan_holds_the_numbers_of_its_scenes_alone(tmp_path: Path):
    """Resolved scenes take 28 kB each, which a plan of a million could not hold."""

    def rows() -> int:
        return sum(type(one) is Row for one in gc.get_objects())

    before, whole = rows(), plan.expand(loaded(tmp_path, BATCH.replace("METHOD", "sobol"), ("vary.samples=32",)))
    assert list(whole.frames) == [row.frames for row in whole.rows]
    assert rows() <= before + 1
    assert [row.index for row in whole.rows[5:20:7]] == [5, 12, 19]


@pytest.mark.parametrize("method", METHODS)
def test_another_seed_is_another_batch(tmp_path: Path, method: str):
    text = BATCH.replace("METHOD", method)
    one, two = (plan.expand(loaded(tmp_path, text, (f"vary.seed={seed}",))).rows for seed in (0, 1))
    assert {row.key for row in one}.isdisjoint(row.key for row in two)
    assert {row.seed for row in one}.isdisjoint(row.seed for row in two)
    first, second = ({row.values["indenter.radius_mm"] for row in rows} for rows in (one, two))
    assert first.isdisjoint(second)


NINE = "\n".join(f"    sensor.leds[{led}].radiance[{c}]: {{uniform: [0.1, 9]}}" for led in range(3) for c in range(3))


def spread(found: plan.Plan) -> float:
    """The largest correlation between two varied values."""
    r = np.corrcoef(np.array([list(row.values.values()) for row in found.rows]).T)
    return float(np.abs(np.triu(r, 1)).max())


@pytest.mark.parametrize(("samples", "most"), [(30, 0.15), pytest.param(256, 0.03, marks=pytest.mark.slow), (300, 0.1)])
def test_samples_are_spread_evenly_where_no_method_is_named(tmp_path: Path, samples: int, most: float) -> None:
    """Thirty points of Sobol's in nine dimensions correlate two of them by .4."""
    head = BATCH.partition("    indenter")[0].replace("  method: METHOD\n", "")
    whole = plan.expand(loaded(tmp_path, head + NINE, (f"vary.samples={samples}",)))
    assert spread(whole) < most
    assert whole.warnings == ()


def test_few_points_of_a_sequence_that_correlate_are_reported(tmp_path: Path) -> None:
    head = BATCH.partition("    indenter")[0].replace("METHOD", "sobol")
    whole = plan.expand(loaded(tmp_path, head + NINE, ("vary.samples=30",)))
    (text,) = whole.warnings
    assert "batch.yaml:4:11: vary.method: 30 points of sobol correlate sensor.leds[" in text
    assert f"{spread(whole):.2f}" in text
    assert plan.expand(loaded(tmp_path, head + NINE, ("vary.samples=256",))).warnings == ()


def test_every_sample_is_taken_at_every_point_of_a_grid(tmp_path: Path) -> None:
    """On other sensors too, each with the recipe's overrides; more samples leave the first scenes as they are."""
    grid = "{sensor: {choice: [gelsight_mini, digit]}, contact.friction: {linspace: [0.2, 0.4, 2]}}"
    text = BATCH.replace("METHOD", "sobol").replace("    contact.friction: {choice: [0, 0.5, 1]}\n", "")
    sets = (f"vary.grid={grid}", "vary.samples=3", "outputs=[force]", "sensor.gel.layers[0].poissons_ratio=0.47")
    found = loaded(tmp_path, text, sets)
    whole = plan.expand(found)
    assert [(row.sensor.name, row.recipe.contact.friction) for row in whole.rows[:5]] == [
        ("gelsight_mini", 0.2), ("gelsight_mini", 0.4), ("digit", 0.2), ("digit", 0.4), ("gelsight_mini", 0.2),
    ]  # fmt: skip
    assert len(whole.rows) == 12
    radii = [row.recipe.indenter.radius_mm for row in whole.rows]
    assert [len(set(radii[k : k + 4])) for k in (0, 4, 8)] == [1, 1, 1]
    assert len(set(radii)) == 3
    assert {row.sensor.gel.layers[0].poissons_ratio for row in whole.rows} == {0.47}
    assert whole.rows[2].recipe.sensor == "digit"
    modulus = whole.rows[2].sensor.gel.layers[0].youngs_modulus_mpa
    assert modulus == whole.rows[2].values["sensor.gel.layers[0].youngs_modulus_mpa"]
    assert [*plan.expand(found, [10, 3]).rows] == [whole.rows[10], whole.rows[3]]
    more = plan.expand(loaded(tmp_path, text, (*sets, "vary.samples=4")))
    assert [row.values for row in more.rows[:12]] == [row.values for row in whole.rows]


def test_several_sensors_feel_each_contact(tmp_path: Path) -> None:
    """Rows of a pair differ in the sensor alone; shards and single rows know their pairs, and so does the table."""
    sets = ("sensors=[digit, gelsight_mini, ninedtact]", "vary.samples=3", "outputs=[force]", "contact.friction=0.1")
    found = loaded(tmp_path, BATCH.replace("METHOD", "lhs"), sets)
    rows = plan.expand(found).rows
    assert [row.pair for row in rows] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert [row.sensor.name for row in rows[:3]] == ["digit", "gelsight_mini", "ninedtact"]
    for pair in (rows[:3], rows[3:6], rows[6:]):
        assert len({str({**row.values, "sensor": None}) for row in pair}) == 1
        assert len({str({**row.document(), "sensor": None}) for row in pair}) == 1
        assert all("sensors" not in row.document() for row in pair)
    assert [*plan.expand(found, [7, 2]).rows] == [rows[7], rows[2]]
    table = plan_table.as_csv(plan.expand(found)).splitlines()
    assert (table[0].split(",")[:2], table[4].split(",")[:2]) == (["scene", "pair"], ["scene-00003", "1"])
    scenes = json.loads(plan_table.as_json(plan.expand(found)))["scenes"]
    assert [scene["pair"] for scene in scenes] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert replace(rows[0], pair=7).key != rows[0].key


def test_one_contact_on_several_sensors_needs_no_vary(tmp_path: Path) -> None:
    rows = plan.load(assets.recipe_path("quickstart"), ["sensors=[digit, ninedtact]", "outputs=[force]"]).rows
    assert [(row.name, row.pair, row.recipe.sensor) for row in rows] == [
        ("scene-00000", 0, "digit"), ("scene-00001", 0, "ninedtact"),
    ]  # fmt: skip
    assert plan.load(assets.recipe_path("quickstart")).rows[0].pair is None


@pytest.mark.parametrize(
    ("sets", "line"),
    [
        (("sensors=[digit]",), "sensors: must hold at least 2"),
        (("sensors=[digit, digit]",), "sensors: must name each sensor once: leave the repeated one out"),
        (("sensors=digit",), "sensors: must be a list"),
        (("sensors=[digit, 3]",), "sensors[1]: must be text"),
        (("sensors=[digit, nosuch]",), "nosuch"),
        (("sensors=[digit, ninedtact]", "vary={samples: 2, over: {sensor: {choice: [digit]}}}"), "is in over already"),
        (("sensors=[digit, ninedtact]", "vary={samples: 2, over: {start.x_mm: {uniform: [0, 1]}},"
          " grid: {sensor: {choice: [digit]}}}"), "vary.grid.sensor: cannot be given beside sensors"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_several_sensors_is_reported(sets: tuple[str, ...], line: str) -> None:
    with pytest.raises(UserError) as caught:
        plan.load(assets.recipe_path("quickstart"), ("outputs=[force]", *sets))
    assert any(line in said for said in caught.value.lines), caught.value.lines


@pytest.mark.parametrize(
    ("grid", "line"),
    [
        ("{contact.friction: {choice: [0.2]}}", "vary.grid[contact.friction]: is in over already"),
        ("{start.x_mm: {uniform: [0, 1]}}", "vary.grid[start.x_mm]: a grid takes choice or linspace only"),
        ("{sensor: {choice: [digt]}}", "sensor: "),
    ],
)
def test_a_grid_that_cannot_be_is_reported(tmp_path: Path, grid: str, line: str) -> None:
    with pytest.raises(UserError) as caught:
        plan.expand(loaded(tmp_path, BATCH.replace("METHOD", "sobol"), (f"vary.grid={grid}",)))
    assert line in caught.value.lines[0]


def test_a_grid_is_the_product_with_the_last_varying_fastest(tmp_path: Path):
    over = "{contact.friction: {choice: [0, 1]}, start.x_mm: {linspace: [-1, 1, 3]}}"
    found = loaded(tmp_path, BATCH.replace("METHOD", "sobol"), (f"vary={{method: grid, over: {over}}}",))
    whole = plan.expand(found).rows
    pairs = [(row.values["contact.friction"], row.values["start.x_mm"]) for row in whole]
    assert pairs == [(0, -1), (0, 0), (0, 1), (1, -1), (1, 0), (1, 1)]
    assert [*plan.expand(found, [4]).rows] == [whole[4]]


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("indenter.radius_mm: {uniform: [2, 6]}", "indenter.radius_mm: {uniform: [-6, -2]}",
         "batch.yaml:8:5: scene-00000: indenter.radius_mm: must be greater than 0 (got "),
        ("indenter.radius_mm: {uniform", "trajectory[0].press.depth_mm: {uniform",
         "batch.yaml:8:5: scene-00001: trajectory[0].press.depth_mm: must be less than the gel is thick, 4 mm (got "),
        ("contact.friction", "name", "batch.yaml:10:5: vary.over.name: name cannot be varied"),
        ("contact.friction", "sensor", "batch.yaml:10:13: vary.over.sensor: must be a choice of sensors' names"),
        ("contact.friction", "a b", "batch.yaml:10:5: vary.over.a b: 'a b' is not a path"),
        ("trajectory[0]", "trajectory[7]", "batch.yaml:9:5: scene-00000: trajectory[7].press.frames: [7] is past"),
        ("youngs_modulus_mpa: {loguniform: [0.05", "poissons_ratio: {loguniform: [0.49", "batch.yaml:11:5: scene-0000"),
        ("gel.layers[0].youngs_modulus_mpa: {loguniform: [0.05, 0.5]}", "leds[0].center_mm[1]: {uniform: [-15, -13]}",
         "batch.yaml:11:5: scene-00000: sensor.leds[0].center_mm: red: pokes out of the housing, at ("),
        ("youngs_modulus_mpa", "yongs_modulus_mpa",
         "batch.yaml:11:5: scene-00000: sensor.gel.layers[0].yongs_modulus_mpa"),
    ],
)  # fmt: skip
def test_a_bad_scene_is_named_with_its_path(tmp_path: Path, old: str, new: str, line: str):
    text = BATCH.replace("METHOD", "sobol").replace(old, new, 1).replace("0.49, 0.5]", "0.4999, 0.6]")
    (told,) = failure(tmp_path, text)
    assert told.startswith(line)


def test_a_grid_takes_no_uniform_and_has_an_end(tmp_path: Path):
    text = BATCH.replace("METHOD", "grid").replace("  samples: 7\n", "")
    assert len(failure(tmp_path, text)) == 3
    huge = "  over: {start.x_mm: {linspace: [0, 1, 2000]}, start.y_mm: {linspace: [0, 1, 2000]}}\n"
    assert "gives 4000000 scenes" in failure(tmp_path, text.split("  over:")[0] + huge)[0]


def test_a_fixed_value_that_a_varied_one_breaks_is_reported_where_it_stands(tmp_path: Path):
    old, new = "youngs_modulus_mpa: {loguniform: [0.05, 0.5]", "thickness_mm: {uniform: [0.75, 0.9]"
    text = BATCH.replace("METHOD", "sobol").replace(old, new)
    (told,) = failure(tmp_path, f"outputs: [force]\n{text}")  # for images, the LEDs would be left behind as well
    assert "quickstart.yaml:15:" in told
    assert "trajectory[0].press.depth_mm: must be less than the gel is thick" in told


def row_with(**changes: Any) -> Row:
    base = read(assets.recipe_path("quickstart"))
    recipe, wrong = validate(Recipe, base.recipe.document() | changes)
    assert recipe is not None, wrong
    return plan.expand(checked(recipe, base.sensor)).rows[0]


def test_a_key_changes_with_any_input_and_with_nothing_else():
    row = row_with()
    assert row.key == row_with().key == plan.load(assets.recipe_path("quickstart")).rows[0].key
    assert len(row.key) == 64
    assert KEY_FORMAT == schema.BUNDLE_FORMAT
    others = [
        row_with(contact={"friction": 0.7}),
        row_with(outputs=["force"]),
        row_with(quality="draft"),
        plan.load(assets.recipe_path("quickstart"), ["sensor.camera.exposure=9.5"]).rows[0],
        Row(1, row.name, row.seed, row.recipe, row.sensor),
        Row(row.index, row.name, row.seed, row.recipe, row.sensor.model_copy(update={"name": "edited file"})),
        Row(row.index, row.name, row.seed + 1, row.recipe, row.sensor),
    ]
    assert len({row.key, *(other.key for other in others)}) == len(others) + 1


def test_scene_seeds_do_not_repeat():
    seeds = {scene_seed(seed, index) for seed in range(20) for index in range(200)}
    assert len(seeds) > 3990


def test_every_method_is_drawn():
    assert set(get_args(get_args(Vary.model_fields["method"].annotation)[0])) == {*METHODS, "grid"}
