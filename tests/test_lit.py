"""Optics that cannot be are refused, each in one line that names the key."""

from typing import Any

import pytest
from optics.tiny import PLAIN, cloudy, sensor

from tacgen import load
from tacgen.lit import problems

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
        ({"see_through": True}, "see_through", "red: is for light that enters from the air under the plate"),
    ],
)
def test_a_light_where_none_can_be(led_changes: Data, key: str, says: str):
    found = list(problems(sensor(leds=led(**led_changes))))
    assert [p.path for p in found] == [("leds", 0, key)]
    assert says in found[0].message


def test_a_light_behind_the_camera_and_an_axis_beside_the_pad():
    panel = cloudy().leds[0].model_dump() | {"center_mm": [0, 0, -30]}
    assert "lies behind the camera, which is at z = -16.3" in next(problems(cloudy(leds=[panel]))).message
    found = list(problems(sensor(camera={"center_mm": [7, 0]})))
    assert [p.path for p in found] == [("camera", "center_mm")]


def test_beside_a_round_end_is_outside():
    rounded = {"corner_radius_mm": 0.0, "outline": {"shape": "stadium_end", "end": "-y", "source": "test"}}
    corner = led(center_mm=[5.0, -4.0, -2], size_mm=[0.5, 0.5])
    assert list(problems(sensor(leds=corner))) == []
    assert "pokes out of the housing" in next(problems(sensor(gel=rounded, leds=corner))).message


@pytest.mark.parametrize(
    ("layers", "says"),
    [
        ([{"opaque": True}], "hides the coating"),
        ([{}, {"scattering": {"extinction_per_mm": 1, "albedo": (1, 1, 1), "source": "t"}}], "must be the only one"),
        (
            [{}, {"opaque": True}, {"scattering": {"extinction_per_mm": 1, "albedo": (1, 1, 1), "source": "t"}}],
            "no light comes here",
        ),
    ],
)
def test_layers_that_hide_each_other(layers: list[Data], says: str):
    plain = PLAIN["gel"]["layers"][0] | {"thickness_mm": 1.0}
    found = list(problems(sensor(gel={"layers": [plain | layer for layer in layers]}, markers=None)))
    assert says in found[0].message


def test_dots_under_a_cloud_are_refused():
    assert [p.path for p in problems(cloudy(markers=PLAIN["markers"]))] == [("markers",)]


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("plate", {"refractive_index": 0.9}),
        ("plate", {"thickness_mm": -1}),
        ("camera", {"distance_mm": -1.0}),
        ("coating", {"roughness": 0.0}),
        ("leds", led(size_mm=[-1, 1])),
    ],
)
def test_numbers_that_no_matter_has(part: str, value: Any):
    data = {**PLAIN, part: {**PLAIN[part], **value} if isinstance(value, dict) else value}
    found, wrong = load.check_sensor(data)
    assert found is None
    assert len(wrong) == 1
    assert "\n" not in wrong[0].message
