"""Shot noise and read noise of the camera's pixels."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.description import Noise

    Floats = NDArray[np.float64]


def noisy(linear: "Floats", noise: "Noise", random: np.random.Generator) -> "Floats":
    """A linear image (H, W, 3) over full scale with white noise of variance (shot x signal + read^2) strength^2.

    The normal distribution approximates Poisson's well, since a full pixel has thousands of electrons.
    """
    variance = np.array(noise.shot) * np.clip(linear, 0.0, 1.0) + np.square(noise.read)
    return np.asarray(linear + noise.strength * np.sqrt(variance) * random.standard_normal(linear.shape))
