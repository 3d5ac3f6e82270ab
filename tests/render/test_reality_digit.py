"""DIGIT's file against photographs of a real unit: its colours, its dents and their shadow fans."""

import numpy as np
import pytest
from helpers import reality

from benchmarks import photographs
from tacgen.calibrate import solved_presses
from tacgen.render import images, mitsuba_variants

pytestmark = reality.needs("digit")


@pytest.fixture(scope="module")
def renderer():
    return images.Renderer(reality.sensor("digit"), 64, 0, markers=False, variant=mitsuba_variants.SCALAR_VARIANT)


@pytest.fixture(scope="module")
def untouched(renderer):
    return renderer.develop(renderer.flat())


@pytest.mark.slow
def test_the_untouched_picture_is_like_the_photograph(untouched):
    real = photographs.unit("digit").untouched
    assert untouched.mean(axis=(0, 1)) == pytest.approx(real.mean(axis=(0, 1)), abs=5)
    left, right = untouched[:, :60].mean(axis=(0, 1)), untouched[:, -60:].mean(axis=(0, 1))
    assert left[0] > 1.3 * left[1]  # red at the left, where the dome turns to the red LED at the right
    assert right[1] > 1.3 * right[0]


@pytest.mark.slow
def test_colours_change_with_the_slope_as_on_the_real_unit_and_a_net_learns_from_them():
    found = reality.against_photographs("digit")
    assert found.contrast == pytest.approx(1.0, abs=0.17)
    assert (found.direction < 15).all()
    assert (found.correlation > 0.93).all()
    assert found.normals < 0.4 * found.flat


@pytest.fixture(scope="module")
def changes(renderer, untouched):
    """A press that is far from the picture's edges, and its change of colour [counts]: photographed, rendered."""
    unit = photographs.unit("digit")
    press = next(one for one in unit.presses if one.name == "sphere_0005.png")
    made = renderer.develop(renderer.image(solved_presses.face(renderer.sensor, press, {})))
    return press, press.picture.astype(float) - unit.untouched, made.astype(float) - untouched


FANS = ((2, (0.0, -1.0)), (1, (0.8, 0.6)), (0, (-0.8, 0.6)))  # channel, and where the shadow of its LED falls


def lost(press, change, way, distance):
    """Mean change (3,) [counts] in a spot of 8 px at a distance [px] from a press's middle."""
    at = np.array(press.center) + distance * np.array(way)
    down, across = np.mgrid[:320, :240] + 0.5
    return change[np.hypot(across - at[0], down - at[1]) < 8].mean(axis=0)


@pytest.mark.slow
def test_shadows_end_where_the_real_ones_do(changes):
    """Which shows that the light is as steep: shadows of low lamps would reach the edge of the pad."""
    press, *both = changes
    away = np.arange(45, 126, 5)
    for channel, way in FANS:
        ends = []
        for change in both:
            dark = np.array([lost(press, change, way, distance)[channel] for distance in away])
            ends.append(away[np.argmax((dark > dark.min() / 2) & (away > away[dark.argmin()]))])
        assert ends[1] == pytest.approx(ends[0], abs=10), (channel, ends)
        assert dark[-1] > 0.1 * dark.min()


@pytest.mark.slow
def test_shadows_end_as_crisply_as_the_real_ones(changes):
    """Way over which a shadow rises from 25 % to 85 %, mean of the three: it is longer under lamps that are taller."""
    press, *both = changes
    away = np.arange(55, 126, 2)
    wide = []
    for change in both:
        ends = []
        for channel, way in FANS:
            dark = np.array([lost(press, change, way, distance)[channel] for distance in away])
            share = 1 - dark / dark.min()
            after = np.arange(len(away)) > dark.argmin()
            ends.append(np.subtract(*(away[np.argmax(after & (share > level))] for level in (0.85, 0.25))))
        wide.append(np.mean(ends))
    assert wide[1] == pytest.approx(wide[0], abs=5), wide  # [px]
