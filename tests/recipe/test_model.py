"""Recipes: every problem at once and where it stands; what is read can be written and read again."""

import io
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel
from pydantic_core import PydanticUndefined
from ruamel.yaml import YAML

from tacgen.base.errors import UserError
from tacgen.outputs import OUTPUT_NAMES
from tacgen.recipe import assets, sensor_checks
from tacgen.recipe.indenters import INDENTER_SHAPES
from tacgen.recipe.loading import read
from tacgen.recipe.model import QUALITIES, Recipe
from tacgen.sensor import yaml_source
from tacgen.sensor.model import LIGHT_FIELDS, Sensor
from tacgen.sensor.validation_messages import validate
from tacgen.sensor.yaml_source import CHOICE_KEYS, Source, parse, put

GOOD = """\
tacgen: 1
name: test
sensor: gelsight_mini
indenter:
  shape: sphere
  radius_mm: 4.0
trajectory:
  - press: {depth_mm: 1.0, frames: 5}
  - slide: {x_mm: 1.0, frames: 5}
outputs: [force]
"""
BALL = "indenter:\n  shape: sphere\n  radius_mm: 4.0"


def lines_of(tmp_path: Path, text: str, sets: tuple[str, ...] = ()) -> list[str]:
    """The lines of the error that a recipe gives, without the excerpts."""
    path = tmp_path / "recipe.yaml"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        read(path, sets)
    return [line.removeprefix(f"{tmp_path}/") for line in caught.value.lines if not line.startswith("    ")]


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("depth_mm: 1.0", "depth_mm: -1", "8:23: trajectory[0].press.depth_mm: must be greater than 0 (got -1)"),
        ("depth_mm: 1.0", "depth_mm: .nan", "8:23: trajectory[0].press.depth_mm: must be a finite number (got nan)"),
        ("depth_mm: 1.0", 'depth_mm: "1"', "8:23: trajectory[0].press.depth_mm: must be a number (got '1')"),
        ("depth_mm: 1.0, ", "", "8:12: trajectory[0].press: must hold exactly one aim of depth_mm, force_n (got none)"),
        ("depth_mm: 1.0", "depth_mm: 1.0, force_n: 2", "8:12: trajectory[0].press: must hold exactly one aim of"),
        ("slide: {x_mm: 1.0", "tilt: {angle_deg: 90", "9:23: trajectory[1].tilt.angle_deg: must be less than 90"),
        ("frames: 5}\n  - slide", "frames: 5.5}\n  - slide", "8:36: trajectory[0].press.frames: must be a whole"),
        ("press:", "perss:", "8:5: trajectory[0].perss: unknown key, did you mean press?"),
        ("radius_mm: 4.0", "raduis_mm: 4.0", "6:3: indenter.raduis_mm: unknown key, did you mean radius_mm?"),
        ("radius_mm: 4.0", "radius_mm:", "6:3: indenter.radius_mm: must be a number (got nothing)"),
        ("shape: sphere", "shape: sphre", f"5:10: indenter.shape: must be one of {', '.join(INDENTER_SHAPES)}"),
        ("  shape: sphere\n", "", "4:1: indenter.shape: is missing"),
        ("outputs: [force]", "outputs: [forse]", "10:11: outputs[0]: must be one of force, traction, events"),
        ("outputs: [force]", "outputs: []", "10:10: outputs: must name at least one of force"),
        ("outputs: [force]", "outputs: force", "10:10: outputs: must be a list (got 'force')"),
        ("name: test", "name: a test", "2:7: name: must be letters, digits, dots, dashes and underscores only"),
        ("tacgen: 1", "tacgen: 2", "1:9: tacgen: must be 1 (got 2)"),
        ("tacgen: 1\n", "", "1:1: tacgen: is missing"),
        ("sensor: gelsight_mini", "sensor: gelsight_mimi", "3:9: sensor: no sensor is called 'gelsight_mimi'; did you"),
        ("sensor: gelsight_mini", "sensor: ./mine.yaml", "3:9: sensor: "),
        ("outputs:", "quality: darft\noutputs:", "10:10: quality: must be one of draft, default, reference"),
        ("outputs:", "start: {clearance_mm: -1}\noutputs:",
         "10:23: start.clearance_mm: must be at least 0 (got -1): the"),
        ("outputs:", "folds: stop\noutputs:", "10:8: folds: must be one of keep, end (got 'stop')"),
        # against the sensor
        ("depth_mm: 1.0", "depth_mm: 4", "8:23: trajectory[0].press.depth_mm: must be less than the gel is thick"),
        ("outputs:", "start: {x_mm: 13}\noutputs:", "10:15: start.x_mm: the indenter would start beside the pad"),
        ("outputs:", "start: {x_mm: 12.5, y_mm: 10.3}\noutputs:", "10:8: start: the indenter would start beside"),
        ("x_mm: 1.0", "x_mm: 13", "9:12: trajectory[1].slide: would carry the indenter's axis off the pad"),
        # radii that are possible
        (BALL, "indenter: {shape: cylinder, radius_mm: 3, fillet_mm: 4}", "4:54: indenter.fillet_mm: must be at most"),
        (BALL, "indenter: {shape: cylinder, radius_mm: 0.1}", "4:1: indenter.fillet_mm: must be at most radius_mm"),
        (BALL, "indenter: {shape: cylinder, radius_mm: 3, length_mm: 0.3}",
         "4:54: indenter.length_mm: must be at least twice fillet_mm, 0.4 (got 0.3)"),
        (BALL, "indenter: {shape: cylinder, radius_mm: 3, fillet_mm: 0.1, length_mm: 0.3}",
         "4:70: indenter.length_mm: is too thin for a mesh of edge 0.36 mm"),
        (BALL, "indenter: {shape: box, size_x_mm: 1, size_y_mm: 3, fillet_mm: 0.6}",
         "4:63: indenter.fillet_mm: must be at most half the"),
        (BALL, "indenter: {shape: torus, radius_mm: 2, tube_radius_mm: 2}",
         "4:56: indenter.tube_radius_mm: must be less than radius_mm, 2"),
        (BALL, "indenter: {shape: capsule, radius_mm: 1, length_mm: -2}", "4:53: indenter.length_mm: must be greater"),
        (BALL, "indenter: {shape: wedge, half_angle_deg: 40, tip_radius_mm: 0.5}",
         "4:1: indenter.length_mm: is missing"),
        (BALL, "indenter: {shape: wedge, half_angle_deg: 40, tip_radius_mm: 0.5, length_mm: 0.9}",
         "4:77: indenter.length_mm: must be at least twice"),
        # a batch that makes sense
        ("outputs:", "vary: {method: sobol, over: {a: {choice: [1]}}}\noutputs:",
         "10:1: vary.samples: is missing: how many scenes to draw by sobol"),
        ("outputs:", "vary: {method: grid, samples: 3, over: {a: {choice: [1]}}}\noutputs:",
         "10:31: vary.samples: must be left out: a grid has as many"),
        ("outputs:", "vary: {samples: 3, over: {a: {uniform: [2, 1]}}}\noutputs:",
         "10:40: vary.over.a.uniform: must be [low, high] with low < high"),
        ("outputs:", "vary: {samples: 3, over: {a: {}}}\noutputs:", "10:30: vary.over.a: must hold exactly one"),
        ("outputs:", "vary: {method: soboll, samples: 3, over: {a: {choice: [1]}}}\noutputs:",
         "10:16: vary.method: must be one of grid, random, sobol, lhs"),
    ],
)  # fmt: skip
def test_a_mistake_is_reported_where_it_stands(tmp_path: Path, old: str, new: str, line: str):
    assert old in GOOD
    (told,) = lines_of(tmp_path, GOOD.replace(old, new, 1))
    assert told.startswith(f"recipe.yaml:{line}")


