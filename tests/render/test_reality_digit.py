"""DIGIT's file against photographs of a real unit: its colours, its dents and their shadow fans."""

import numpy as np
import pytest
from helpers import reality

from benchmarks import photographs
from tacgen.calibrate import press_faces
from tacgen.render import images, mitsuba_variants

pytestmark = reality.needs("digit")


@pytest.fixture(scope="module")
def renderer():
    return images.Renderer(reality.sensor("digit"), 64, 0, markers=False, variant=mitsuba_variants.SCALAR)


@pytest.fixture(scope="module")
def untouched(renderer):
    return renderer.develop(renderer.flat())


def test_the_untouched_picture_is_like_the_photograph(untouched):
    real = photographs.unit("digit").untouched
    assert untouched.mean(axis=(0, 1)) == pytest.approx(real.mean(axis=(0, 1)), abs=5)
    left, right = untouched[:, :60].mean(axis=(0, 1)), untouched[:, -60:].mean(axis=(0, 1))
    assert left[0] > 1.3 * left[1]  # red at the left, where the dome turns to the red LED at the right
    assert right[1] > 1.3 * right[0]


def test_colours_change_with_the_slope_as_on_the_real_unit_and_a_net_learns_from_them():
    found = reality.against_photographs("digit")
    assert found.contrast == pytest.approx(1.0, abs=0.2)
    assert (found.direction < 15).all()
    assert (found.correlation > 0.88).all()
    assert found.normals < 0.45 * found.flat


def test_each_led_casts_its_fan_where_the_real_one_does(renderer, untouched):
    """Beyond the dent the blue falls upward, the green to the lower right, the red to the lower left."""
    unit = photographs.unit("digit")
    press = next(one for one in unit.presses if one.name == "sphere_0005.png")
    real = press.picture.astype(float) - unit.untouched
    made = renderer.develop(renderer.image(press_faces.face(renderer.sensor, press, {}))).astype(float) - untouched
    middle = np.array(press.center)
    down, across = np.mgrid[:320, :240] + 0.5
    for channel, way in ((2, (0.0, -1.0)), (1, (0.8, 0.6)), (0, (-0.8, 0.6))):
        at = middle + 44 * np.array(way)
        spot = np.hypot(across - at[0], down - at[1]) < 8
        for change in (real, made):
            lost = change[spot].mean(axis=0)
            assert lost[channel] < -6, (channel, lost)
            assert lost[channel] == lost.min(), (channel, lost)
