"""The GelSight Mini's file against photographs of a real unit."""

import numpy as np
import pytest
from helpers import reality

from benchmarks import photographs
from tacgen.render import images, mitsuba_variants

pytestmark = reality.needs("gelsight_mini")

SPREAD = ((66, 83), (95, 122), (105, 124))  # channel means of six real units' backgrounds, R, G, B


def test_background_means_lie_in_the_real_units_spread_and_red_peaks_in_the_middle():
    renderer = images.Renderer(reality.sensor("gelsight_mini"), 8, 0, False, mitsuba_variants.SCALAR)
    untouched = renderer.develop(renderer.flat())
    for mean, (least, most) in zip(untouched.mean(axis=(0, 1)), SPREAD, strict=True):
        assert least - 0.5 <= mean <= most + 0.5
    red = untouched[..., 0].astype(float)
    rows, columns = red.mean(axis=1), red.mean(axis=0)
    assert 60 < rows.argmax() < 180
    assert 80 < columns.argmax() < 240
    assert rows.max() > 1.5 * max(rows[0], rows[-1])
    assert np.sqrt(np.mean((untouched - photographs.unit("gelsight_mini").untouched.astype(float)) ** 2)) < 8


def test_colours_change_with_the_slope_as_on_the_real_unit_and_a_net_learns_from_them():
    found = reality.against_photographs("gelsight_mini")
    assert found.contrast == pytest.approx(1.0, abs=0.4)
    assert (found.direction < 15).all()
    assert (found.correlation > 0.85).all()
    assert found.normals < 0.6 * found.flat