def test_all_problems_come_at_once_and_in_order(tmp_path: Path):
    text = GOOD.replace("depth_mm: 1.0", "depth_mm: -1").replace("radius_mm", "raduis_mm").replace("force", "rbg")
    told = lines_of(tmp_path, text + "colour: 1\n", ("sensor.gel.layers[0].poissons_ratio=0.5",))
    assert told[0].startswith("--set sensor.gel.layers[0].poissons_ratio=0.5: ")
    keys = ["indenter.raduis_mm", "trajectory[0].press.depth_mm", "outputs[0]", "colour"]
    assert [line.split(": ")[1] for line in told[1:]] == keys


def sensor_text() -> str:
    return assets.sensor_path("gelsight_mini").read_text()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("corner_radius_mm: 1.5", "corner_radius_mm: 15", "gel.corner_radius_mm: must be at most half the pad"),
        ("mm_per_px: 0.0634", "mm_per_px: 60", "camera.mm_per_px: leaves 0.35 pixels for the gel, 20.75 mm"),
        ("diameter_mm: 0.74", "diameter_mm: 7.4", "markers.diameter_mm: dots of 7.4 mm touch at a pitch of 1.94 mm"),
        ("columns: 9", "rings: 3", "markers.rings: is a key of layout: hexagonal, and layout is grid here"),
        ("law: neo_hooke", "c10_mpa: 1", "c10_mpa: is a key of law: mooney_rivlin and yeoh, and law is neo_hooke here"),
        ("youngs_modulus_mpa", "young_modulus_mpa", "unknown key, did you mean youngs_modulus_mpa?"),
        ("law: neo_hooke", "law: neo_hook", "(got 'neo_hook'), did you mean neo_hooke?"),
        ("  width_mm: 25.25", "  width_mm: 25.25\n  width_mm: 25.25", "width_mm: this key is there twice"),
        ("gel:\n", "gel: [\n", "mine.yaml:"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_sensor_file_is_reported_in_the_sensor_file(tmp_path: Path, old: str, new: str, says: str):
    assert old in sensor_text()
    (tmp_path / "mine.yaml").write_text(sensor_text().replace(old, new, 1))
    told = lines_of(tmp_path, GOOD.replace("gelsight_mini", "./mine.yaml"))
    assert all(line.startswith("mine.yaml:") and line.split(":")[1].isdigit() for line in told)
    assert any(says in line for line in told)


def test_layers_in_the_wrong_order_are_reported_without_lights_too():
    """An opaque skin at the base: maps, which the camera takes through the layers, ended in a traceback."""
    data = yaml_source.load(assets.sensor_path("gelsight_mini")).data
    unlit = {key: value for key, value in data.items() if key not in LIGHT_FIELDS}
    unlit["gel"]["layers"][0]["opaque"] = True
    _, (wrong,) = sensor_checks.check(unlit)
    assert wrong.message.startswith("hides the coating: layers are from the bonded base outward")


def test_a_broken_sensor_file_does_not_hide_the_recipe(tmp_path: Path):
    (tmp_path / "mine.yaml").write_text("gel: [")
    told = lines_of(tmp_path, GOOD.replace("gelsight_mini", "./mine.yaml").replace("depth_mm: 1.0", "depth_mm: -1"))
    assert len(told) == 2
    assert told[0].startswith("recipe.yaml:8:23")
    assert told[1].startswith("mine.yaml:1:")


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ("trajectory[0].press.frames=0", "must be at least 1 (got 0)"),
        ("trajectory[0].press={force_n: 0, frames: 1}", "force_n: must be greater than 0 (got 0)"),
        ("quality.spp=0", "must be at least 1 (got 0)"),
        ("indenter.radius_mm=-3", "must be greater than 0 (got -3)"),
        ("contact.friction=-1", "must be at least 0 (got -1)"),
        ("vary={samples: 0, over: {a: {choice: [1]}}}", "samples: must be at least 1 (got 0)"),
        ("vary={samples: 3, over: {}}", "over: must hold at least 1 (got 0)"),
        ("vary={samples: 3, over: {a: {loguniform: [0, 1]}}}", "loguniform[0]: must be greater than 0 (got 0)"),
        ("contact.frction=1", "contact.frction: unknown key, did you mean friction?; there are: friction"),
        ("contact.mu=1", "contact.mu: unknown key, did you mean friction?; there are: friction"),
        ("start.speed=1", "unknown key; there are: x_mm, y_mm, clearance_mm, yaw_deg, tilt_deg, tilt_axis_deg"),
        ("sensor.camera.dist=9", "response, noise, drift, jpeg_quality, source"),
        ("camera.distance_mm=9", "camera is a key of the sensor, did you mean sensor.camera.distance_mm?"),
        ("speed.mm=9", "uncertainty, may_miss, folds, outputs, quality, vary"),
        ("outputs=[depth]", "(got 'depth'), did you mean height?"),
        ("outputs=[image]", "(got 'image'), did you mean rgb?"),
        ("trajectory[5].hold.frames=1", "[5] is past the end: there are 2 entries, counted from 0"),
        ("name.x=1", "x needs a mapping, and there is 'test'"),
        ("indenter.radius_mm", "needs the form path=value, such as indenter.radius_mm=3"),
        ("in denter=3", "'in denter' is not a path such as trajectory[0].press.depth_mm"),
        ("outputs=[force", "expected ',' or ']', but got '<stream end>'"),
        ("sensor.gel.layers[0].thickness_mm=0.8", None),
        ("sensor.gel.layers[3].thickness_mm=0.5", "[3] is past the end: there are 1 entries, counted from 0"),
        ("sensor.gel.layers[0].poissons_ratio=0.6", "gel.layers[0].poissons_ratio: must be less than 0.5 (got 0.6)"),
    ],
)
def test_a_mistake_on_the_command_line_is_reported_there(tmp_path: Path, override: str, line: str | None):
    (told,) = lines_of(tmp_path, GOOD, (override,))
    if line is None:  # the press is too deep for the thinner gel: that stands in the recipe
        deep = "must be less than the gel is thick, 0.8"
        assert told.startswith(f"recipe.yaml:8:23: trajectory[0].press.depth_mm: {deep}")
    else:
        assert told.startswith(f"--set {override}: ")
        assert told.endswith(line)


