"""Drift between the photograph of the untouched sensor and those of presses: exposure, warm LEDs, streaks that move.

Pictures of presses show the untouched gel far from their contacts. What has changed there is the same in all of them,
but for a shade of each colour that each picture has of its own.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from tacgen.calibrate.photos import PhotographedPress
from tacgen.calibrate.render_comparison import near

Array = np.ndarray
# contact radii from a press's middle beyond which its picture shows the untouched gel: fans of shadow reach so far [-]
REST_CONTACT_RADII = 2.7
DRIFT_BLUR_PX = 3.0  # standard deviation of the Gaussian that smooths the common change, as narrow as streaks [px]
MIN_PICTURES_AT_REST = 0.1  # at a pixel, smoothed: with fewer, only the shades of pictures are known there [-]
SHADE_PASSES = 5  # in which common change and shades are found in turn: they converge by a tenth of a count


def changes(presses: Sequence[PhotographedPress], untouched: Array) -> Array:
    """Drift (presses, H, W, 3) [counts] of each picture against the untouched one (H, W, 3) of 8 bit."""
    change = np.array([press.picture.astype(float) - untouched for press in presses])
    rest = np.array([~near(press, REST_CONTACT_RADII) for press in presses])
    seen = rest[..., None].astype(float)
    count = gaussian_filter(seen.sum(axis=0), (DRIFT_BLUR_PX, DRIFT_BLUR_PX, 0))
    common = np.zeros(untouched.shape)
    for _ in range(SHADE_PASSES):
        shade = np.array([(one - common)[where].mean(axis=0) if where.any() else np.zeros(3)
                          for one, where in zip(change, rest, strict=True)])[:, None, None]  # fmt: skip
        sums = gaussian_filter(((change - shade) * seen).sum(axis=0), (DRIFT_BLUR_PX, DRIFT_BLUR_PX, 0))
        common = np.where(count > MIN_PICTURES_AT_REST, sums / np.maximum(count, MIN_PICTURES_AT_REST), 0.0)
    return np.asarray(common + shade)


def removed(presses: Sequence[PhotographedPress], untouched: Array) -> tuple[PhotographedPress, ...]:
    """Presses whose pictures are as if no drift lay between them and the untouched one; contacts must be known."""
    if not presses:
        return ()
    found = [press.picture - drift for press, drift in zip(presses, changes(presses, untouched), strict=True)]
    pictures = [np.clip(np.round(picture), 0, 255).astype(np.uint8) for picture in found]
    return tuple(replace(press, picture=picture) for press, picture in zip(presses, pictures, strict=True))
