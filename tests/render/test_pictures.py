"""Pictures of scenes: what those of one sensor share, drift, JPEG, and pixels that are not square."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.tiny import PLAIN, cloudy, sensor
from PIL import Image

from tacgen.calibrate.render_comparison import circle
from tacgen.optics import camera_response
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Untouched
from tacgen.render import images, jpeg, pictures, tensor_drawing, traced_maps
from tacgen.render.images import Renderer
from tacgen.render.pictures import drifted
from tacgen.sensor import optics_checks
from tacgen.sensor.imperfections import Drift
from tacgen.sensor.model import Sensor
from tacgen.sensor.optics_checks import problems

FILE = sensor()


class Told:
    """A renderer that tells its arguments."""

    def __init__(self, *asked: Any, **named: Any) -> None:
        self.asked = asked, named

    def flat(self) -> np.ndarray:
        return np.zeros((32, 40, 3), np.float32)


def settings(method: Any, seed: int) -> pictures.PictureSettings:
    return pictures.PictureSettings(FILE, method, 16, seed, True, None, frozenset({"rgb"}))


@pytest.mark.parametrize(("method", "shared"), [("transport", True), ("table", True), ("path", False)])
def test_scenes_share_a_renderer_if_no_seed_matters(method: str, shared: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "Renderer", Told)
    pictures._rendering.cache_clear()
    face = Untouched.of(FILE.gel)
    one, again, other = (pictures.Pictures(settings(method, seed), face) for seed in (1, 1, 2))
    pictures._rendering.cache_clear()
    assert (one.renderer is again.renderer) is shared
    assert (one.renderer is other.renderer) is shared
    assert (one.renderer.asked == other.renderer.asked) is shared


def test_the_untouched_picture_is_the_mean_of_many_and_the_same_in_all_scenes() -> None:
    noisy: Any = sensor(camera={"noise": {"shot": 1e-4, "read": 0.01, "source": "test"}}, markers=None)
    face = Untouched.of(noisy.gel)

    def made(seed: int, noise: bool) -> pictures.Pictures:
        return pictures.Pictures(
            pictures.PictureSettings(noisy, "transport", 16, seed, noise, None, frozenset({"rgb"})), face
        )

    one, other, clean = made(1, True), made(2, True), made(1, False)
    mean, plain = one.developed(one.flat), clean.developed(clean.flat)
    assert np.array_equal(mean, other.developed(other.flat))
    assert np.array_equal(plain, clean.renderer.develop(clean.flat))
    of_mean, of_frame = ((each.astype(float) - plain).std() for each in (mean, one.developed(one.flat, 0)))
    assert of_mean == pytest.approx(of_frame / np.sqrt(pictures.UNTOUCHED_FRAMES), rel=0.15)


def test_over_a_photograph_the_coat_has_no_grain_which_the_photograph_has(tmp_path: Path) -> None:
    photo = np.random.default_rng(0).integers(80, 120, (32, 40, 3)).astype(np.uint8)
    Image.fromarray(photo).save(tmp_path / "mine.png")
    grain = {"contrast": 0.1, "length_mm": 0.3, "source": "test"}
    face = BallDent(2.0, 1.2, (0.4, -0.3))

    def radiance(coat: dict[str, Any], photo: Path | None) -> np.ndarray:
        lit: Any = sensor(coating=coat, markers=None)
        asked = pictures.PictureSettings(lit, "transport", 16, 1, False, photo, frozenset({"rgb"}))
        return pictures.Pictures(asked, Untouched.of(lit.gel)).radiance(face)

    assert not np.array_equal(radiance({"grain": grain}, None), radiance({}, None))
    assert np.array_equal(radiance({"grain": grain}, tmp_path / "mine.png"), radiance({}, tmp_path / "mine.png"))


DRIFT = Drift(gain=0.02, frames=20.0, source="test")
GRAIN = {"contrast": 0.05, "length_mm": 0.3, "source": "test"}


def test_gains_scatter_and_last_as_asked_for() -> None:
    gains = np.array([[drifted(DRIFT, seed, frame) for frame in range(0, 61, 20)] for seed in range(800)]) - 1
    assert gains.mean() == pytest.approx(0, abs=0.001)
    assert gains.std(axis=(0, 1)) == pytest.approx(0.02, rel=0.06)
    near = [np.corrcoef(gains[:, k].ravel(), gains[:, k + 1].ravel())[0, 1] for k in range(3)]
    assert near == pytest.approx([np.exp(-0.5)] * 3, abs=0.06)
    assert abs(np.corrcoef(gains[:, 0, 0], gains[:, 0, 1])[0, 1]) < 0.12  # colours drift apart


def test_a_frames_gain_depends_on_seed_and_number_alone() -> None:
    assert np.array_equal(drifted(DRIFT, 3, 7), drifted(DRIFT, 3, 7))
    assert not np.array_equal(drifted(DRIFT, 3, 7), drifted(DRIFT, 4, 7))


def test_gain_acts_on_the_counts_of_each_colour() -> None:
    mixed = sensor(camera={"colour_matrix": [[1, -0.2, -0.3], [0, 1, 0], [0, 0, 1]], "response": "linear"}).camera
    even = np.full((32, 40, 3), 0.4)
    plain = camera_response.develop(even, mixed).astype(float)
    made = camera_response.develop(even, mixed, gain=np.array([0.5, 1.0, 1.2]))
    assert made == pytest.approx(np.minimum(plain * [0.5, 1.0, 1.2], 255), abs=1.1)


def test_jpeg_changes_pictures_by_its_quality_and_none_without() -> None:
    plain = Renderer(sensor(), 8, 0, markers=True)
    flat, off = plain.develop(plain.flat()), []
    for quality in (20, 95):
        compressed = Renderer(sensor(camera={"jpeg_quality": quality}), 8, 0, markers=True)
        picture = compressed.develop(compressed.flat())
        assert np.array_equal(picture, jpeg.compressed(flat, quality))
        off.append(float(np.abs(picture.astype(float) - flat).mean()))
    assert 0 < off[1] < off[0] < 12


def test_a_gel_that_scatters_hides_the_pattern() -> None:
    coat = {**cloudy().coating.model_dump(exclude_none=True), "grain": GRAIN}
    (found,) = problems(cloudy(coating=coat))
    assert found.path == ("coating", "grain")
    assert "cannot be seen through a layer that scatters" in found.message
    assert list(problems(sensor(coating={**PLAIN["coating"], "grain": GRAIN}))) == []


def test_maps_in_the_cache_serve_every_pattern_drift_and_quality() -> None:
    other, key = {"jpeg_quality": 50, "drift": DRIFT.model_dump()}, traced_maps.key
    assert key(sensor(coating={**PLAIN["coating"], "grain": GRAIN}, camera=other), None) == key(sensor(), None)
    assert key(sensor(coating={**PLAIN["coating"], "roughness": 0.3}), None) != key(sensor(), None)


EYE = {"blur_mm": 0.3, "vignette_mm": 6.0, "crop_mm": [0.5, -0.3], "height_px": 32}
DOTS = {**PLAIN["markers"], "offset_mm": [0.6, -0.4]}
DENT = BallDent(2.0, 1.0, (0.6, -0.4))


def made(aspect: float | None, height: int) -> Sensor:
    return sensor(camera={**EYE, "pixel_aspect": aspect, "height_px": height}, markers=DOTS)


def picture(one: Sensor, face: BallDent) -> np.ndarray:
    renderer = images.Renderer(one, 4, 0, True)
    return renderer.develop(renderer.image(face)).astype(float)


def test_a_picture_of_half_as_many_rows_is_the_whole_one_resized() -> None:
    whole, half = (picture(made(*how), DENT) for how in ((None, 32), (2.0, 16)))
    resized = whole.reshape(16, 2, 40, 3).mean(axis=1)
    assert np.abs(half - resized).mean() < 1.5
    assert np.abs(half - resized).mean() < 0.2 * np.abs(picture(made(None, 16), DENT) - resized).mean()


def test_a_contact_circle_is_an_ellipse_in_such_a_picture() -> None:
    square, flat = (PinholeCamera.from_sensor(made(*how)) for how in ((None, 32), (2.0, 16)))
    one, other = BallDent.seen(square, 2.0, (22.0, 14.0), 4.0), BallDent.seen(flat, 2.0, (22.0, 7.0), 4.0)
    assert other.contact == pytest.approx(one.contact, abs=1e-9)
    assert other.center == pytest.approx(one.center, abs=1e-9)
    inside = (
        circle((32, 40), (22.0, 14.0), 4.0),
        circle((16, 40), (22.0, 7.0), 4.0, 2.0),
    )
    assert 2 * inside[1].sum() == pytest.approx(inside[0].sum(), rel=0.1)


def test_fits_and_tables_have_square_pixels_and_others_are_refused() -> None:
    coarse = traced_maps.zoomed(made(2.0, 16), 20).camera
    assert (coarse.width_px, coarse.height_px, coarse.pixel_mm) == (20, 16, (0.4, 0.4))
    assert not tensor_drawing.drawable(images.Renderer(made(2.0, 16), 1, 0, True))
    (wrong,) = optics_checks.problems(cloudy(camera={"pixel_aspect": 1.1, "vignette_mm": None}))
    assert wrong.path == ("camera", "pixel_aspect")
