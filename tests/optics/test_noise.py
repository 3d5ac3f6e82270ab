"""The camera's noise: as strong as real cameras', the same for the same numbers, and none unless asked for."""

import numpy as np
import pytest
from helpers.tiny import sensor
from scipy import stats

from tacgen.base.errors import UserError
from tacgen.optics import camera_response
from tacgen.optics.camera_response import NOISE_QUANTILES
from tacgen.recipe import assets, loading
from tacgen.sensor.model import Camera, Noise

GRAIN = Noise(shot=(1e-4, 2e-4, 4e-4), read=(0.001, 0.002, 0.003), source="test")


def linear(counts: tuple[float, float, float], camera: Camera) -> np.ndarray:
    """The inverse of the camera's response, by its table."""
    x = np.linspace(0, 1, 20001)
    return np.interp(np.array(counts) / 255, camera_response.encoded(x, camera), x)


@pytest.mark.parametrize(
    ("name", "mean", "published"),
    [("gelsight_mini", (77.6, 94.8, 105.2), (1.9, 1.3, 2.4)), ("digit", (94, 103, 95), (3.3, 1.6, 2.8))],
)
def test_counts_scatter_as_published(name: str, mean: tuple[float, float, float], published: tuple) -> None:
    camera = loading.read_sensor(assets.sensor_path(name))[0].camera.model_copy(
        update={"vignette_mm": None, "colour_matrix": None}
    )
    even = np.broadcast_to(linear(mean, camera) / camera.exposure, (camera.height_px, camera.width_px, 3))
    pictures = [camera_response.develop(even, camera, np.random.default_rng(seed)).astype(float) for seed in range(8)]
    picture = pictures[0]
    assert np.std(pictures, axis=(0, 1, 2)) == pytest.approx(published, rel=0.02)
    assert picture.mean(axis=(0, 1)) == pytest.approx(mean, abs=0.1)
    if camera.noise.white:
        rows = picture - picture.mean(axis=(0, 1))
        assert np.abs((rows[:, 1:] * rows[:, :-1]).mean(axis=(0, 1))).max() < 0.02 * max(published) ** 2


def test_digits_noise_is_correlated_over_patches_and_between_colours_as_in_photographs() -> None:
    """Photographs: colour by .71, .44, .23 and 0 at distances of 1, 2, 3 and 4 px, red with green by -.48."""
    camera = loading.read_sensor(assets.sensor_path("digit"))[0].camera.model_copy(update={"vignette_mm": None})
    even = np.full((camera.height_px, camera.width_px, 3), 0.4, np.float32)
    made = np.mean([_noise(camera, even, seed) for seed in range(8)], axis=0)
    assert made[:4] == pytest.approx([0.71, 0.44, 0.23, 0.0], abs=0.06)
    assert made[4:] == pytest.approx([-0.48, 0.08, -0.4], abs=0.04)


def _noise(camera: Camera, even: np.ndarray, seed: int) -> np.ndarray:
    """Correlations of a picture's noise: of red less green at distances of 1 to 4 px, and of its colours."""
    picture = camera_response.develop(even, camera, np.random.default_rng(seed)).astype(float)
    picture -= picture.mean(axis=(0, 1))
    colour = picture[..., 0] - picture[..., 1]
    apart = [np.corrcoef(colour[:, k:].ravel(), colour[:, :-k].ravel())[0, 1] for k in (1, 2, 3, 4)]
    return np.array([*apart, *np.corrcoef(picture.reshape(-1, 3).T)[np.triu_indices(3, 1)]])


def test_correlated_noise_has_the_variance_of_white_noise_and_impossible_correlations_are_refused() -> None:
    noise = GRAIN.model_copy(update={"patch_px": 3, "correlation": (-0.5, 0.2, -0.3)})
    size = {"width_px": 641, "height_px": 479, "response": "linear", "exposure": 1.0, "vignette_mm": None}
    camera = sensor().camera.model_copy(update={"noise": noise, **size})
    made = camera_response.develop(np.full((479, 641, 3), 0.5), camera, np.random.default_rng(0)) / 255
    wanted = np.array(GRAIN.shot) * 0.5 + np.square(GRAIN.read) + 1 / 12 / 255**2
    assert made.var(axis=(0, 1)) == pytest.approx(wanted, rel=0.03)
    with pytest.raises(UserError, match="cannot be correlated"):
        Noise(shot=(1e-4,) * 3, read=(1e-3,) * 3, correlation=(-0.9, -0.9, -0.9))