def test_set_reaches_recipe_and_sensor(tmp_path: Path):
    path = tmp_path / "recipe.yaml"
    path.write_text(GOOD)
    sets = ["indenter={shape: box, size_x_mm: 3, size_y_mm: 2}", "contact.friction=0.5", "sensor.camera.exposure=2"]
    loaded = read(path, sets)
    assert loaded.recipe.indenter.shape == "box"
    assert loaded.recipe.contact.friction == 0.5
    assert loaded.sensor.camera.exposure == 2
    assert loaded.recipe.sensor_overrides == {"camera.exposure": 2}


def test_overrides_in_the_recipe_reach_the_sensor_and_point_back(tmp_path: Path):
    path = tmp_path / "recipe.yaml"
    path.write_text(GOOD + "sensor_overrides:\n  gel.layers[0].thickness_mm: 3.0\n  camera: {exposure: 2.0}\n")
    sensor = read(path).sensor
    assert (sensor.gel.layers[0].thickness_mm, sensor.camera.exposure) == (3.0, 2.0)
    assert sensor.camera.width_px == 320, "a mapping merges, it does not replace"
    (told,) = lines_of(tmp_path, GOOD + "sensor_overrides:\n  gel.layers[0].thickness_mm: -3.0\n")
    assert told == "recipe.yaml:12:31: gel.layers[0].thickness_mm: must be greater than 0 (got -3)"
    (told,) = lines_of(tmp_path, GOOD + "sensor_overrides: {'gel.layers[7].thickness_mm': 3.0}\n")
    assert told.startswith("recipe.yaml:11:20: ")


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ("markers: {layout: hexagonal, rings: 3, pitch_mm: 1.5, diameter_mm: 0.4, albedo: 0.1}", ""),
        ("markers: {layout: hexagonal, rings: 3, pitch_mm: 1.5}", "markers: lacks diameter_mm, albedo"),
        ("gel.layers[0]: {law: yeoh, name: a, thickness_mm: 4, c10_mpa: 0.1, bulk_modulus_mpa: 5}", ""),
        ("markers: {layout: grid, rows: 3}", ""),
        ("gel.layers[0]: {law: neo_hooke, youngs_modulus_mpa: 0.2}", ""),
    ],
)
def test_another_kind_of_part_replaces_it(tmp_path: Path, override: str, line: str):
    (tmp_path / "recipe.yaml").write_text(f"{GOOD}sensor_overrides:\n  {override}\n")
    if not line:
        read(tmp_path / "recipe.yaml")
    else:
        (told,) = lines_of(tmp_path, f"{GOOD}sensor_overrides:\n  {override}\n")
        assert told.endswith(line)


