"""9DTact's file against photographs of a real unit: the dark disc under a ball, and the halo around it."""

import numpy as np
import pytest
from helpers import reality

from tacgen.render import images

PHOTOS = reality.REFERENCE / "ninedtact"

pytestmark = [pytest.mark.slow, reality.needs("ninedtact", "reference.png")]


def test_the_press_is_like_the_photographed_one():
    compare, sensor = reality.compare(), reality.sensor("ninedtact")
    renderer = images.Renderer(sensor, 24, 0, markers=False)
    real0, real = (compare.load(PHOTOS / f"{name}_rectified.png") for name in ("reference", "ball_R4mm"))
    made0 = renderer.develop(renderer.flat())
    assert made0.mean(axis=(0, 1)) == pytest.approx(real0.mean(axis=(0, 1)), abs=5)
    press = compare.nine_press(PHOTOS)
    made = renderer.develop(renderer.image(compare.press_faces.face(sensor, press, {})))
    everywhere = np.ones(real.shape[:2], bool)
    level = np.clip(made.astype(int) - made0 + real0, 0, 255).astype(np.uint8)
    assert compare.similarity(real, level, everywhere) > 0.985
    grey, rendered = real.mean(axis=2) - real0.mean(axis=2), made.mean(axis=2) - made0.mean(axis=2)
    a, b = (compare.profile(c, press.center, sensor.camera.mm_per_px) for c in (grey, rendered))
    peak = np.abs(a).max()
    assert np.sqrt(np.mean((a - b) ** 2)) < 0.03 * peak
    assert b.min() == pytest.approx(a.min(), abs=0.05 * peak)
    assert b.max() == pytest.approx(a.max(), abs=0.05 * peak)
    assert b.max() > 0.3 * peak  # the halo
