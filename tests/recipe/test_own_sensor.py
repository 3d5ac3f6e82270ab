"""A sensor of one's own: copied from a shipped one, changed, looked at; sizes that no gel has are warned about."""

import json
from pathlib import Path

import pytest
from helpers.command import tacgen_

from tacgen.recipe import assets, loading, plan
from tacgen.sensor.model import Sensor
from tacgen.sensor.usual_values import assumed, unusual

KEY = "sensor.gel.layers[0].youngs_modulus_mpa"
QUICKSTART = assets.recipe_path("quickstart")


@pytest.mark.parametrize("name", assets.list_sensors())
def test_a_copy_of_every_shipped_sensor_is_that_sensor(name: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    done = tacgen_("init", "--sensor", str(path), "--from", name)
    assert done.exit_code == 0, done.stderr
    mine, _ = loading.read_sensor(path)
    theirs, _ = loading.read_sensor(assets.sensor_path(name))
    assert (mine.name, mine.base, assumed(mine)) == ("mine", name, [])
    assert mine.model_copy(update={"name": name, "base": None}) == theirs
    assert "#" in path.read_text().split("\n", 3)[1], "comments are kept"
    assert not list(unusual(theirs.gel))


def test_numbers_that_differ_from_the_copied_file_are_assumed(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    tacgen_("init", "--sensor", str(path), "--from", "gelsight_mini")
    text = path.read_text().replace("youngs_modulus_mpa: 0.432", "youngs_modulus_mpa: 0.2")
    path.write_text(text.replace("diameter_mm: 0.74", "diameter_mm: 0.7").replace("7 x 9 grid,", "our print,"))
    mine, _ = loading.read_sensor(path)
    assert assumed(mine) == ["gel.layers[0]: assumed: youngs_modulus_mpa; the rest as in gelsight_mini"]
    assert mine.markers is not None
    assert mine.markers.source.startswith("our print"), "a source of one's own stays"
    said = tacgen_("validate", str(path)).stdout
    assert "note: gel.layers[0]: assumed: youngs_modulus_mpa; the rest as in gelsight_mini\n" in said
    shown = tacgen_("sensor", "show", str(path)).stdout
    assert "gel.layers[0]: assumed: youngs_modulus_mpa" in shown
    assert "youngs_modulus_mpa  0.2 MPa\n" in shown
    recipe = tmp_path / "r.yaml"
    recipe.write_text("extends: quickstart\nsensor: mine.yaml\n")
    (row,) = plan.load(recipe).rows
    assert row.sensor_document()["gel"]["layers"][0]["source"].startswith("assumed: ")


def test_a_base_that_is_no_shipped_sensor_is_told(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    tacgen_("init", "--sensor", str(path), "--from", "digit")
    path.write_text(path.read_text().replace("base: digit", "base: digitt"))
    done = tacgen_("validate", str(path))
    assert done.exit_code == 2
    assert "base: no shipped sensor is called 'digitt', did you mean digit?" in done.stderr


@pytest.mark.parametrize("name", ["batch", "replay"])
def test_a_copied_recipe_brings_what_it_names(name: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    done = tacgen_("init", str(path), "--from", name)
    assert done.exit_code == 0, done.stderr
    assert len(plan.load(path).rows) == len(plan.load(assets.recipe_path(name)).rows)


def test_show_has_every_number_with_its_unit_and_source() -> None:
    found = json.loads(tacgen_("sensor", "show", "gelsight_mini", "--json").stdout)
    rows = {row["path"]: row for row in found["values"]}
    sensor, _ = loading.read_sensor(assets.sensor_path("gelsight_mini"))
    assert rows["gel.width_mm"] == {
        "path": "gel.width_mm", "value": 25.25, "unit": "mm", "source": sensor.gel.source, "default": False,
    }  # fmt: skip
    assert rows["camera.mm_per_px"]["unit"] == "mm/px"
    assert rows["leds[1].radiance"]["value"] == list(sensor.leds[1].radiance if sensor.leds else ())
    assert rows["leds[0].power"]["default"]
    assert "camera.noise.read" in rows
    assert not [path for path in rows if path.endswith("source")]
    assert tacgen_("sensor", "show", "digit", "--yaml").stdout == assets.sensor_path("digit").read_text()
    assert tacgen_("sensor", "show", "digits").stderr == "no sensor is called 'digits'; did you mean digit?\n"


def test_a_picture_that_is_larger_than_the_pad_is_told(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    tacgen_("init", "--sensor", str(path), "--from", "gelsight_mini")
    assert tacgen_("validate", str(path)).stderr == ""
    path.write_text(path.read_text().replace("width_px: 320", "width_px: 500"))
    said = tacgen_("validate", str(path)).stderr
    assert "camera.mm_per_px: the picture shows 31.7 x 15.2 mm, which is not all on the pad of 25.25 x 20.75 mm" in said


def test_a_radius_in_metres_is_told_in_the_error() -> None:
    said = tacgen_("validate", "quickstart", "--set", "indenter.radius_mm=0.003").stderr
    assert "lengths are in mm: 3 mm if it is in m?" in said
    assert "edge_mm" not in said


def test_usual_recipes_have_no_such_warning() -> None:
    for name in assets.list_recipes():
        few = ["vary.samples=4"] if "\n  samples:" in assets.recipe_path(name).read_text() else []
        made = plan.load(assets.recipe_path(name), few)
        assert made.rows[0].recipe.name == name
        told = ("very small", "a coefficient of", "into a gel")
        assert not [line for line in made.warnings if any(text in line for text in told)], name


METRES = "mm is very small; lengths are in mm: "
GELS = "MPa; that of gels is 0.005 to 5, and moduli are in MPa"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("trajectory[0].press.depth_mm=0.001", f"0.001 {METRES}1 mm if it is in m?"),
        ("trajectory[1].slide.x_mm=0.0015", f"0.0015 {METRES}1.5 mm if it is in m?"),
        ("indenter={shape: cylinder, radius_mm: 3, fillet_mm: 0.0005}", f"0.0005 {METRES}0.5 mm if it is in m?"),
        ("contact.friction=60", "contact.friction: a coefficient of 60; that of gels is at most about 3"),
        ("contact.friction=3", ""),
        ("trajectory[0].press.depth_mm=3.5",
         "trajectory[0].press.depth_mm: presses 3.5 mm into a gel 4 mm thick: forces so deep are uncertain"),
        ("trajectory[0].press.depth_mm=2.8", ""),
        ("vary={samples: 3, over: {contact.friction: {uniform: [50, 60]}}}",
         "contact.friction: a coefficient of 55.7895; that of gels is at most about 3 (and 2 more scenes)"),
        (f"{KEY}=200", f"gel.layers[0].youngs_modulus_mpa: a Young's modulus of 200 {GELS}: 0.2 MPa if it is in kPa?"),
        (f"{KEY}=410000", f"410000 {GELS}: 0.41 MPa if it is in Pa?"),
        (f"{KEY}=0.0004", f"0.0004 {GELS}"),
    ],
)  # fmt: skip
def test_what_is_unusual_is_told_in_one_line_where_it_stands(change: str, says: str) -> None:
    told = plan.load(QUICKSTART, [change]).warnings
    assert len(told) == bool(says)
    assert all(line.startswith(f"--set {change}: ") and line.endswith(f" {says}") for line in told), told


def test_a_gel_measured_in_metres_is_told() -> None:
    gel = loading.read_sensor(assets.sensor_path("gelsight_mini"))[0].gel
    layers = [layer.model_copy(update={"thickness_mm": layer.thickness_mm / 1000}) for layer in gel.layers]
    sizes = {"width_mm": gel.width_mm / 1000, "height_mm": gel.height_mm / 1000, "layers": layers}
    told = [f"{p.path[-1]}: {p.message}" for p in unusual(gel.model_copy(update=sizes))]
    assert told == [
        "width_mm: a gel of 0.02525 mm; gels have 2 to 200, and lengths are in mm: 25.25 mm if it is in m?",
        "height_mm: a gel of 0.02075 mm; gels have 2 to 200, and lengths are in mm: 20.75 mm if it is in m?",
        "thickness_mm: a gel 0.004 mm thick; gels have 0.2 to 100, and lengths are in mm: 4 mm if it is in m?",
    ]


@pytest.mark.parametrize(
    ("law", "key"),
    [
        ({"law": "mooney_rivlin", "c10_mpa": 50.0, "c01_mpa": 0.0, "poissons_ratio": 0.49}, "c10_mpa"),
        ({"law": "yeoh", "c10_mpa": 50.0, "poissons_ratio": 0.49}, "c10_mpa"),
        ({"law": "stable_neo_hooke", "youngs_modulus_mpa": 300.0, "poissons_ratio": 0.49}, "youngs_modulus_mpa"),
    ],
)
def test_every_law_has_a_modulus(law: dict[str, object], key: str) -> None:
    sensor = loading.read_sensor(assets.sensor_path("digit"))[0]
    plain = sensor.model_dump(mode="json", exclude_none=True)
    plain["gel"]["layers"] = [{"name": "a", "thickness_mm": 4.06, **law}]
    (found,) = unusual(Sensor.model_validate(plain).gel)
    assert found.path == ("gel", "layers", 0, key)
    assert "300 MPa" in found.message


def test_moduli_that_are_drawn_are_told_once(tmp_path: Path) -> None:
    vary = f"{{method: grid, over: {{'{KEY}': {{choice: [0.3, 200, 150]}}}}}}"
    (tmp_path / "r.yaml").write_text(f"extends: {QUICKSTART}\nname: r\nvary: {vary}\n")
    (line,) = plan.load(tmp_path / "r.yaml").warnings
    assert line.startswith(f"{tmp_path}/r.yaml:3:")
    assert "scene-00001: sensor.gel.layers[0].youngs_modulus_mpa: a Young's modulus of 200 MPa" in line
    assert line.endswith("(and 1 more scenes)")


def test_the_other_finger_of_a_grasp_is_looked_at_too(tmp_path: Path) -> None:
    stiff = assets.sensor_path("digit").read_text().replace("youngs_modulus_mpa: 0.41", "youngs_modulus_mpa: 410")
    (tmp_path / "stiff.yaml").write_text(stiff)
    found = plan.load(assets.recipe_path("grasp"), [f"grasp.right={tmp_path}/stiff.yaml"]).warnings
    assert [line.split(": ")[0] for line in found] == ["digit"]
