"""Shipped sensors against photographs of real units: colours, dents, dots, grain, shadow fans and the halo."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from benchmarks import photographs
from tacgen.calibrate import normal_net, render_comparison, solved_presses
from tacgen.recipe import assets, loading
from tacgen.render import images
from tacgen.render.mitsuba_variants import SCALAR_VARIANT


def needs(name: str) -> pytest.MarkDecorator:
    """Skip where a sensor's photographs are absent."""
    reason = f"no photographs in {photographs.reference()} (set TACGEN_REFERENCE)"
    return pytest.mark.skipif(not photographs.there(name), reason=reason)


def shipped(name: str):
    return loading.read_sensor(assets.sensor_path(name))[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "contrast", "correlation"),
    [pytest.param("digit", 0.17, 0.93, marks=needs("digit")),
     pytest.param("gelsight_mini", 0.1, 0.9, marks=needs("gelsight_mini"))],
)  # fmt: skip
def test_colours_change_with_the_slope_as_on_the_real_unit_and_teach_a_net(name, contrast, correlation, monkeypatch):
    if name == "gelsight_mini":  # half the dents and steps of a calibration
        monkeypatch.setattr(render_comparison, "TRAINING_DENTS", 96)
        monkeypatch.setattr(normal_net, "MAX_LBFGS_STEPS", 150)
    unit, file = photographs.unit(name), shipped(name)
    faces = [solved_presses.face(file, press, {}) for press in unit.presses]
    found = render_comparison.Comparison(file).likeness(unit.presses, faces, unit.untouched)
    assert found.contrast == pytest.approx(1.0, abs=contrast)
    assert (found.direction < 15).all()
    assert (found.correlation > correlation).all()
    if name == "digit":
        assert found.normals < 0.4 * found.flat
    else:
        assert found.normals < 5 < 18 < found.flat


SPREAD = ((66, 83), (95, 122), (105, 124))  # channel means of six real units' backgrounds, R, G, B
NEAR, FAR = 0.8, 3.2  # standard deviations of the Gaussians that bound the band [px]


@needs("gelsight_mini")
@pytest.mark.slow
def test_background_means_lie_in_the_real_units_spread_and_red_peaks_in_the_middle():
    renderer = images.Renderer(shipped("gelsight_mini"), 8, 0, False, SCALAR_VARIANT)
    untouched = renderer.develop(renderer.flat())
    for mean, (least, most) in zip(untouched.mean(axis=(0, 1)), SPREAD, strict=True):
        assert least - 0.5 <= mean <= most + 0.5
    red = untouched[..., 0].astype(float)
    rows, columns = red.mean(axis=1), red.mean(axis=0)
    assert 60 < rows.argmax() < 180
    assert 80 < columns.argmax() < 240
    assert rows.max() > 1.5 * max(rows[0], rows[-1])
    assert np.sqrt(np.mean((untouched - photographs.unit("gelsight_mini").untouched.astype(float)) ** 2)) < 6


@needs("gelsight_mini")
@pytest.mark.slow
def test_dots_are_as_large_and_as_dark_as_on_a_real_gel():
    """Of another unit: 11.3 px across at 0.6 of the coat's counts, pitch 32.3 px, and 0.38 of the coat's in them."""
    renderer = images.Renderer(shipped("gelsight_mini"), 64, 0, True, SCALAR_VARIANT)
    bare = images.Renderer(renderer.sensor, 64, 0, False, SCALAR_VARIANT)
    share = renderer.develop(renderer.flat()).mean(axis=2) / bare.develop(bare.flat()).mean(axis=2)
    y, x = np.mgrid[:240, :320] + 0.5
    cell = (np.abs(x - 160) < 16) & (np.abs(y - 120) < 16)  # around the middle dot
    sensor, across = renderer.sensor, np.sqrt(4 / np.pi * (share[cell] < 0.6).sum())
    pitch = sensor.markers.pitch_mm[0] / sensor.camera.mm_per_px
    assert across / pitch == pytest.approx(11.34 / 32.3, rel=0.05)
    assert share[cell].min() == pytest.approx(0.38, abs=0.04)


@needs("gelsight_mini")
@pytest.mark.slow
def test_blue_is_shaded_above_a_dent_as_faintly_as_in_the_photograph():
    """Depth and place: those of the solved face that suits the photograph. By low lamps it is darker by 13 counts."""
    unit, sensor = photographs.unit("gelsight_mini"), shipped("gelsight_mini")
    drawn = next(one for one in unit.presses if one.name == "ball_6.310mm_8.png")
    press = replace(drawn, center=(232.1, 93.3), depth=0.84)
    renderer = images.Renderer(sensor, 64, 0, False, SCALAR_VARIANT)
    face = solved_presses.face(sensor, press, {})
    made = renderer.develop(renderer.image(face)).astype(float) - renderer.develop(renderer.flat())
    above = press.center[0], press.center[1] - 1.5 * press.contact
    there = render_comparison.circle(made.shape[:2], above, 6)
    real, shaded = (change[there][:, 2].mean() for change in (press.picture.astype(float) - unit.untouched, made))
    assert real < -10
    assert shaded == pytest.approx(real, abs=8)


@needs("gelsight_mini")
@pytest.mark.slow
def test_the_untouched_coat_has_grain_as_photographs_have():
    """Of green and blue together, in a band of 0.8 to 3.2 px, over their light: noise is not common to both."""

    def common(pictures: list[np.ndarray]) -> float:
        relative = []
        for one in pictures:
            low, high = (ndimage.gaussian_filter(one, (width, width, 0)) for width in (NEAR, FAR))
            relative.append((low - high) / high)
        edge = slice(10, -10), slice(10, -130)  # where no press is near
        first, *others = (one[edge] for one in relative)
        return float(np.mean([(first[..., 1] * other[..., 2]).mean() for other in others]))

    unit = photographs.unit("gelsight_mini")
    far = [one.picture.astype(float) for one in unit.presses if one.center[0] > 250]
    renderer = images.Renderer(shipped("gelsight_mini"), 64, 0, False, SCALAR_VARIANT)
    flat = renderer.flat()
    made = [renderer.develop(flat, np.random.default_rng(seed)).astype(float) for seed in range(4)]
    real = common([unit.untouched.astype(float), *far])
    assert real > 2e-6
    assert np.sqrt(common(made) / real) == pytest.approx(1.0, abs=0.3)


@pytest.fixture(scope="module")
def renderer():
    return images.Renderer(shipped("digit"), 64, 0, markers=False, variant=SCALAR_VARIANT)


@pytest.fixture(scope="module")
def untouched(renderer):
    return renderer.develop(renderer.flat())


@needs("digit")
@pytest.mark.slow
def test_the_untouched_picture_is_like_the_photograph(untouched):
    real = photographs.unit("digit").untouched
    assert untouched.mean(axis=(0, 1)) == pytest.approx(real.mean(axis=(0, 1)), abs=5)
    left, right = untouched[:, :60].mean(axis=(0, 1)), untouched[:, -60:].mean(axis=(0, 1))
    assert left[0] > 1.3 * left[1]  # red at the left, where the dome turns to the red LED at the right
    assert right[1] > 1.3 * right[0]


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


@needs("digit")
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


@needs("digit")
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


@needs("ninedtact")
@pytest.mark.slow
def test_the_dark_disc_under_a_ball_and_its_halo_are_as_photographed():
    sensor, unit = shipped("ninedtact"), photographs.unit("ninedtact")
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
