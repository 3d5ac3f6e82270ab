"""Optics that cannot be are refused, each in one line that names the key."""

from typing import Any

import pytest
from helpers.tiny import PLAIN, cloudy, sensor

from tacgen.recipe import assets, loading, sensor_checks
from tacgen.sensor.model import Sensor
from tacgen.sensor.optics_checks import problems
from tacgen.sensor.yaml_source import format_path, parse_path, put

Data = dict[str, Any]


def led(**changes: Any) -> list[Data]:
    """The tiny sensor's LEDs, the first one changed."""
    return [{**PLAIN["leds"][0], **changes}, *PLAIN["leds"][1:]]


def test_sound_sensors_have_no_problems():
    assert list(problems(sensor())) == []
    assert list(problems(cloudy())) == []


@pytest.mark.parametrize(
    ("led_changes", "key", "says"),
    [
        ({"center_mm": [0, -4.9, -0.5]}, "center_mm", "red: reaches into the coating, at (-4.5, -4.9, 0.3)"),
        ({"center_mm": [0, -5.2, -2]}, "center_mm", "red: pokes out of the housing"),
        ({"center_mm": [2, -4.9, -2]}, "center_mm", "red: pokes out of the housing"),
        ({"center_mm": [0, -4.9, -4.9]}, "center_mm", "red: pokes out of the plate, whose air face is at z = -5"),
        ({"center_mm": [0, -4.9, -7]}, "center_mm", "red: lies in the air under the plate (z < -5)"),
        ({"normal": [0, 0, 1]}, "up", "red: normal (0, 0, 1) and up (0, 0, 1) must be neither zero nor parallel"),
        ({"normal": [0, 0, 0]}, "normal", "must be neither zero nor parallel"),
    ],
)
def test_an_led_outside_the_housing_is_refused(led_changes: Data, key: str, says: str):
    found = list(problems(sensor(leds=led(**led_changes))))
    assert [p.path for p in found] == [("leds", 0, key)]
    assert says in found[0].message


@pytest.mark.parametrize(
    ("dots", "keys"),
    [
        ({"columns": 7}, ["columns"]),
        ({"rows": 9}, ["rows"]),
        ({"offset_mm": [3.5, 2.9]}, []),
        ({"offset_mm": [-3.7, 3.1]}, ["columns", "rows"]),  # 4.8 and 4 mm of dots on 12 and 10 mm
        ({"rings": 3, "pitch_mm": 1.9}, []),
        ({"rings": 3, "pitch_mm": 1.95}, ["rings"]),  # 11.7 mm across of 12, and 10.13 of 10
    ],
)
def test_dots_that_do_not_fit(dots: Data, keys: list[str]):
    looks = {"diameter_mm": 0.9, "albedo": 0.03}
    markers = {"layout": "hexagonal", **looks, **dots} if "rings" in dots else {**PLAIN["markers"], **dots}
    model = Sensor.model_validate(PLAIN | {"markers": markers})
    assert [p.path for p in problems(model)] == [("markers", key) for key in keys]


def test_beside_a_round_end_is_outside():
    rounded = {"corner_radius_mm": 0.0, "outline": {"shape": "stadium_end", "end": "-y", "source": "test"}}
    corner = led(center_mm=[5.0, -4.0, -2], size_mm=[0.5, 0.5])
    assert list(problems(sensor(leds=corner))) == []
    assert "pokes out of the housing" in next(problems(sensor(gel=rounded, leds=corner))).message


@pytest.mark.parametrize(
    ("layers", "says"),
    [
        ([{}, {"scattering": {"extinction_per_mm": 1, "albedo": (1, 1, 1), "source": "t"}}], "must be the only one"),
        ([{}, {"opaque": True}, {"scattering": {"extinction_per_mm": 1, "albedo": (1, 1, 1), "source": "t"}}],
         "no light comes here"),
    ],
)  # fmt: skip
def test_layers_that_hide_each_other(layers: list[Data], says: str):
    plain = PLAIN["gel"]["layers"][0] | {"thickness_mm": 1.0}
    found = list(problems(sensor(gel={"layers": [plain | layer for layer in layers]}, markers=None)))
    assert says in found[0].message


