"""A modulus or a size that no gel has is warned about in one line: where, what is usual, in which unit."""

from pathlib import Path

import pytest

from tacgen.recipe import assets, loading, plan
from tacgen.sensor.model import Sensor
from tacgen.sensor.usual_values import unusual

KEY = "sensor.gel.layers[0].youngs_modulus_mpa"
QUICKSTART = assets.recipe_path("quickstart")


def told(*sets: str) -> tuple[str, ...]:
    return plan.load(QUICKSTART, sets).warnings


@pytest.mark.parametrize(
    ("modulus", "says"),
    [
        ("200", "200 MPa; that of gels is 0.005 to 5, and moduli are in MPa: 0.2 MPa if it is in kPa?"),
        ("410000", "410000 MPa; that of gels is 0.005 to 5, and moduli are in MPa: 0.41 MPa if it is in Pa?"),
        ("0.0004", "0.0004 MPa; that of gels is 0.005 to 5, and moduli are in MPa"),
    ],
)
def test_it_is_told_in_one_line(modulus: str, says: str) -> None:
    (line,) = told(f"{KEY}={modulus}")
    assert line.startswith(f"--set {KEY}={modulus}: gel.layers[0].youngs_modulus_mpa: ")
    assert line.endswith(says)
    assert "\n" not in line


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


def test_shipped_sensors_are_usual() -> None:
    for name in assets.list_sensors():
        assert not list(unusual(loading.read_sensor(assets.sensor_path(name))[0].gel)), name
