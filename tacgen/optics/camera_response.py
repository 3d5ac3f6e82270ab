"""From linear radiance to the camera's 8-bit image: focus, colours, vignetting, exposure, noise, response."""

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from tacgen.optics.gaussian import blur
from tacgen.physics import response
from tacgen.physics.response import RESPONSE_CELLS
from tacgen.physics.runtime import call

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor.model import Camera, Noise

    Floats = NDArray[np.float64]

NOISE_QUANTILES = 1 << 16  # of the normal distribution, from which noise is drawn
# cells of normal numbers, finer than counts, and standard deviations within which they are
NUMBER_CELLS, MOST_DEVIATIONS = 1 << 13, 5.0


def vignette(camera: "Camera") -> "Floats":
    """Fall-off (H, W, 3) toward the corners, 1 on the axis: 1 / (1 + (r/r0)^2)^2 with r at the scale on the untouched
    coating."""
    return _fall_off(camera, 1.0)


def exposed(camera: "Camera") -> "Floats":
    """Exposure times fall-off (H, W, 3)."""
    return _fall_off(camera, camera.exposure)


def _fall_off(camera: "Camera", exposure: float) -> "Floats":
    size = camera.width_px, camera.height_px, camera.pixel_mm
    return _fall_off_of(*size, *camera.crop_mm, camera.vignette_mm or (np.inf,) * 3, exposure)


@lru_cache(maxsize=4)
def _fall_off_of(
    w: int, h: int, pixel: tuple[float, float], right: float, down: float, radii: tuple[float, ...], exposure: float
) -> "Floats":
    x, y = (np.arange(w) + 0.5 - w / 2) * pixel[0] + right, (np.arange(h) + 0.5 - h / 2) * pixel[1] + down
    r2 = x**2 + y[:, None] ** 2
    fall = exposure * (1.0 / (1.0 + r2[..., None] / np.square(radii)) ** 2)
    fall.flags.writeable = False  # shared by the frames of a scene
    return fall


def colours(camera: "Camera") -> "Floats":
    """Matrix (3, 3) from the sensor's own red, green and blue to those of its counts."""
    return np.eye(3) if camera.colour_matrix is None else np.array(camera.colour_matrix)


def blurred(radiance: "Floats", camera: "Camera") -> "Floats":
    """A radiance picture (H, W, 3) out of focus: the image of a point is a Gaussian of standard deviation blur_mm."""
    wide, tall = camera.pixel_mm
    return blur(radiance, camera.blur_mm / tall, across=camera.blur_mm / wide) if camera.blur_mm else radiance


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


def glare(camera: "Camera") -> "Floats":
    """Radiance (H, W, 3) that makes the camera's glare, by cubic splines through its values."""
    from scipy.ndimage import map_coordinates

    assert camera.glare is not None
    height, width = camera.height_px, camera.width_px
    values = [np.array(rows) for rows in (camera.glare.red, camera.glare.green, camera.glare.blue)]
    rows, columns = values[0].shape
    at = np.meshgrid(
        (np.arange(height) + 0.5) / height * rows - 0.5, (np.arange(width) + 0.5) / width * columns - 0.5, indexing="ij"
    )
    return unexposed(np.stack([map_coordinates(one, at, mode="nearest") for one in values], axis=-1), camera)


def expose(radiance: "Floats", camera: "Camera") -> "Floats":
    """Linear signal over full scale (H, W, 3) of a radiance image (H, W, 3)."""
    mixed = radiance if camera.colour_matrix is None else radiance @ colours(camera).T
    return np.asarray(mixed * exposed(camera))


def unexposed(light: "Floats", camera: "Camera") -> "Floats":
    """The inverse of `expose`."""
    even = light / exposed(camera)
    return even if camera.colour_matrix is None else np.asarray(even @ np.linalg.inv(colours(camera)).T)