def test_a_steeper_dome_comes_down_to_the_lights():
    for radius, hit in ((30, []), (12, [0, 1])):
        gel = {"dome": {"radius_x_mm": radius, "radius_y_mm": radius, "source": "t"}}
        found = list(problems(sensor(gel=gel, markers=None)))
        assert [p.path for p in found] == [("leds", k, "center_mm") for k in hit]
        assert all("reaches into the coating" in p.message for p in found)


def test_light_is_followed_through_one_clear_layer_under_a_dome():
    gel = {"dome": {"radius_x_mm": 30, "radius_y_mm": 60, "source": "t"}}
    one = PLAIN["gel"]["layers"][0]
    half = one | {"thickness_mm": one["thickness_mm"] / 2}
    assert list(problems(sensor(gel=gel, markers=None))) == []
    (found,) = problems(sensor(gel=gel | {"layers": [half, half]}, markers=None))
    assert found.path == ("gel", "dome")


def test_markers_under_a_scattering_layer_are_refused():
    assert [p.path for p in problems(cloudy(markers=PLAIN["markers"]))] == [("markers",)]


@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "ninedtact"])
@pytest.mark.parametrize(
    ("path", "value", "key"),
    [
        ("leds[0].center_mm", [0.0, 0.0, 0.0], "leds[0].center_mm"),  # in the coating
        ("leds[0].center_mm", [0.0, 0.0, -40.0], "leds[0].center_mm"),  # behind the camera, or the plate
        ("leds[0].center_mm[0]", 60.0, "leds[0].center_mm"),  # out of the housing
        ("leds[0].up", [0.0, 0.0, 0.0], "leds[0].up"),
        ("camera.distance_mm", -1.0, "camera.distance_mm"),  # in the plate
        ("camera.center_mm", [30.0, 0.0], "camera.center_mm"),
        ("camera.tilt_deg", [30.0, 0.0], "camera.tilt_deg[0]"),
        ("camera.vignette_mm", [15.0, 0.0, 15.0], "camera.vignette_mm[1]"),
        ("camera.colour_matrix", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]], "camera.colour_matrix"),
    ],
)
def test_bad_optics_of_the_shipped_sensors_are_one_line(name: str, path: str, value: Any, key: str):
    data = put(loading.read_sensor(assets.sensor_path(name))[1].data, parse_path(path), value)
    found, wrong = sensor_checks.check(data)
    assert found is None
    assert len({(p.path, p.message) for p in wrong}) == 1
    assert format_path(wrong[0].path) == key
    assert "\n" not in wrong[0].message


OUT_OF_RANGE = {
    "leds[0].size_mm[1]": -1.0, "leds[0].power": -0.1, "leds[0].radiance": -1.0, "gel.layers[0].refractive_index": 0.9,
    "gel.layers[0].thickness_mm": 0.0, "gel.layers[0].poissons_ratio": 0.5, "plate.refractive_index": 0.9,
    "plate.thickness_mm": -4.0, "camera.mm_per_px": 0.0, "camera.exposure": 0.0, "camera.ambient": -0.1,
    "coating.albedo": 1.2, "coating.roughness": 0.0, "coating.specular": 1.1, "walls.albedo": -0.1,
    "walls.margin_mm": -1.0,
}  # fmt: skip


@pytest.mark.parametrize("path", OUT_OF_RANGE)
def test_numbers_out_of_their_range_are_refused(path: str):
    found, wrong = sensor_checks.check(put(PLAIN, parse_path(path), OUT_OF_RANGE[path]))
    assert found is None
    assert {format_path(problem.path) for problem in wrong} == {path}
