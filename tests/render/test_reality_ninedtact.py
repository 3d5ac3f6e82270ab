"""9DTact's file against photographs of a real unit: the dark disc under a ball, and the halo around it."""

import numpy as np
import pytest
from helpers import reality

from benchmarks import photographs
from tacgen.calibrate import solved_presses
from tacgen.render import images

pytestmark = [pytest.mark.slow, reality.needs("ninedtact")]


def test_the_press_is_like_the_photographed_one():
    sensor, unit = reality.sensor("ninedtact"), photographs.unit("ninedtact")
    renderer, (press,) = images.Renderer(sensor, 24, 0, markers=False), unit.presses
    made0 = renderer.develop(renderer.flat())
    assert made0.mean(axis=(0, 1)) == pytest.approx(unit.untouched.mean(axis=(0, 1)), abs=5)
    made = renderer.develop(renderer.image(solved_presses.face(sensor, press, {})))
    grey, rendered = (
        a.astype(float).mean(axis=2) - b.mean(axis=2) for a, b in ((press.picture, unit.untouched), (made, made0))
    )
    a, b = (photographs.radial_profile(c, press.center, sensor.camera.mm_per_px) for c in (grey, rendered))
    peak = np.abs(a).max()
    assert np.sqrt(np.mean((a - b) ** 2)) < 0.03 * peak
    assert b.min() == pytest.approx(a.min(), abs=0.05 * peak)
    assert b.max() == pytest.approx(a.max(), abs=0.05 * peak)
    assert b.max() > 0.3 * peak  # the halo
