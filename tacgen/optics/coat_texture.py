"""Grain, marks and wear of the coating: a factor on its light over rest coordinates, so that it moves with the gel.

One field is made for a sensor; each picture interpolates it. What the pattern changes in the light that coating and
walls reflect to one another is neglected: it averages out.
"""

from typing import TYPE_CHECKING

import numpy as np

from tacgen.physics import coat
from tacgen.physics.runtime import call

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor.imperfections import Grain, Marks, Wear
    from tacgen.sensor.model import Coating

    Floats = NDArray[np.float64]

MIN_TEXTURE_SPACING_MM = 0.01  # least distance of the field's nodes [mm]: a few million for a pad
MIN_MARK_RATIO = 0.25  # size and depth of the least mark over those of the largest


def texture(coating: "Coating", size: tuple[float, float], pixel: float) -> "Floats | None":
    """The factor (h, w) [-] over a rectangle of `size` (x, y) [mm] centred on the pad, row 0 at the least y.

    It is averaged over pixels of side `pixel` [mm], and its nodes are half of that apart, the outermost half of their
    distance inside the rectangle. None for an even coating.
    """
    if coating.grain is None and coating.marks is None and coating.wear is None:
        return None
    columns, rows = (max(2, round(side / max(pixel / 2, MIN_TEXTURE_SPACING_MM))) for side in size)
    x, y = ((np.arange(n) + 0.5) / n * side - side / 2 for n, side in zip((columns, rows), size, strict=True))
    field = np.ones((rows, columns))
    if coating.grain is not None:
        spacing = size[1] / rows, size[0] / columns
        field += _grain(coating.grain, field.shape, spacing, pixel)
    if coating.marks is not None:
        _mark(field, coating.marks, x, y, size, pixel)
    if coating.wear is not None:
        field *= _worn(coating.wear, x, y)
    return np.maximum(field, 0.0)


def _grain(grain: "Grain", shape: tuple[int, ...], spacing: tuple[float, float], pixel: float) -> "Floats":
    """A Gaussian random field with mean 0 whose correlation falls as exp(-distance / length), averaged over a pixel.

        S(f) = contrast^2 2 pi length^2 / (1 + (2 pi f length)^2)^(3/2)      [mm^2], f [1/mm]

    White noise is multiplied by the root of S in Fourier space, where the pixel is a product of two sinc. The field is
    periodic beyond the rectangle, over more lengths than the correlation reaches.
    """
    from scipy.fft import irfft2, next_fast_len, rfft2

    reach = 6 * grain.length_mm
    periods = [next_fast_len(n + round(reach / by), real=True) for n, by in zip(shape, spacing, strict=True)]
    white = np.random.default_rng(grain.seed).standard_normal(periods)
    down, across = np.fft.fftfreq(periods[0], spacing[0])[:, None], np.fft.rfftfreq(periods[1], spacing[1])
    squared = (2 * np.pi * grain.length_mm) ** 2 * (down**2 + across**2)
    root = grain.contrast * grain.length_mm * np.sqrt(2 * np.pi / (spacing[0] * spacing[1])) / (1 + squared) ** 0.75
    seen = root * np.sinc(pixel * down) * np.sinc(pixel * across)
    return np.asarray(irfft2(rfft2(white) * seen, s=periods)[: shape[0], : shape[1]])


def _mark(field: "Floats", marks: "Marks", x: "Floats", y: "Floats", size: tuple[float, float], pixel: float) -> None:
    """Multiply the field at (y, x) by the light that specks and scratches leave; their edges are a pixel wide."""
    kinds = (marks.specks, marks.speck_mm, 0.0), (marks.scratches, marks.scratch_width_mm, marks.scratch_mm)
    for kind, (count, width, length) in enumerate(kinds):
        random = np.random.default_rng((marks.seed, kind)).random((count, 6))  # more marks leave the first ones
        for across, down, turn, large, deep, kind_of in random:
            share = MIN_MARK_RATIO + (1 - MIN_MARK_RATIO) * large
            wide, long = (width, length * share) if length else (width * share, 0.0)
            middle = (across - 0.5) * size[0], (down - 0.5) * size[1]
            change = marks.depth * (MIN_MARK_RATIO + (1 - MIN_MARK_RATIO) * deep)
            bright = not length and kind_of < marks.bright
            reach = (long + wide) / 2 + pixel
            there = np.ix_(np.abs(y - middle[1]) < reach, np.abs(x - middle[0]) < reach)
            away = _distance(x[there[1]] - middle[0], y[there[0]] - middle[1], np.pi * turn, long / 2)
            # a mark narrower than a pixel covers a part of it
            cover = np.clip((wide / 2 - away) / pixel + 0.5, 0.0, min(1.0, wide / pixel))
            field[there] *= 1 + change * cover if bright else 1 - change * cover


def _distance(x: "Floats", y: "Floats", angle: float, half: float) -> "Floats":
    """Distance [mm] of places from the segment of length 2 `half` through 0 at an angle to x; a point if half is 0."""
    along, beside = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    return np.asarray(np.hypot(np.maximum(np.abs(along) - half, 0.0), beside))


def _worn(wear: "Wear", x: "Floats", y: "Floats") -> "Floats":
    across, down = wear.center_mm
    squared = (x - across) ** 2 + (y[:, None] - down) ** 2
    return np.asarray(1 - wear.loss * np.exp(-squared / (2 * wear.radius_mm**2)))


def sampled(field: "Floats", size: tuple[float, float], xy: "Floats") -> "Floats":
    """The field (h, w) over a rectangle of `size` (x, y) [mm], interpolated linearly at rest positions xy (n, 2) [mm];
    constant beyond its nodes, and 1 where the position is nan."""
    out = np.empty(len(xy))
    call(
        coat.pattern,
        (len(xy),),
        field.reshape(-1),
        *field.shape,
        *(n / side for n, side in zip(field.shape[::-1], size, strict=True)),
        xy,
        out,
    )
    return out
