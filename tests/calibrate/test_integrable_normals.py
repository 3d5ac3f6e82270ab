"""Normals of one surface are kept, and what no surface has is taken away."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tacgen.calibrate.integrable_normals import integrable

Array = np.ndarray


def ball(aspect: float) -> tuple[Array, Array]:
    """Normals of a ball (n, 2) in a circle, and its pixels, without a dot in it and with one apart from it."""
    y, x = (np.mgrid[:60, :80] + 0.5) * np.array([aspect, 1.0])[:, None, None]
    where = (np.hypot(x - 40, y - 30) < 28) & ~(np.hypot(x - 50, y - 30) < 4)
    where[1, 1] = True
    return np.column_stack([x[where] - 40, y[where] - 30]) / 60, where


@pytest.mark.parametrize("aspect", [1.0, 1.3])
def test_normals_of_a_surface_are_kept_for_square_and_oblong_pixels(aspect: float) -> None:
    normals, where = ball(aspect)
    assert np.abs(integrable(normals, where, aspect) - normals).max() < 1e-3


def test_noise_and_curls_are_taken_away() -> None:
    normals, where = ball(1.0)
    white = np.random.default_rng(0).normal(0, 0.3, (*where.shape, 2))
    noise = gaussian_filter(white, (2, 2, 0))[where]  # as of smoothed pictures
    assert np.abs(integrable(normals + noise, where) - normals).mean() < 0.75 * np.abs(noise).mean()
    curl = 0.2 * normals[:, ::-1] * [1, -1]  # around the middle
    left = integrable(normals + curl, where) - normals
    assert np.abs(left[:-1]).mean() < 0.1 * np.abs(curl).mean()


def test_pixels_alone_and_normals_too_steep_stay_finite() -> None:
    normals, where = ball(1.0)
    assert integrable(normals, where)[0] == pytest.approx(normals[0])
    found = integrable(3 * normals, where)
    assert np.isfinite(found).all()
    assert np.linalg.norm(found, axis=1).max() < 1
    line = np.ones((1, 5), bool)
    assert integrable(np.full((5, 2), 0.3), line) == pytest.approx(np.full((5, 2), 0.3))
