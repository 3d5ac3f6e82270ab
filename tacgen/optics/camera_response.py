"""From linear radiance to the camera's 8-bit image: focus, vignetting, exposure, response curve, stray light."""

from typing import TYPE_CHECKING

import numpy as np

from tacgen.optics.noise import noisy

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.description import Eye

    Floats = NDArray[np.float64]


def vignette(camera: "Eye") -> "Floats":
    """Fall-off (H, W) of the lens, 1 on the axis: 1 / (1 + (r/r0)^2)^2 with r at the scale on the untouched coating."""
    y, x = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
    right = (x - camera.width_px / 2) * camera.mm_per_px + camera.crop_mm[0]
    down = (y - camera.height_px / 2) * camera.mm_per_px + camera.crop_mm[1]
    r2 = right**2 + down**2
    return np.ones_like(r2) if camera.vignette_mm is None else 1.0 / (1.0 + r2 / camera.vignette_mm**2) ** 2


def blurred(radiance: "Floats", camera: "Eye") -> "Floats":
    """A radiance picture (H, W, 3) out of focus: the image of a point is a Gaussian of standard deviation blur_mm."""
    if not camera.blur_mm:
        return radiance
    from scipy.ndimage import gaussian_filter

    sd = camera.blur_mm / camera.mm_per_px
    return np.asarray(gaussian_filter(radiance, (sd, sd, 0), mode="nearest"))


def encoded(light: "Floats", camera: "Eye") -> "Floats":
    """Pixel values over full scale for light clipped to [0, 1], by the sRGB curve (IEC 61966-2-1) or linear."""
    x = np.clip(light, 0.0, 1.0)
    return x if camera.response == "linear" else np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def linear(counts: "Floats", camera: "Eye") -> "Floats":
    """The inverse of `encoded`."""
    if camera.response == "linear":
        return np.asarray(counts, dtype=float)
    return np.where(counts <= 0.04045, counts / 12.92, ((counts + 0.055) / 1.055) ** 2.4)


def slope(light: "Floats", camera: "Eye") -> "Floats":
    """d encoded / d light."""
    if camera.response == "linear":
        return np.ones_like(light)
    return np.where(light <= 0.0031308, 12.92, 1.055 / 2.4 * np.maximum(light, 1e-4) ** (1 / 2.4 - 1))


def stray(camera: "Eye") -> "Floats":
    """Radiance (H, W, 3) of a coating without dots in the stray light alone, so that the image has `ambient`."""
    return np.asarray(np.array(camera.ambient) / (camera.exposure * vignette(camera)[..., None]))


def expose(radiance: "Floats", camera: "Eye") -> "Floats":
    """Linear signal over full scale (H, W, 3) of a radiance image (H, W, 3)."""
    return np.asarray(radiance * (camera.exposure * vignette(camera)[..., None]))


def develop(radiance: "Floats", camera: "Eye", random: np.random.Generator | None = None) -> "NDArray[np.uint8]":
    """The 8-bit picture (H, W, 3) of a radiance picture (H, W, 3), with noise if `random` is given."""
    light = expose(radiance, camera)
    if random is not None and camera.noise is not None:
        light = noisy(light, camera.noise, random)
    return np.asarray(np.round(255.0 * encoded(light, camera)), dtype=np.uint8)
