"""The GelSight Mini's file against photographs of a real unit: the two things that must show."""

import numpy as np
import pytest
from helpers import reality

from tacgen.optics.camera import Camera
from tacgen.optics.hertz_dent import BallDent
from tacgen.render import images, mitsuba_variants

PHOTOS = reality.REFERENCE / "gelsight_mini"

pytestmark = reality.needs("gelsight_mini", "background.png")

SPREAD = ((66, 83), (95, 122), (105, 124))  # channel means of six real units' backgrounds, R, G, B


@pytest.fixture(scope="module")
def compare():
    return reality.compare()


@pytest.fixture(scope="module")
def sensor():
    return reality.sensor("gelsight_mini")


@pytest.fixture(scope="module")
def renderer(sensor):
    return images.Renderer(sensor, 8, 0, markers=False, variant=mitsuba_variants.SCALAR)


@pytest.fixture(scope="module")
def untouched(renderer):
    return renderer.develop(renderer.flat())


def test_background_means_lie_in_the_real_units_spread_and_red_peaks_in_the_middle(untouched):
    for mean, (least, most) in zip(untouched.mean(axis=(0, 1)), SPREAD, strict=True):
        assert least <= mean <= most
    red = untouched[..., 0].astype(float)
    rows, columns = red.mean(axis=1), red.mean(axis=0)
    assert 60 < rows.argmax() < 180
    assert 80 < columns.argmax() < 240
    assert rows.max() > 1.5 * max(rows[0], rows[-1])


def test_dent_colours_turn_with_the_slope_as_on_the_real_unit(compare, renderer, sensor, untouched):
    real_flat, camera = compare.load(PHOTOS / "background.png"), Camera.from_sensor(sensor)
    wanted, found = [], []
    for press in compare.presses(PHOTOS):
        if press.name not in ("ball_6.310mm_20.png", "ball_6.310mm_8.png", "ball_9.500mm_1.png"):
            continue
        dent = BallDent.seen(camera, press.ball, press.center, press.contact)
        dented = renderer.develop(renderer.image(dent))
        wanted.append(compare.slopes(press.picture, real_flat, press, camera.mm_per_px))
        found.append(compare.slopes(dented, untouched, press, camera.mm_per_px))
    real, made = np.median(wanted, axis=0), np.median(found, axis=0)
    for channel, axis, sign in (
        (0, 2, -1),
        (1, 1, 1),
        (2, 2, 1),
    ):  # red falls along y, green rises along x, blue along y
        assert np.sign(made[channel, axis]) == sign == np.sign(real[channel, axis])
        assert 0.5 < made[channel, axis] / real[channel, axis] < 1.6
