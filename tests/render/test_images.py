"""The renderer against Mitsuba's path, against the projection, and against itself."""

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest
from helpers import tiny
from helpers.program import ran
from helpers.tiny import PLAIN, sensor

from tacgen.optics.camera import PinholeCamera
from tacgen.optics.camera_response import encoded
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Sheet, Untouched
from tacgen.render import images
from tacgen.render.mitsuba_path import PathTracer
from tacgen.render.mitsuba_variants import SCALAR_VARIANT

DENT = BallDent(2.0, 1.0, (0.6, -0.4))


pytestmark = pytest.mark.usefixtures("own_cache")


def drawing(made, spp, markers=False, method="transport"):
    return images.Renderer(made, spp, 0, markers, SCALAR_VARIANT, method)


def paths(made, sheet):
    return PathTracer(made, sheet, False, SCALAR_VARIANT)


@pytest.fixture(scope="module")
def renderer():
    return drawing(sensor(), 64)


@pytest.fixture(scope="module")
def tracer(renderer):
    return paths(renderer.sensor, renderer.sheet)


@pytest.mark.slow
@pytest.mark.parametrize("surface", [Untouched(), DENT], ids=["flat", "dent"])
def test_image_agrees_with_path_within_paths_own_noise(renderer, tracer, surface):
    halves = np.array([tracer.radiance(surface, 256, seed) for seed in (1, 2)])
    truth, noise = halves.mean(axis=0), np.mean((halves[0] - halves[1]) ** 2) / 4
    image = renderer.image(surface)
    assert image.mean(axis=(0, 1)) == pytest.approx(truth.mean(axis=(0, 1)), rel=0.03)
    corrected = np.sqrt(max(np.mean((image - truth) ** 2) - noise, 0.0))
    assert corrected < 0.04 * truth.mean()


@pytest.mark.slow
def test_narrow_light_is_as_path_has_it():
    """On a dent, half as bright as even light or less; the emitter of paths is ours."""
    made = sensor(leds=[{**led, "lobe": 3} for led in PLAIN["leds"]])
    narrow = drawing(made, 64)
    traced = paths(made, narrow.sheet).radiance(DENT, 192, 1)
    image = narrow.image(DENT)
    assert image.mean(axis=(0, 1)) == pytest.approx(traced.mean(axis=(0, 1)), rel=0.05)
    even = drawing(sensor(), 64).image(DENT)
    assert (image.mean(axis=(0, 1)) < 0.6 * even.mean(axis=(0, 1))).all()
    corners = [picture[:16, :20].mean() / picture.mean() for picture in (image, traced)]
    assert corners[0] == pytest.approx(corners[1], rel=0.05)


@pytest.mark.slow
def test_light_goes_through_strips_that_stand_for_it():
    """Dark ones before the others' mirror images, far larger than they: as if they were not there."""
    dark = {"size_mm": [9, 3], "center_mm": [0, -4.6, -3.2], "radiance": [0, 0, 0], "see_through": True}
    leds = [*PLAIN["leds"], {**PLAIN["leds"][0], **dark, "name": "dark"}]
    bare, through = (drawing(sensor(leds=those), 4) for those in (PLAIN["leds"], leds))
    opaque = drawing(sensor(leds=[*leds[:3], {**leds[3], "see_through": False}]), 4)
    plain = bare.image(Untouched())
    assert through.image(Untouched()) == pytest.approx(plain, rel=1e-6)
    assert np.abs(opaque.image(Untouched()) - plain).max() > 0.1 * plain.max()
    tracers = [paths(one.sensor, one.sheet) for one in (bare, through)]
    means = [np.mean([tracer.radiance(Untouched(), 64, k) for k in (1, 2)]) for tracer in tracers]
    assert means[1] == pytest.approx(means[0], rel=0.01)


def test_markers_appear_where_the_camera_projects_them():
    dotted, bare = (drawing(sensor(), 4, markers).image(Untouched()).sum(axis=2) for markers in (True, False))
    share = dotted / bare
    y, x = np.mgrid[:32, :40] + 0.5
    dark = (1 - share) * ((np.abs(x - 20) < 6) & (np.abs(y - 16) < 5))
    middle = [(dark * x).sum() / dark.sum(), (dark * y).sum() / dark.sum()]
    assert middle == pytest.approx(PinholeCamera.from_sensor(sensor()).project([[0, 0, 0]])[0], abs=0.1)
    assert share.min() == pytest.approx(0.08, abs=0.08)


def test_image_axes_are_x_right_and_y_down():
    image = drawing(sensor(), 4).flat()
    red, green, blue = (image[..., c] for c in range(3))
    assert red[:8].mean() > 1.3 * red[-8:].mean()
    assert green[:, -8:].mean() > 1.3 * green[:, :8].mean()
    assert blue[-8:].mean() > 1.3 * blue[:8].mean()


def test_path_sees_the_same_axes_as_the_projection():
    """A tall, narrow dent at (1.5, 1) changes path's picture where the camera projects it."""
    model = sensor()
    tracer = paths(model, Sheet.over(model.gel, 0.1))
    dent = BallDent(0.8, 0.6, (1.5, 1.0))
    change = np.abs(tracer.radiance(dent, 64, 1) - tracer.radiance(Untouched(), 64, 1)).sum(axis=2)
    y, x = np.mgrid[:32, :40] + 0.5
    weight = np.where(change > 0.3 * change.max(), change, 0)
    found = [(weight * x).sum() / weight.sum(), (weight * y).sum() / weight.sum()]
    assert found == pytest.approx(PinholeCamera.from_sensor(model).project([[1.5, 1.0, -0.3]])[0], abs=2.0)


