"""DIGIT's file against photographs of a real unit: its colours, its dents and their shadow fans."""

import numpy as np
import pytest
from helpers import reality

from tacgen.render import images, mitsuba_variants

PHOTOS = reality.REFERENCE / "digit"

pytestmark = reality.needs("digit", "background.png")


@pytest.fixture(scope="module")
def compare():
    return reality.compare()


@pytest.fixture(scope="module")
def sensor():
    return reality.sensor("digit")


@pytest.fixture(scope="module")
def renderer(sensor):
    return images.Renderer(sensor, 16, 0, markers=False, variant=mitsuba_variants.SCALAR)


@pytest.fixture(scope="module")
def untouched(renderer):
    return renderer.develop(renderer.flat())


def test_the_untouched_picture_is_like_the_photograph(compare, untouched):
    real = compare.load(PHOTOS / "background.png")
    assert untouched.mean(axis=(0, 1)) == pytest.approx(real.mean(axis=(0, 1)), abs=5)
    assert compare.similarity(real, untouched, np.ones(real.shape[:2], bool)) > 0.85
    left, right = untouched[:, :60].mean(axis=(0, 1)), untouched[:, -60:].mean(axis=(0, 1))
    assert left[0] > 1.3 * left[1]  # red at the left, where the dome turns to the red LED at the right
    assert right[1] > 1.3 * right[0]


def test_dents_are_like_the_photographed_ones(compare, renderer, sensor):
    found = []
    for name in ("sphere_0005.png", "sphere_0010.png", "sphere_0036.png"):
        press = compare.digit_press(PHOTOS, name)
        made = renderer.develop(renderer.image(compare.press_faces.face(sensor, press, {})))
        down, across = np.mgrid[:320, :240] + 0.5
        near = np.hypot(across - press.center[0], down - press.center[1]) < 60
        found.append(compare.similarity(press.picture, made, near))
    assert min(found) > 0.79, found
    assert np.mean(found) > 0.81, found


def test_each_led_casts_its_fan_where_the_real_one_does(compare, renderer, sensor, untouched):
    """Beyond the dent the blue falls upward, the green to the lower right, the red to the lower left."""
    press = compare.digit_press(PHOTOS, "sphere_0005.png")
    real = press.picture.astype(float) - compare.load(PHOTOS / "background.png")
    made = renderer.develop(renderer.image(compare.press_faces.face(sensor, press, {}))).astype(float) - untouched
    middle = np.array(press.center)
    down, across = np.mgrid[:320, :240] + 0.5
    for channel, way in ((2, (0.0, -1.0)), (1, (0.8, 0.6)), (0, (-0.8, 0.6))):
        at = middle + 44 * np.array(way)
        spot = np.hypot(across - at[0], down - at[1]) < 8
        for change in (real, made):
            lost = change[spot].mean(axis=0)
            assert lost[channel] < -6, (channel, lost)
            assert lost[channel] == lost.min(), (channel, lost)
