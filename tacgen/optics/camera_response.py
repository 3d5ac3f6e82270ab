"""From linear radiance to the camera's 8-bit image: focus, colours, vignetting, exposure, response, stray light."""

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from tacgen.optics.noise import noisy

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.description import Eye

    Floats = NDArray[np.float64]


def vignette(camera: "Eye") -> "Floats":
    """Fall-off (H, W, 3) toward the corners, 1 on the axis: 1 / (1 + (r/r0)^2)^2 with r at the scale on the untouched
    coating."""
    size = camera.width_px, camera.height_px, camera.mm_per_px
    return _fall_off(*size, *camera.crop_mm, camera.vignette_mm or (np.inf,) * 3)


@lru_cache(maxsize=4)
def _fall_off(w: int, h: int, scale: float, right: float, down: float, radii: tuple[float, ...]) -> "Floats":
    x, y = (np.arange(w) + 0.5 - w / 2) * scale + right, (np.arange(h) + 0.5 - h / 2) * scale + down
    r2 = x**2 + y[:, None] ** 2
    fall = 1.0 / (1.0 + r2[..., None] / np.square(radii)) ** 2
    fall.flags.writeable = False  # shared by the frames of a scene
    return fall


def colours(camera: "Eye") -> "Floats":
    """Matrix (3, 3) from the sensor's own red, green and blue to those of its counts."""
    return np.eye(3) if camera.colour_matrix is None else np.array(camera.colour_matrix)


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
    """Radiance (H, W, 3) of a coating without dots in the stray light alone: `ambient` after colours and exposure."""
    even = np.linalg.solve(colours(camera), camera.ambient) / camera.exposure
    return np.broadcast_to(even, (camera.height_px, camera.width_px, 3))


def expose(radiance: "Floats", camera: "Eye") -> "Floats":
    """Linear signal over full scale (H, W, 3) of a radiance image (H, W, 3)."""
    mixed = radiance if camera.colour_matrix is None else radiance @ colours(camera).T
    return np.asarray(mixed * (camera.exposure * vignette(camera)))


def unexposed(light: "Floats", camera: "Eye") -> "Floats":
    """The inverse of `expose`."""
    even = light / (camera.exposure * vignette(camera))
    return even if camera.colour_matrix is None else np.asarray(even @ np.linalg.inv(colours(camera)).T)


def develop(radiance: "Floats", camera: "Eye", random: np.random.Generator | None = None) -> "NDArray[np.uint8]":
    """The 8-bit picture (H, W, 3) of a radiance picture (H, W, 3), with noise if `random` is given."""
    light = expose(radiance, camera)
    if random is not None and camera.noise is not None:
        light = noisy(light, camera.noise, random)
    return np.asarray(np.round(255.0 * encoded(light, camera)), dtype=np.uint8)
