"""The GelSight Mini's file against photographs of a real unit."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import reality
from scipy import ndimage

from benchmarks import photographs
from tacgen.calibrate import normal_net, render_comparison, solved_presses
from tacgen.render import images, mitsuba_variants

pytestmark = reality.needs("gelsight_mini")

SPREAD = ((66, 83), (95, 122), (105, 124))  # channel means of six real units' backgrounds, R, G, B
NEAR, FAR = 0.8, 3.2  # standard deviations of the Gaussians that bound the band [px]


@pytest.mark.slow
def test_background_means_lie_in_the_real_units_spread_and_red_peaks_in_the_middle():
    renderer = images.Renderer(reality.sensor("gelsight_mini"), 8, 0, False, mitsuba_variants.SCALAR_VARIANT)
    untouched = renderer.develop(renderer.flat())
    for mean, (least, most) in zip(untouched.mean(axis=(0, 1)), SPREAD, strict=True):
        assert least - 0.5 <= mean <= most + 0.5
    red = untouched[..., 0].astype(float)
    rows, columns = red.mean(axis=1), red.mean(axis=0)
    assert 60 < rows.argmax() < 180
    assert 80 < columns.argmax() < 240
    assert rows.max() > 1.5 * max(rows[0], rows[-1])
    assert np.sqrt(np.mean((untouched - photographs.unit("gelsight_mini").untouched.astype(float)) ** 2)) < 6


@pytest.mark.slow
def test_dots_are_as_large_and_as_dark_as_on_a_real_gel():
    """Of another unit: 11.3 px across at 0.6 of the coat's counts, pitch 32.3 px, and 0.38 of the coat's in them."""
    renderer = images.Renderer(reality.sensor("gelsight_mini"), 64, 0, True, mitsuba_variants.SCALAR_VARIANT)
    bare = images.Renderer(renderer.sensor, 64, 0, False, mitsuba_variants.SCALAR_VARIANT)
    share = renderer.develop(renderer.flat()).mean(axis=2) / bare.develop(bare.flat()).mean(axis=2)
    y, x = np.mgrid[:240, :320] + 0.5
    cell = (np.abs(x - 160) < 16) & (np.abs(y - 120) < 16)  # around the middle dot
    sensor, across = renderer.sensor, np.sqrt(4 / np.pi * (share[cell] < 0.6).sum())
    pitch = sensor.markers.pitch_mm[0] / sensor.camera.mm_per_px
    assert across / pitch == pytest.approx(11.34 / 32.3, rel=0.05)
    assert share[cell].min() == pytest.approx(0.38, abs=0.04)


@pytest.mark.slow
def test_blue_is_shaded_above_a_dent_as_faintly_as_in_the_photograph():
    """Depth and place: those of the solved face that suits the photograph. By low lamps it is darker by 13 counts."""
    unit, sensor = photographs.unit("gelsight_mini"), reality.sensor("gelsight_mini")
    drawn = next(one for one in unit.presses if one.name == "ball_6.310mm_8.png")
    press = replace(drawn, center=(232.1, 93.3), depth=0.84)
    renderer = images.Renderer(sensor, 64, 0, False, mitsuba_variants.SCALAR_VARIANT)
    face = solved_presses.face(sensor, press, {})
    made = renderer.develop(renderer.image(face)).astype(float) - renderer.develop(renderer.flat())
    above = press.center[0], press.center[1] - 1.5 * press.contact
    there = render_comparison.circle(made.shape[:2], above, 6)
    real, shaded = (change[there][:, 2].mean() for change in (press.picture.astype(float) - unit.untouched, made))
    assert real < -10
    assert shaded == pytest.approx(real, abs=8)


def fine(picture):
    """A picture (H, W, 3) in the band."""
    low, high = (ndimage.gaussian_filter(picture, (width, width, 0)) for width in (NEAR, FAR))
    return low - high


@pytest.mark.slow
def test_the_untouched_coat_has_grain_as_photographs_have():
    """Of green and blue together, in a band of 0.8 to 3.2 px, over their light: noise is not common to both."""

    def common(pictures: list[np.ndarray]) -> float:
        relative = [fine(one) / ndimage.gaussian_filter(one, (FAR, FAR, 0)) for one in pictures]
        edge = slice(10, -10), slice(10, -130)  # where no press is near
        first, *others = (one[edge] for one in relative)
        return float(np.mean([(first[..., 1] * other[..., 2]).mean() for other in others]))

    unit = photographs.unit("gelsight_mini")
    far = [one.picture.astype(float) for one in unit.presses if one.center[0] > 250]
    renderer = images.Renderer(reality.sensor("gelsight_mini"), 64, 0, False, mitsuba_variants.SCALAR_VARIANT)
    flat = renderer.flat()
    made = [renderer.develop(flat, np.random.default_rng(seed)).astype(float) for seed in range(4)]
    real = common([unit.untouched.astype(float), *far])
    assert real > 2e-6
    assert np.sqrt(common(made) / real) == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
def test_colours_change_with_the_slope_as_on_the_real_unit_and_a_net_learns_from_them(monkeypatch):
    """Half the dents and steps of a calibration."""
    monkeypatch.setattr(render_comparison, "TRAINING_DENTS", 96)
    monkeypatch.setattr(normal_net, "MAX_LBFGS_STEPS", 150)
    found = reality.against_photographs("gelsight_mini")
    assert found.contrast == pytest.approx(1.0, abs=0.1)
    assert (found.direction < 15).all()
    assert (found.correlation > 0.9).all()
    assert found.normals < 5 < 18 < found.flat
