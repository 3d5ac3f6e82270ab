"""What the scenes of one sensor share of their pictures."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.tiny import sensor
from PIL import Image

from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Untouched
from tacgen.render import pictures

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
def test_scenes_share_a_renderer_whose_pictures_do_not_depend_on_their_seed(
    method: str, shared: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
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