def develop(
    radiance: "NDArray[np.floating]",
    camera: "Camera",
    random: np.random.Generator | None = None,
    gain: "Floats | None" = None,
) -> "NDArray[np.uint8]":
    """The 8-bit picture (H, W, 3) of a radiance picture (H, W, 3), with noise if `random` is given; `gain` (3,) is a
    factor on the light of each of the camera's colours."""
    height, width, _ = radiance.shape
    out, noise, strength = np.empty(radiance.shape, np.uint8), None, 0.0
    if random is not None and camera.noise is not None:
        noise, strength = drawn(random, height, width, camera.noise), camera.noise.strength
    call(
        response.counted, (1, -(-height * width // response.PIXELS_PER_THREAD)),
        np.asarray(radiance, np.float32).reshape(-1), mix(camera, gain)[None], exposed(camera).reshape(-1),
        grain(camera), strength, None if noise is None else noise.reshape(-1), 3 * height * width, quantiles(),
        *steps(camera.response), out.reshape(-1),
    )  # fmt: skip
    return out


def grain(camera: "Camera") -> "Floats":
    """Shot and read noise of each colour (2, 3), 0 without."""
    return np.zeros((2, 3)) if camera.noise is None else np.array([camera.noise.shot, camera.noise.read])


def mix(camera: "Camera", gain: "Floats | None" = None) -> "Floats":
    """`colours` with a gain (3,) on each of the counts' colours."""
    return colours(camera) if gain is None else colours(camera) * gain[:, None]


def drawn(random: np.random.Generator, height: int, width: int, noise: "Noise | None" = None) -> "NDArray[np.uint16]":
    """Numbers of the quantiles (height, 3 width) that are a picture's noise, white or as `noise` has it."""
    if noise is None or noise.white:
        return random.integers(0, NOISE_QUANTILES, (height, 3 * width), np.uint16)
    return _patched(random, height, width, noise)


def _patched(random: np.random.Generator, height: int, width: int, noise: "Noise") -> "NDArray[np.uint16]":
    """Numbers (height, 3 width) of correlated noise: means over 2 x 2 squares, each of half the side of a patch, of
    normal numbers whose colours are mixed by the root of their correlation."""
    side = (noise.patch_px + 1) // 2
    rows, columns = -(-height // side), -(-width // side)
    more = int(noise.patch_px > 1)
    made = quantiles()[random.integers(0, NOISE_QUANTILES, (3, rows + more, columns + more), np.uint16)]
    if more:
        down = made[:, 1:] + made[:, :-1]
        made = (down[..., 1:] + down[..., :-1]) / 2  # the variance is still 1
    out = np.empty((rows, side * columns, 3), np.uint16)
    for c, row in enumerate(_root(noise.correlation) * np.float32(NUMBER_CELLS / (2 * MOST_DEVIATIONS))):
        # not by BLAS, whose sums differ from processor to processor
        at = row[0] * made[0] + row[1] * made[1] + row[2] * made[2] + np.float32(NUMBER_CELLS / 2)
        cells = np.clip(at, 0, NUMBER_CELLS - 1, out=at).astype(np.int32)
        out[..., c] = _numbers()[cells].repeat(side, axis=1)
    return np.asarray(out[:, :width].reshape(rows, 3 * width).repeat(side, axis=0)[:height], np.uint16)


def _root(correlation: tuple[float, float, float]) -> "NDArray[np.float32]":
    """Symmetric square root (3, 3) of the correlation of three colours."""
    a, b, c = correlation
    values, ways = np.linalg.eigh(np.array([[1.0, a, b], [a, 1.0, c], [b, c, 1.0]]))
    return np.asarray(ways * np.sqrt(np.maximum(values, 0.0)) @ ways.T, np.float32)


@lru_cache(maxsize=1)
def _numbers() -> "NDArray[np.uint16]":
    """Numbers of the quantiles (NUMBER_CELLS,) of normal numbers in equal cells of -+MOST_DEVIATIONS."""
    from scipy.special import ndtr

    middle = (np.arange(NUMBER_CELLS) + 0.5) / NUMBER_CELLS * 2 * MOST_DEVIATIONS - MOST_DEVIATIONS
    return np.asarray(np.minimum(ndtr(middle) * NOISE_QUANTILES, NOISE_QUANTILES - 1), np.uint16)


@lru_cache(maxsize=1)
def quantiles() -> "NDArray[np.float32]":
    """Values (NOISE_QUANTILES,) of which each is as likely as any other under the normal distribution of mean 0 and
    variance 1: one of them, chosen at random, is a normal number (inverse transform sampling, Devroye 1986, section
    II.2).
    """
    from scipy.special import ndtri

    middle = ndtri((np.arange(NOISE_QUANTILES) + 0.5) / NOISE_QUANTILES)
    return np.asarray(middle / np.sqrt(np.mean(middle**2)), np.float32)


@lru_cache(maxsize=2)
def steps(response: str) -> "tuple[Floats, NDArray[np.uint8]]":
    """The response in RESPONSE_CELLS equal cells of light from 0 on: the least light that is rounded to the count after
    that at a cell's lower end, infinite for the last, by bisection of the curve; and these counts; (RESPONSE_CELLS +
    1,) each.
    """
    count, low, most = np.arange(256), np.zeros(256), np.ones(256)
    for _ in range(80):  # halvings: a double has 53 bits, and the darkest step is above 2^-13
        middle = (low + most) / 2
        above = np.round(255.0 * _curve(middle, response)) >= count
        low, most = np.where(above, low, middle), np.where(above, middle, most)
    first = np.searchsorted(most[1:], np.arange(RESPONSE_CELLS + 1) / RESPONSE_CELLS, side="right")
    return np.append(most, np.inf)[first + 1], first.astype(np.uint8)
