"""Grain, marks and wear of the coating: a factor on its light over rest coordinates, so that it moves with the gel; and
the slopes of its relief.

One field is made for a sensor; each picture interpolates it. What the pattern changes in the light that coating and
walls reflect to one another is neglected: it averages out.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tacgen.physics import coat
from tacgen.physics.runtime import call

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor.imperfections import Marks, Wear
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
    rows, columns = _nodes(size, pixel)
    x, y = ((np.arange(n) + 0.5) / n * side - side / 2 for n, side in zip((columns, rows), size, strict=True))
    field = np.ones((rows, columns))
    if coating.grain is not None:
        grain = coating.grain
        waves = _Waves.drawn(grain.seed, grain.length_mm, size, pixel)
        field += grain.contrast * waves.field(waves.numbers)
    if coating.marks is not None:
        _mark(field, coating.marks, x, y, size, pixel)
    if coating.wear is not None:
        field *= _worn(coating.wear, x, y)
    return np.maximum(field, 0.0)


def relief(coating: "Coating", size: tuple[float, float], pixel: float) -> "Floats | None":
    """Slopes (2, h, w) [-] along x and y of the coating's inner side where its relief is pressed flat, at the nodes of
    `texture`; None without a relief."""
    rough = coating.relief
    if rough is None:
        return None
    waves = _Waves.drawn(rough.seed, rough.length_mm, size, pixel)
    along = (2j * np.pi * rough.height_mm * f * waves.numbers for f in (waves.across, waves.down))
    return np.stack([waves.field(each) for each in along])


def _nodes(size: tuple[float, float], pixel: float) -> tuple[int, int]:
    """Rows and columns of a field's nodes."""
    columns, rows = (max(2, round(side / max(pixel / 2, MIN_TEXTURE_SPACING_MM))) for side in size)
    return rows, columns


class _Waves(NamedTuple):
    """A Gaussian random field in Fourier space, periodic beyond the rectangle, over more lengths than the correlation
    reaches."""

    numbers: "NDArray[np.complex128]"  # (down, half of across)
    down: "Floats"  # frequencies [1/mm], (n, 1)
    across: "Floats"  # [1/mm], (m,)
    periods: tuple[int, int]  # nodes down and across
    shape: tuple[int, int]  # nodes of the rectangle

    @classmethod
    def drawn(cls, seed: int, length: float, size: tuple[float, float], pixel: float) -> "_Waves":
        """A field with mean 0 and variance 1 whose correlation falls as exp(-distance / length), averaged over a pixel.

            S(f) = 2 pi length^2 / (1 + (2 pi f length)^2)^(3/2)      [mm^2], f [1/mm]

        White noise is multiplied by the root of S in Fourier space, where the pixel is a product of two sinc.
        """
        from scipy.fft import next_fast_len, rfft2

        shape = _nodes(size, pixel)
        spacing = [side / n for n, side in zip(shape, size[::-1], strict=True)]
        y, x = (next_fast_len(n + round(6 * length / by), real=True) for n, by in zip(shape, spacing, strict=True))
        white = np.random.default_rng(seed).standard_normal((y, x))
        down = np.fft.fftfreq(y, spacing[0])[:, None].astype(np.float64)
        across = np.fft.rfftfreq(x, spacing[1]).astype(np.float64)
        squared = (2 * np.pi * length) ** 2 * (down**2 + across**2)
        root = length * np.sqrt(2 * np.pi / (spacing[0] * spacing[1])) / (1 + squared) ** 0.75
        seen = root * np.sinc(pixel * down) * np.sinc(pixel * across)
        return cls(np.asarray(rfft2(white) * seen), down, across, (y, x), shape)

    def field(self, numbers: "NDArray[np.complex128]") -> "Floats":
        """Values (h, w) at the nodes of the rectangle, by numbers in Fourier space."""
        from scipy.fft import irfft2

        return np.asarray(irfft2(numbers, s=self.periods)[: self.shape[0], : self.shape[1]])


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
    call(coat.pattern, (len(xy),), field.reshape(-1), *_grid(field.shape, size), xy, out)
    return out


def embossed(
    normals: "Floats", share: "Floats", rest: "Floats", slopes: "Floats", size: tuple[float, float]
) -> "Floats":
    """Unit normals into the gel (n, 3) turned by slopes (2, h, w) along x and y over a rectangle of `size` (x, y) [mm],
    of a relief at right angles to the face; share of contact (n,) and rest positions (n, 2) [mm]."""
    out, along = np.empty_like(normals), slopes.reshape(2, -1)
    call(coat.emboss, (len(normals),), normals, share, rest, *along, *_grid(slopes.shape[1:], size), out)
    return out


def _grid(shape: tuple[int, ...], size: tuple[float, float]) -> tuple[float, ...]:
    """Rows and columns of a field over a rectangle, and its nodes a mm along x and y, as kernels take them."""
    return *shape, *(n / side for n, side in zip(shape[::-1], size, strict=True))
