"""The Gaussian filter of pictures, against SciPy's."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tacgen.optics.gaussian import blur


@pytest.mark.parametrize("colours", [1, 3])
@pytest.mark.parametrize(("sd", "truncate"), [(0.1, 4.0), (0.7, 3.0), (2.3, 4.0), (9.0, 3.0)])
def test_it_is_scipys_at_any_width_even_beyond_the_picture(sd: float, truncate: float, colours: int) -> None:
    picture = np.random.default_rng(0).uniform(-1, 1, (17, 25, colours))
    expected = gaussian_filter(picture, (sd, sd, 0), mode="nearest", truncate=truncate)
    for asked in (picture, np.asfortranarray(picture)):
        assert blur(asked, sd, truncate) == pytest.approx(expected, rel=1e-12, abs=1e-14)
    expected = gaussian_filter(picture, (sd, 1.4 * sd, 0), mode="nearest", truncate=truncate)
    assert blur(picture, sd, truncate, 1.4 * sd) == pytest.approx(expected, rel=1e-12, abs=1e-14)