def test_tags_are_the_keys_that_choose_a_kind_of_part():
    found = dict[str, set[Any]]()

    def walk(model: type[BaseModel], seen: set[type[BaseModel]]) -> None:
        needed = model.model_json_schema().get("required", ())  # in a file; in Python a class has its own tag
        for name, field in model.model_fields.items():
            if get_origin(field.annotation) is Literal and name not in ("tacgen", "tacgen_sensor", "response", "folds"):
                found.setdefault(name, set()).add(PydanticUndefined if name in needed else field.get_default())
            for kind in _models(field.annotation):
                if kind not in seen:
                    walk(kind, seen | {kind})

    walk(Recipe, set())
    walk(Sensor, set())
    kinds = {name: defaults - {PydanticUndefined} for name, defaults in found.items()}
    one_of_a_kind = {"method", "units", "end", "up"}  # of one model only: they choose no other keys
    assert kinds.keys() - one_of_a_kind == CHOICE_KEYS.keys()
    assert {name: next(iter(kinds[name]), None) for name in CHOICE_KEYS} == CHOICE_KEYS


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for each in get_args(annotation) for model in _models(each)]


def test_extends_lays_one_recipe_over_another(tmp_path: Path):
    (tmp_path / "base.yaml").write_text(GOOD)
    path = tmp_path / "recipe.yaml"
    path.write_text("extends: base.yaml\nname: child\nindenter: {radius_mm: 2.0}\n")
    recipe = read(path).recipe
    assert (recipe.name, recipe.indenter.shape, recipe.indenter.radius_mm) == ("child", "sphere", 2.0)
    assert recipe.frames == 10
    (told,) = lines_of(tmp_path, "extends: base.yaml\nindenter: {radius_mm: -2.0}\n")
    assert told.startswith("recipe.yaml:2:23: indenter.radius_mm")
    (tmp_path / "base.yaml").write_text(GOOD.replace("depth_mm: 1.0", "depth_mm: -1"))
    (told,) = lines_of(tmp_path, "extends: base.yaml\n")
    assert told.startswith("base.yaml:8:23: trajectory[0].press.depth_mm")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("extends: recipe.yaml\n", "recipe.yaml is extended by this very recipe"),
        ("extends: nowhere.yaml\n", "no such recipe file: a relative path starts at the folder of the file"),
        ("extends: quikstart\n", "no recipe is called 'quikstart'; did you mean quickstart?"),
        ("extends: recipe\n", "no recipe is called 'recipe'; did you mean recipe.yaml?"),
        ("extends: 3\n", "must be the path of a recipe, or the name of a shipped one (got 3)"),
        ("- 1\n", "a recipe must be a mapping (got a list)"),
        ("", "a recipe must be a mapping (got nothing)"),
    ],
)
def test_errors_of_extends(tmp_path: Path, text: str, says: str):
    (told,) = lines_of(tmp_path, text)
    assert told.startswith("recipe.yaml:1:")
    assert says in told


