"""Images by a look-up table, as in Taxim: milliseconds an image, with a larger error.

The light that a dent adds to a pixel is a polynomial of the pixel's position, one for each slope of the face (Si and
Yuan, Taxim: An Example-based Simulation Model for GelSight Tactile Sensors, RA-L 2022, III-A), reduced by a share for
each shadowed lamp (III-B). Both are fitted to images of known dents. Slopes are relative to the untouched face, so
that a dome needs no special treatment.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from tacgen.optics.hertz_dent import BallDent
from tacgen.physics import runtime, taxim
from tacgen.physics.taxim import SHADOW_SPACING_PX, SLOPE_BINS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.surface_grid import Surface
    from tacgen.sensor.model import LitSensor

    Floats = NDArray[np.float64]

BIN_SHARING = ((1.0, 1.0), (4.0, 1e-3), (16.0, 1e-6))  # widths [bins] and weights by which bins share their samples
POSITION_RIDGE = 0.05  # ridge penalty of the position-dependent terms, over the number of a bin's samples [-]
DENT_OFFSETS = (-0.6, -0.2, 0.2, 0.6)
# centres of dents from the picture's middle, over half its size [-]
DENT_CENTRES = [(x, y) for y in DENT_OFFSETS for x in DENT_OFFSETS]
# radius over the gel's thickness, sine of the largest slope
DENT_BALLS = [(1.2, 0.6), (0.6, 0.9), (1.5, 0.35), (0.8, 0.75)]


@dataclass(frozen=True)
class Face:
    """A face as the camera sees it: heights (h, w) [mm] and, against the untouched face, slopes (h, w, 2) [-]."""

    height: "Floats"
    slope: "Floats"

    @classmethod
    def of(cls, height: "Floats", normal: "Floats", untouched: "Floats") -> "Face":
        """From unit normals (h, w, 3) now and untouched; no gel there: as if untouched."""
        out, slope = np.empty(height.shape), np.empty((*height.shape, 2))
        normals = normal.reshape(-1, 3), untouched.reshape(-1, 3)
        runtime.call(taxim.bent, (height.size,), height.reshape(-1), *normals, out.reshape(-1), slope.reshape(-1, 2))
        return cls(out, slope)


@dataclass(frozen=True)
class TaximTable:
    """Added light for each slope and position, and the light that is missing in the shadow of each lamp."""

    terms: "Floats"  # (SLOPE_BINS, SLOPE_BINS, 6, 3): of 1, x, y, x^2, x y, y^2 with x, y from -1 to 1 over the picture
    shade: "Floats"  # (lamps, 3): light that is missing where a lamp is wholly hidden

    @classmethod
    def fitted(cls, faces: list[Face], added: list["Floats"], lamps: "Floats", mm_per_px: float) -> "TaximTable":
        """By least squares, from pictures (h, w, 3) of what dents add to the untouched picture.

        Args:
            lamps, mm_per_px: see shadows.

        The shadows are fitted to what the polynomials leave: most of what a dent hides from a lamp turns away from it.
        """
        a, b = np.zeros((SLOPE_BINS * SLOPE_BINS, 6, 6)), np.zeros((SLOPE_BINS * SLOPE_BINS, 6, 3))
        for face, light in zip(faces, added, strict=True):
            basis, index = quadratic_basis(light.shape[:2]).reshape(-1, 6), _bin(face.slope).ravel()
            runtime.call(taxim.accumulated, (1,), index, basis, light.reshape(-1, 3), a, b)
        table = cls(_solved(a, b), np.zeros((len(lamps), 3)))
        dark = [shadows(face.height, lamps, mm_per_px).reshape(-1, len(lamps)) for face in faces]
        left = [
            (table.added(face, lamps, mm_per_px) - light).reshape(-1, 3)
            for face, light in zip(faces, added, strict=True)
        ]
        shade = np.linalg.lstsq(np.concatenate(dark), np.concatenate(left), rcond=None)[0]
        return cls(table.terms, np.maximum(shade, 0.0))

    @classmethod
    def mixed(cls, tables: list["TaximTable"], light: "Floats") -> "TaximTable":
        """That of all lamps together, from tables (lamps) of each alone and their radiance (lamps, 3)."""
        lit = list(zip(tables, light, strict=True))
        terms, shade = sum(table.terms * rgb for table, rgb in lit), [table.shade[0] * rgb for table, rgb in lit]
        return cls(np.asarray(terms), np.array(shade))

    @property
    def packed(self) -> "Floats":
        """All its numbers in a row."""
        return np.concatenate([self.terms.ravel(), self.shade.ravel()])

    @classmethod
    def unpacked(cls, numbers: "Floats") -> "TaximTable":
        """From `packed`."""
        size = SLOPE_BINS * SLOPE_BINS * 18
        return cls(numbers[:size].reshape(SLOPE_BINS, SLOPE_BINS, 6, 3), numbers[size:].reshape(-1, 3))

    def added(self, face: Face, lamps: "Floats", mm_per_px: float) -> "Floats":
        """Linear radiance (h, w, 3) that the face adds to the untouched picture; see `fitted` for the arguments."""
        some = np.ascontiguousarray(
            face.height[SHADOW_SPACING_PX // 2 :: SHADOW_SPACING_PX, SHADOW_SPACING_PX // 2 :: SHADOW_SPACING_PX]
        )
        dark = np.pad(
            shadows(some, lamps, SHADOW_SPACING_PX * mm_per_px) @ self.shade, ((0, 1), (0, 1), (0, 0)), "edge"
        )
        shape = face.height.shape
        terms, slope, basis = self.terms.reshape(-1, 3), face.slope.reshape(-1, 2), quadratic_basis(shape)
        out = np.empty((len(slope), 3))
        runtime.call(taxim.looked_up, out.shape[:1], terms, slope, basis.reshape(-1, 6), dark, shape[1], out)
        return out.reshape(*shape, 3)


def dents(sensor: "LitSensor", untouched: "Surface") -> Iterator[BallDent]:
    """Dents on which a table is calibrated: balls of four sizes, pressed lightly and deeply, all over the picture."""
    gel, camera = sensor.gel, sensor.camera
    field = np.array([camera.width_px, camera.height_px]) * camera.mm_per_px / 2
    reach = np.minimum(field, np.array([gel.width_mm, gel.height_mm]) / 2)
    thick = sum(layer.thickness_mm for layer in gel.layers)
    for (x, y), (share, slope) in zip(DENT_CENTRES, cycle(DENT_BALLS), strict=False):
        at = np.add(camera.center_mm, camera.crop_mm) + reach * (x, y)
        yield BallDent(share * thick, slope * share * thick, (float(at[0]), float(at[1])), untouched, thick)


@cache
def quadratic_basis(shape: tuple[int, int]) -> "Floats":
    """1, x, y, x^2, x y, y^2 of each pixel's centre (h, w, 6), x and y from -1 to 1 over the picture."""
    y, x = ((np.arange(n) + 0.5) / n * 2 - 1 for n in shape)
    x, y = np.meshgrid(x, y)
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)


