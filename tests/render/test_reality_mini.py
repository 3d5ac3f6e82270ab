"""The GelSight Mini's file against photographs of a real unit."""

import numpy as np
import pytest
from helpers import reality

from benchmarks import photographs
from tacgen.calibrate import normal_net, render_comparison
from tacgen.render import images, mitsuba_variants

pytestmark = reality.needs("gelsight_mini")

SPREAD = ((66, 83), (95, 122), (105, 124))  # channel means of six real units' backgrounds, R, G, B


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
def test_colours_change_with_the_slope_as_on_the_real_unit_and_a_net_learns_from_them(monkeypatch):
    """Half the dents and steps of a calibration."""
    monkeypatch.setattr(render_comparison, "TRAINING_DENTS", 96)
    monkeypatch.setattr(normal_net, "MAX_LBFGS_STEPS", 150)
    found = reality.against_photographs("gelsight_mini")
    assert found.contrast == pytest.approx(1.0, abs=0.1)
    assert (found.direction < 15).all()
    assert (found.correlation > 0.9).all()
    assert found.normals < 5 < 18 < found.flat