@pytest.mark.parametrize("change", ["sensor.gel.width_mm=12", "sensor.markers.rows=12", "sensor.gel.height_mm=11"])
def test_markers_lie_on_the_gel(tmp_path: Path, change: str):
    (told,) = lines_of(tmp_path, GOOD.replace("[force]", "[markers]"), (change,))
    assert told.endswith("some of the sensor gelsight_mini would lie beside its gel: fewer, or closer ones")
    (tmp_path / "recipe.yaml").write_text(GOOD)
    assert read(tmp_path / "recipe.yaml", (change,)).sensor.markers, "which nothing asks for"


# -- generated recipes --

lengths = st.floats(0.01, 5).map(lambda x: round(x, 3))
angles = st.floats(-90, 90)
frames = st.integers(1, 20)


@st.composite
def indenters(draw: Any) -> dict[str, Any]:
    shape = draw(st.sampled_from(sorted(INDENTER_SHAPES)))
    fields: dict[str, Any] = {"shape": shape}
    if shape == "mesh":
        size = st.sampled_from(["scale", "size_mm"]).map(lambda name: {name: 2.5})
        return {**fields, "file": "hex_bolt", "up": draw(st.sampled_from(["+x", "-y", "+z"])), **draw(size)}
    for name in INDENTER_SHAPES[shape].model_fields:
        if name == "half_angle_deg":
            fields[name] = draw(st.floats(1, 89))
        elif name == "fillet_mm":
            fields[name] = draw(st.floats(0.001, 0.01))
        elif name == "tube_radius_mm":
            fields[name] = fields["radius_mm"] / 2
        elif name == "length_mm":
            fields[name] = 2 * fields.get("tip_radius_mm", 0.0) + draw(st.floats(0.1, 6))
        elif name != "shape":
            fields[name] = draw(st.floats(0.1, 6))
    return fields