def _bin(slope: "Floats") -> "NDArray[np.int64]":
    """The nearest bin, counted row by row."""
    i = np.clip(np.rint((slope + 1) / 2 * (SLOPE_BINS - 1)), 0, SLOPE_BINS - 1).astype(np.int64)
    return np.asarray(i[..., 1] * SLOPE_BINS + i[..., 0])


def _solved(a: "Floats", b: "Floats") -> "Floats":
    """Polynomials (SLOPE_BINS, SLOPE_BINS, 6, 3) from the bins' normal equations (SLOPE_BINS^2, 6, 6) and
    (SLOPE_BINS^2, 6, 3).
    """
    from scipy.ndimage import gaussian_filter

    def shared(part: "Floats") -> "Floats":
        grid = part.reshape(SLOPE_BINS, SLOPE_BINS, -1)
        spread = [share * gaussian_filter(grid, (width, width, 0), mode="constant") for width, share in BIN_SHARING]
        return np.asarray(sum(spread).reshape(part.shape))

    left, right = shared(a), shared(b)
    drawn = np.diag([0.0, 1, 1, 1, 1, 1]) * POSITION_RIDGE
    left += left[:, :1, :1] * drawn + 1e-30 * np.eye(6)
    return np.asarray(np.linalg.solve(left, right).reshape(SLOPE_BINS, SLOPE_BINS, 6, 3), dtype=np.float64)


def shadows(height: "Floats", lamps: "Floats", mm_per_px: float) -> "Floats":
    """How much (h, w, lamps), 0 to 1, of each lamp is hidden from each pixel, by the line to its nearest point.

    Args:
        height: of the face [mm], (h, w).
        lamps: ends of each strip and half its height [mm], (lamps, 7), in the frame of the picture's centre.
        mm_per_px: a pixel's size on the face.
    """
    out = np.empty((*height.shape, len(lamps)))
    flat = height.reshape(-1)
    lowest = flat.min(keepdims=True)
    runtime.call(taxim.shadows, flat.shape, flat, lowest, lamps, height.shape[1], mm_per_px, out.reshape(-1))
    return out
