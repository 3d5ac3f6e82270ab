"""Grain is found in pictures as it was put there, beside noise, slow light and dots."""

import numpy as np
import pytest

from benchmarks import mini_units, real_grain
from tacgen.optics import coat_texture
from tacgen.sensor.model import Coating

Array = np.ndarray
SHAPE, PIXEL = (240, 320), 0.06


def pictures(contrast: float, length: float, count: int = 10) -> list[Array]:
    """Pictures of a grainy coat under uneven light, with noise."""
    coat = Coating.model_validate(
        {"albedo": 0.5, "specular": 0.0, "roughness": 0.3, "grain": {"contrast": contrast, "length_mm": length}}
    )
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    size = (SHAPE[1] * PIXEL, SHAPE[0] * PIXEL)
    places = np.column_stack([x.ravel() * PIXEL - size[0] / 2, y.ravel() * PIXEL - size[1] / 2])
    field = coat_texture.sampled(coat_texture.texture(coat, size, PIXEL), size, places).reshape(SHAPE)
    light = (80 + 40 * np.sin(x / 90) + 20 * np.cos(y / 70))[..., None] * [0.8, 1.0, 1.1] * field[..., None]
    random = np.random.default_rng(0)
    return [np.round(light + 2 * random.standard_normal(light.shape)) for _ in range(count)]


@pytest.mark.parametrize(("contrast", "length"), [(0.008, 0.06), (0.015, 0.1)])
def test_contrast_and_length_are_found_again(contrast: float, length: float) -> None:
    found = real_grain.fitted(real_grain.spectrum(pictures(contrast, length), np.zeros(SHAPE, bool)))
    assert found[0] == pytest.approx(100 * contrast, rel=0.2)
    assert found[1] * PIXEL == pytest.approx(length, rel=0.25)


def test_noise_alone_is_no_grain() -> None:
    assert np.abs(real_grain.spectrum(pictures(0.0, 0.06), np.zeros(SHAPE, bool))).max() < 0.15


def test_dots_are_left_out() -> None:
    dotted = pictures(0.008, 0.06)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    spot = np.hypot(x % 32 - 16, y % 32 - 16) < 6
    for picture in dotted:
        picture[spot] *= 0.4
    hidden = mini_units.dark(dotted[0])
    assert hidden[spot].all()
    assert hidden.mean() < 0.35
    found = real_grain.fitted(real_grain.spectrum(dotted, hidden))
    assert found[0] == pytest.approx(0.8, rel=0.3)
