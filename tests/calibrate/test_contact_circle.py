"""Contact circles: one drawn too large and beside the contact comes back to it."""

import numpy as np
import pytest
from helpers.tiny import sensor

from benchmarks.photographs import filled
from tacgen.calibrate import contact_circle
from tacgen.calibrate.photos import PhotographedPress
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent
from tacgen.render.images import Renderer


@pytest.fixture(scope="module")
def made():
    return sensor(camera={"mm_per_px": 0.05, "width_px": 160, "height_px": 128}, markers=None)


@pytest.fixture(scope="module")
def lamps(made):
    """Those of another unit: of other power, and elsewhere."""
    elsewhere = [one.model_copy(update={"center_mm": tuple(np.add(one.center_mm, (0.3, -0.3, 0.2))), "power": power})
                 for one, power in zip(made.leds, (0.7, 1.2, 0.9), strict=False)]  # fmt: skip
    return contact_circle.LampChanges(made.model_copy(update={"leds": tuple(elsewhere)}))


@pytest.fixture(scope="module")
def pictures(made):
    """Untouched, and a ball's press with a known contact circle, with noise."""
    renderer, random = Renderer(made, 16, 0, markers=False), np.random.default_rng(0)
    face = BallDent.seen(PinholeCamera.from_sensor(made), 2.5, (70.0, 66.0), 26.0)
    noise = [random.normal(0, 2, (128, 160, 3)) for _ in range(2)]
    return [renderer.develop(p) + n for p, n in zip((renderer.flat(), renderer.image(face)), noise, strict=True)]


@pytest.mark.parametrize("given", [(70.0, 66.0, 26.0), (72.0, 64.5, 30.0), (68.5, 67.0, 24.5)])
def test_the_circle_is_found_from_one_that_is_drawn_badly(pictures, lamps, given):
    untouched, pressed = pictures
    found = contact_circle.refined(PhotographedPress("p", pressed, 2.5, given[:2], given[2], None), untouched, lamps)
    assert found.center == pytest.approx((70.0, 66.0), abs=0.4)
    assert found.contact == pytest.approx(26.0, rel=0.04)


@pytest.mark.parametrize("start", [(12.0, 10.0), (4.0, 20.0), (20.0, 2.0)])
def test_dots_that_move_do_not_move_the_circle(pictures, lamps, start):
    y, x = np.mgrid[:128, :160]
    dots = [(a, b) for a in np.arange(start[0], 160, 32) for b in np.arange(start[1], 128, 32)]
    painted, hidden = [], np.zeros((128, 160), bool)
    for picture, moved in zip(pictures, (0.0, 3.0), strict=True):
        apart = np.min([np.hypot(x - a - moved, y - b + moved) for a, b in dots], axis=0)
        painted.append(np.where(apart[..., None] < 6, 0.2 * picture, picture))
        hidden |= apart < 8
    untouched, pressed = painted
    press = PhotographedPress("p", untouched + filled(pressed - untouched, hidden), 2.5, (72.0, 64.5), 30.0, None)
    found = contact_circle.refined(press, untouched, lamps, hidden)
    assert found.center == pytest.approx((70.0, 66.0), abs=0.5)
    assert found.contact == pytest.approx(26.0, rel=0.06)


def test_what_shows_no_circle_keeps_its_own(pictures, lamps):
    untouched, pressed = pictures
    solved = PhotographedPress("p", pressed, 2.5, (70.0, 66.0), None, 0.4)
    assert contact_circle.refined(solved, untouched, lamps) is solved
    cut = PhotographedPress("p", pressed, 2.5, (1.0, 2.0), 26.0, None)  # three quarters of it lie outside the picture
    assert contact_circle.refined(cut, untouched, lamps) is cut
