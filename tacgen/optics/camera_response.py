"""From linear radiance to the camera's 8-bit image: focus, colours, vignetting, exposure, noise, response."""

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from tacgen.compiled import njit
from tacgen.optics.gaussian import blur

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor.model import Camera

    Floats = NDArray[np.float64]

CELLS = 4096  # of the light from 0 to 1, in each of which the search for a pixel's count starts


def vignette(camera: "Camera") -> "Floats":
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


def colours(camera: "Camera") -> "Floats":
    """Matrix (3, 3) from the sensor's own red, green and blue to those of its counts."""
    return np.eye(3) if camera.colour_matrix is None else np.array(camera.colour_matrix)


def blurred(radiance: "Floats", camera: "Camera") -> "Floats":
    """A radiance picture (H, W, 3) out of focus: the image of a point is a Gaussian of standard deviation blur_mm."""
    return blur(radiance, camera.blur_mm / camera.mm_per_px) if camera.blur_mm else radiance


def encoded(light: "Floats", camera: "Camera") -> "Floats":
    """Pixel values over full scale for light clipped to [0, 1], by the sRGB curve (IEC 61966-2-1) or linear."""
    return _curve(light, camera.response)


def _curve(light: "Floats", response: str) -> "Floats":
    x = np.clip(light, 0.0, 1.0)
    return x if response == "linear" else np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def linear(counts: "Floats", camera: "Camera") -> "Floats":
    """The inverse of `encoded`."""
    if camera.response == "linear":
        return np.asarray(counts, dtype=float)
    return np.where(counts <= 0.04045, counts / 12.92, ((counts + 0.055) / 1.055) ** 2.4)


def slope(light: "Floats", camera: "Camera") -> "Floats":
    """d encoded / d light."""
    if camera.response == "linear":
        return np.ones_like(light)
    return np.where(light <= 0.0031308, 12.92, 1.055 / 2.4 * np.maximum(light, 1e-4) ** (1 / 2.4 - 1))


def stray(camera: "Camera") -> "Floats":
    """Radiance (3,) of a coating without dots in the stray light alone: `ambient` after colours and exposure."""
    return np.asarray(np.linalg.solve(colours(camera), camera.ambient) / camera.exposure)


def expose(radiance: "Floats", camera: "Camera") -> "Floats":
    """Linear signal over full scale (H, W, 3) of a radiance image (H, W, 3)."""
    mixed = radiance if camera.colour_matrix is None else radiance @ colours(camera).T
    return np.asarray(mixed * (camera.exposure * vignette(camera)))


def unexposed(light: "Floats", camera: "Camera") -> "Floats":
    """The inverse of `expose`."""
    even = light / (camera.exposure * vignette(camera))
    return even if camera.colour_matrix is None else np.asarray(even @ np.linalg.inv(colours(camera)).T)


def develop(
    radiance: "NDArray[np.floating]",
    camera: "Camera",
    random: np.random.Generator | None = None,
    gain: "Floats | None" = None,
) -> "NDArray[np.uint8]":
    """The 8-bit picture (H, W, 3) of a radiance picture (H, W, 3), with noise if `random` is given; `gain` (3,) is a
    factor on the light of each of the camera's colours."""
    shot, read, strength, source = (0.0,) * 3, (0.0,) * 3, 0.0, np.random.default_rng(0)
    if random is not None and camera.noise is not None:
        shot, read, strength, source = camera.noise.shot, camera.noise.read, camera.noise.strength, random
    grain = np.array(shot), np.array(read), strength, source
    mix = colours(camera) if gain is None else colours(camera) * gain[:, None]
    return np.asarray(_counted(radiance, mix, vignette(camera), camera.exposure, *grain, *_steps(camera.response)))


@lru_cache(maxsize=2)
def _steps(response: str) -> "tuple[Floats, NDArray[np.int64]]":
    """The least light that is rounded to each count (256,) and infinity, by bisection of the curve; and the counts at
    the lower ends of CELLS equal cells of light."""
    count, low, most = np.arange(256), np.zeros(256), np.ones(256)
    for _ in range(80):  # halvings: a double has 53 bits, and the darkest step is above 2^-13
        middle = (low + most) / 2
        above = np.round(255.0 * _curve(middle, response)) >= count
        low, most = np.where(above, low, middle), np.where(above, middle, most)
    return np.append(most, np.inf), np.searchsorted(most[1:], np.arange(CELLS) / CELLS, side="right")


@njit(cache=False)
def noisy(light: float, shot: float, read: float, strength: float, normal: float) -> float:
    """A linear signal over full scale with white noise of variance (shot x signal + read^2) strength^2.

    The normal distribution, of which `normal` is a sample, approximates Poisson's well, since a full pixel has
    thousands of electrons.
    """
    variance = shot * min(max(light, 0.0), 1.0) + read**2
    return light + strength * math.sqrt(variance) * normal


@njit(cache=True)
def _counted(
    radiance: "NDArray[np.floating]", mix: "Floats", fall: "Floats", exposure: float, shot: "Floats", read: "Floats",
    strength: float, random: np.random.Generator, steps: "Floats", cells: "NDArray[np.int64]",
) -> "NDArray[np.uint8]":  # fmt: skip
    """All in one loop, because a picture's temporary arrays cost more than its arithmetic; without noise, `strength` 0,
    nothing is drawn. Compiled code draws the normal numbers of `random.standard_normal(radiance.shape)`, in a third of
    the time."""
    height, width, _ = radiance.shape
    out, normal = np.zeros((height, width, 3), np.uint8), np.zeros((width, 3))
    for y in range(height):
        if strength > 0.0:
            for x in range(width):
                for c in range(3):
                    normal[x, c] = random.standard_normal()
        for x in range(width):
            for c in range(3):
                light = radiance[y, x, 0] * mix[c, 0] + radiance[y, x, 1] * mix[c, 1] + radiance[y, x, 2] * mix[c, 2]
                light *= exposure * fall[y, x, c]
                if strength > 0.0:
                    light = noisy(light, shot[c], read[c], strength, normal[x, c])
                if light >= 1.0:
                    out[y, x, c] = 255
                elif light > 0.0:
                    count = cells[int(light * CELLS)]
                    while light >= steps[count + 1]:
                        count += 1
                    out[y, x, c] = count
    return out