@pytest.mark.parametrize("level", [0.2, 0.5, 0.8])
def test_variance_is_shot_times_signal_plus_read_squared(level: float) -> None:
    """A count's rounding adds the variance of a uniform distribution."""
    size = {"width_px": 640, "height_px": 480, "response": "linear", "exposure": 1.0, "vignette_mm": None}
    camera = sensor().camera.model_copy(update={"noise": GRAIN, **size})
    made = camera_response.develop(np.full((480, 640, 3), level), camera, np.random.default_rng(0)) / 255
    wanted = np.array(GRAIN.shot) * level + np.square(GRAIN.read) + 1 / 12 / 255**2
    assert made.var(axis=(0, 1)) == pytest.approx(wanted, rel=0.02)


def test_quantiles_are_those_of_a_normal_distribution_of_variance_1() -> None:
    values = camera_response.quantiles().astype(float)
    assert len(values) == NOISE_QUANTILES
    assert (np.diff(values) > 0).all()
    assert abs(values.mean()) < 1e-7
    assert values.var() == pytest.approx(1.0, rel=1e-7)
    assert (values**4).mean() == pytest.approx(3.0, rel=2e-3)
    assert stats.kstest(values, "norm").statistic < 1e-4


def test_none_unless_asked_for_and_the_same_for_the_same_numbers() -> None:
    plain = sensor().camera
    grainy = plain.model_copy(update={"noise": GRAIN})
    even = np.full((32, 40, 3), 0.3)
    clean = camera_response.develop(even, grainy)
    assert np.array_equal(clean, np.round(255 * camera_response.encoded(camera_response.expose(even, plain), plain)))
    assert np.array_equal(clean, camera_response.develop(even, plain, np.random.default_rng(0)))
    one, again, other = (camera_response.develop(even, grainy, np.random.default_rng(k)) for k in (0, 0, 1))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
    assert not np.array_equal(one, clean)


@pytest.mark.parametrize("response", ["srgb", "linear"])
def test_counts_are_the_rounded_curve_at_every_light(response: str) -> None:
    rows = ((1.0, -0.2, -0.3), (0.0, 1.0, 0.0), (0.1, 0.0, 0.8))
    camera = sensor().camera.model_copy(update={"response": response, "colour_matrix": rows, "exposure": 0.9})
    light = np.random.default_rng(0).uniform(-0.1, 1.3, (200, 32, 40, 3)) ** 3  # a third of it below .03
    light[0], light[1], light[2] = 0.0, 1 / camera.exposure, 2.0
    for picture in light.astype(np.float32):
        curve = camera_response.encoded(camera_response.expose(picture, camera), camera)
        assert np.array_equal(camera_response.develop(picture, camera), np.round(255 * curve))
    even = np.broadcast_to((np.arange(510) / 2 / 255)[:, None, None], (510, 1, 3)).astype(
        np.float32
    )  # each count and tie
    size = {"width_px": 1, "height_px": 510}
    plain = sensor().camera.model_copy(update={"response": response, "vignette_mm": None, "exposure": 1.0, **size})
    assert np.array_equal(
        camera_response.develop(even, plain), np.round(255 * camera_response.encoded(even.astype(float), plain))
    )


def test_noise_is_a_quantile_for_each_16_bits_in_the_order_of_the_pixels() -> None:
    grain = GRAIN.model_copy(update={"strength": 1.5})
    camera = sensor().camera.model_copy(update={"noise": grain, "vignette_mm": None, "response": "linear"})
    even, light = np.full((32, 40, 3), 0.3), np.full((32, 40, 3), 0.3 * camera.exposure)
    for seed in range(30):
        drawn = np.random.default_rng(seed).integers(0, 1 << 16, even.shape, np.uint16)
        normal = camera_response.quantiles()[drawn]
        noise = 1.5 * np.sqrt(np.array(GRAIN.shot) * light + np.square(GRAIN.read)) * normal
        made = camera_response.develop(even, camera, np.random.default_rng(seed))
        assert np.array_equal(made, np.round(255 * np.clip(light + noise, 0, 1)))