def test_a_scene_built_again_draws_the_same_numbers(tracer):
    """Merged shapes used to stand in another order now and then, and every pixel's noise with them."""
    first = tracer.radiance(DENT, 4, 7)
    for _ in range(8):
        again = paths(sensor(), tracer.sheet)
        assert np.array_equal(again.radiance(DENT, 4, 7), first)


@pytest.mark.slow
def test_a_window_shows_what_the_whole_picture_shows_there(tracer):
    """And the whole picture is the same after as before; nan where no window is."""
    windows = [(3, 20, 1, 1), (10, 4, 20, 6), (39, 31, 1, 1)]
    whole = tracer.radiance(DENT, 256, 1)
    seen = tracer.windows(tracer.sheet.at(DENT), windows, 4096, 1)
    assert np.isfinite(seen).all(2).sum() == 1 + 120 + 1
    for x, y, w, h in windows:
        near = whole[max(y - 2, 0) : y + h + 2, max(x - 2, 0) : x + w + 2]
        assert seen[y : y + h, x : x + w].mean((0, 1)) == pytest.approx(near.mean((0, 1)), rel=0.2)
    first, second = (tracer.windows(tracer.sheet.at(DENT), n * windows[:1], 16, 1)[20, 3] for n in (1, 2))
    assert not np.array_equal(first, second)
    assert np.array_equal(tracer.radiance(DENT, 256, 1), whole)


@pytest.mark.slow
def test_bytes_are_the_same_at_any_thread_count(tmp_path, monkeypatch):
    """Of a clear gel and of one that scatters: here, and in a process of more threads."""
    monkeypatch.setenv("TACGEN_CACHE_DIR", str(tmp_path / "here"))
    digests = []
    for one in (sensor(), tiny.cloudy()):
        made = drawing(one, 2, one.markers is not None)
        digests.append(hashlib.sha256(made.image(DENT).tobytes()).hexdigest())
    assert len(set(digests)) == 2
    code = (
        "import hashlib; import mitsuba as mi; mi.set_variant('scalar_rgb'); import drjit as dr; "
        "dr.set_thread_count(3); from helpers import tiny; from tacgen.render import images; "
        "from tacgen.optics.hertz_dent import BallDent; DENT = BallDent(2.0, 1.0, (0.6, -0.4))\n"
        "for one in (tiny.sensor(), tiny.cloudy()):\n"
        "    r = images.Renderer(one, 2, 0, one.markers is not None, 'scalar_rgb')\n"
        "    print(hashlib.sha256(r.image(DENT).tobytes()).hexdigest())"
    )
    paths = os.pathsep.join(map(str, (Path(__file__).parents[1], Path(__file__).parents[2])))
    assert ran("-c", code, TACGEN_CACHE_DIR=str(tmp_path / "there"), PYTHONPATH=paths).split() == digests


def test_no_paths_are_refused():
    with pytest.raises(ValueError, match="spp"):
        drawing(sensor(), 0)


@pytest.mark.slow
def test_the_table_looks_like_transport_where_it_was_not_calibrated(renderer):
    cheap = drawing(renderer.sensor, 8, method="table")
    truth, image = renderer.image(DENT), cheap.image(DENT)
    flat = renderer.image(Untouched())
    off = np.sqrt(np.mean((image - truth) ** 2))
    assert off < 0.5 * np.sqrt(np.mean((flat - truth) ** 2))  # it knows most of what the dent does
    assert 20 * np.log10(truth.max() / off) > 25


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="needs Linux's /proc")
def test_memory_stays_flat_over_hundreds_of_frames():
    made, held = drawing(sensor(), 16, markers=True), []
    for frames in (100, 400):
        for i in range(frames):
            made.develop(made.image(BallDent(2.0, 1.0, (0.6, 0.001 * i))))
        with open("/proc/self/statm") as file:
            held.append(int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE"))
    assert held[1] - held[0] < 4 * 2**20


def test_draft_is_near_to_default_and_coarser(renderer):
    draft = drawing(sensor(), 16)
    assert len(draft.sheet.rest) < len(renderer.sheet.rest) / 3
    made, fine = (encoded(one.image(DENT).astype(float), sensor().camera) for one in (draft, renderer))
    assert 40 < -10 * np.log10(np.mean((made - fine) ** 2)) < 70  # dB, as is asked for against path


def test_an_automatic_exposure_takes_back_a_share_of_a_change_of_the_mean():
    fixed = drawing(sensor(), 16)
    made = drawing(sensor(camera={"auto_exposure": 0.6}), 16)
    assert made.flat() == pytest.approx(fixed.flat())
    deep = BallDent(4.0, 3.0, (-3.0, 2.0))
    dent, bare, level = made.image(deep), fixed.image(deep), float(fixed.flat().mean())
    change = float(bare.mean()) / level
    assert change > 1.05
    assert float(dent.mean()) / level == pytest.approx(change**0.4, abs=1e-5)
    assert dent == pytest.approx(bare * change**-0.6, rel=1e-5)
