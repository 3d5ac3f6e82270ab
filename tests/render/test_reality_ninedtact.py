"""9DTact's file against photographs of a real unit: the dark disc under a ball, and the halo around it."""

import numpy as np
import pytest
from helpers import reality

from benchmarks import photographs
from tacgen.calibrate import press_faces
from tacgen.render import images

pytestmark = [pytest.mark.slow, reality.needs("ninedtact")]


def profile(change: np.ndarray, middle: tuple[float, float], mm_per_px: float) -> np.ndarray:
    """Mean change [counts] of a picture (h, w) in rings of 0.2 mm to 9 mm around a place [px]."""
    y, x = np.mgrid[: change.shape[0], : change.shape[1]] + 0.5
    ring = (np.hypot(x - middle[0], y - middle[1]) * mm_per_px / 0.2).astype(int)
    sums, count = (np.bincount(ring.ravel(), w, 45)[:45] for w in (change.ravel(), np.ones(change.size)))
    return np.asarray(sums / count)


def test_the_press_is_like_the_photographed_one():
    sensor, unit = reality.sensor("ninedtact"), photographs.unit("ninedtact")
    renderer, (press,) = images.Renderer(sensor, 24, 0, markers=False), unit.presses
    made0 = renderer.develop(renderer.flat())
    assert made0.mean(axis=(0, 1)) == pytest.approx(unit.untouched.mean(axis=(0, 1)), abs=5)
    made = renderer.develop(renderer.image(press_faces.face(sensor, press, {})))
    grey, rendered = (
        a.astype(float).mean(axis=2) - b.mean(axis=2) for a, b in ((press.picture, unit.untouched), (made, made0))
    )
    a, b = (profile(c, press.center, sensor.camera.mm_per_px) for c in (grey, rendered))
    peak = np.abs(a).max()
    assert np.sqrt(np.mean((a - b) ** 2)) < 0.03 * peak
    assert b.min() == pytest.approx(a.min(), abs=0.05 * peak)
    assert b.max() == pytest.approx(a.max(), abs=0.05 * peak)
    assert b.max() > 0.3 * peak  # the halo
