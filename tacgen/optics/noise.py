"""Shot noise and read noise of the camera's pixels."""

import math

from tacgen.compiled import njit


@njit(cache=False)
def noisy(light: float, shot: float, read: float, strength: float, normal: float) -> float:
    """A linear signal over full scale with white noise of variance (shot x signal + read^2) strength^2.

    The normal distribution, of which `normal` is a sample, approximates Poisson's well, since a full pixel has
    thousands of electrons.
    """
    variance = shot * min(max(light, 0.0), 1.0) + read**2
    return light + strength * math.sqrt(variance) * normal
