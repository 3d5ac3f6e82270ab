"""What a camera's pixels add to the light: photons come by chance, and reading them out adds its own."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.description import Noise

    Floats = NDArray[np.float64]


def noisy(linear: "Floats", noise: "Noise", random: np.random.Generator) -> "Floats":
    """A linear picture (H, W, 3), in parts of full scale, with white noise of variance shot x signal + read^2, times
    strength^2.

    A normal stands for the photons' Poisson: at thousands of electrons in a full pixel they are alike.
    """
    variance = np.array(noise.shot) * np.clip(linear, 0.0, 1.0) + np.square(noise.read)
    return np.asarray(linear + noise.strength * np.sqrt(variance) * random.standard_normal(linear.shape))