segments = st.one_of(
    st.fixed_dictionaries({"depth_mm": lengths, "frames": frames}).map(lambda s: {"press": s}),
    st.fixed_dictionaries({"x_mm": angles, "frames": frames}, optional={"y_mm": angles}).map(lambda s: {"slide": s}),
    st.fixed_dictionaries({"angle_deg": angles, "frames": frames}).map(lambda s: {"twist": s}),
    st.fixed_dictionaries({"force_n": lengths, "frames": frames}).map(lambda s: {"press": s}),
    st.fixed_dictionaries({"angle_deg": st.floats(-89, 89), "frames": frames}).map(lambda s: {"tilt": s}),
    st.fixed_dictionaries({"frames": frames}).map(lambda s: {"hold": s}),
    st.fixed_dictionaries({"frames": frames}).map(lambda s: {"release": s}),
)
# ruamel's writer, by which these tests write, turns the line breaks of YAML 1.1 alone into spaces
texts = st.text(st.characters(codec="utf-8", exclude_characters="\x85\u2028\u2029"), max_size=4)
spreads = st.one_of(
    st.tuples(lengths, lengths).filter(lambda p: p[0] < p[1]).map(lambda p: {"uniform": list(p)}),
    st.lists(st.one_of(lengths, texts, st.booleans()), min_size=1, max_size=3).map(lambda c: {"choice": c}),
    st.tuples(lengths, lengths, st.integers(1, 9)).map(lambda p: {"linspace": list(p)}),
)
recipes = st.fixed_dictionaries(
    {
        "tacgen": st.just(1),
        "name": st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,20}", fullmatch=True),
        "sensor": st.just("gelsight_mini"),
        "indenter": indenters(),
        "trajectory": st.lists(segments, min_size=1, max_size=5),
        "outputs": st.lists(st.sampled_from(OUTPUT_NAMES), min_size=1, unique=True),
    },
    optional={
        "start": st.fixed_dictionaries({"x_mm": angles, "yaw_deg": angles, "tilt_deg": st.floats(0, 89)}),
        "contact": st.fixed_dictionaries({"friction": lengths}),
        "quality": st.one_of(st.sampled_from(sorted(QUALITIES)), st.just({"edge_mm": 0.5})),
        "vary": st.fixed_dictionaries(
            {"samples": st.integers(1, 99), "over": st.dictionaries(st.sampled_from("abc"), spreads, min_size=1)}
        ),
    },
)


def to_yaml(data: Any) -> str:
    text = io.StringIO()
    YAML(typ="rt").dump(data, text)
    return text.getvalue()


@settings(max_examples=25, deadline=None)
@given(recipes)
def test_a_recipe_survives_being_written_and_read(data: dict[str, Any]):
    recipe, wrong = validate(Recipe, data)
    assert recipe is not None, wrong
    text = to_yaml(recipe.document())
    again, wrong = validate(Recipe, parse(text, Source("r", tuple(text.splitlines()))).data)
    assert again == recipe, wrong


JUNK = (None, True, -1, 0, 1e308, float("nan"), "", "x", [], {}, {"a": 1}, [[]])


@pytest.mark.parametrize("value", JUNK, ids=repr)
def test_no_damage_to_a_recipe_is_a_crash(tmp_path: Path, value: Any):
    file = tmp_path / "recipe.yaml"
    for path in filter(None, parse(GOOD, Source("r")).spots):
        file.write_text(to_yaml(put(parse(GOOD, Source("r")).data, path, value)))
        try:
            read(file)
        except UserError as error:
            heads = [line for line in error.lines if not line.startswith("    ")]
            assert heads
            assert all(line.startswith(f"{file}:") and line.split(":")[1].isdigit() for line in heads), heads
