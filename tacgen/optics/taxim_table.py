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

from tacgen.base.compiled import njit
from tacgen.optics.hertz_dent import BallDent

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.surface_grid import Surface
    from tacgen.sensor.model import LitSensor

    Floats = NDArray[np.float64]

SLOPE_BINS = 41  # of each slope component, the sine of its angle from -1 to 1
BIN_SHARING = ((1.0, 1.0), (4.0, 1e-3), (16.0, 1e-6))  # widths [bins] and weights by which bins share their samples
POSITION_RIDGE = 0.05  # ridge penalty of the position-dependent terms, over the number of a bin's samples [-]
DENT_OFFSETS = (-0.6, -0.2, 0.2, 0.6)
# centres of dents from the picture's middle, over half its size [-]
DENT_CENTRES = [(x, y) for y in DENT_OFFSETS for x in DENT_OFFSETS]
# radius over the gel's thickness, sine of the largest slope
DENT_BALLS = [(1.2, 0.6), (0.6, 0.9), (1.5, 0.35), (0.8, 0.75)]
# spacing of pixels whose shadows are computed, and of the points tested on the line to a lamp [px]
SHADOW_SPACING_PX = 4


@dataclass(frozen=True)
class Face:
    """A face as the camera sees it: heights (h, w) [mm] and, against the untouched face, slopes (h, w, 2) [-]."""

    height: "Floats"
    slope: "Floats"

    @classmethod
    def of(cls, height: "Floats", normal: "Floats", untouched: "Floats") -> "Face":
        """From unit normals (h, w, 3) now and untouched; no gel there: as if untouched."""
        return cls(*_bent(height, normal, untouched))


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
            _accumulate(a, b, index, basis, light.reshape(-1, 3))
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
        return _look_up(self.terms, face.slope, quadratic_basis(face.height.shape), dark)


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


@njit(cache=True)
def _accumulate(a: "Floats", b: "Floats", index: "NDArray[np.int64]", basis: "Floats", light: "Floats") -> None:
    """Add samples (n, 6) and their light (n, 3) to the normal equations of their bins."""
    for s in range(len(index)):
        for i in range(6):
            for j in range(6):
                a[index[s], i, j] += basis[s, i] * basis[s, j]
            for c in range(3):
                b[index[s], i, c] += basis[s, i] * light[s, c]


@njit(cache=True)
def _bent(height: "Floats", normal: "Floats", untouched: "Floats") -> tuple["Floats", "Floats"]:
    """Heights (h, w) and differences of normals in x and y (h, w, 2); 0 where they are nan."""
    h, w = height.shape
    out, slope = np.empty((h, w)), np.empty((h, w, 2))
    for y in range(h):
        for x in range(w):
            out[y, x] = 0.0 if np.isnan(height[y, x]) else height[y, x]
            for k in range(2):
                bend = normal[y, x, k] - untouched[y, x, k]
                slope[y, x, k] = 0.0 if np.isnan(bend) else bend
    return out, slope


@njit(cache=True)
def _look_up(terms: "Floats", slope: "Floats", basis: "Floats", dark: "Floats") -> "Floats":
    """The table's light (h, w, 3), bilinear between bins, less what is `dark` at every COARSE-th pixel and beyond."""
    h, w, _ = slope.shape
    n, rows, columns = terms.shape[0] - 1, dark.shape[0] - 1, dark.shape[1] - 1
    out, numbers, here = np.empty((h, w, 3)), terms.ravel(), np.empty(18)
    for y in range(h):
        j0, d = _between((y - SHADOW_SPACING_PX // 2) / SHADOW_SPACING_PX, rows)
        for x in range(w):
            i, a = _between((slope[y, x, 0] + 1) / 2 * n, n)
            j, b = _between((slope[y, x, 1] + 1) / 2 * n, n)
            low = numbers[18 * (j * (n + 1) + i) :][:36]  # as slices, so that the loop becomes vector instructions
            high = numbers[18 * ((j + 1) * (n + 1) + i) :][:36]
            for m in range(18):
                here[m] = (1 - b) * ((1 - a) * low[m] + a * low[m + 18]) + b * ((1 - a) * high[m] + a * high[m + 18])
            i0, e = _between((x - SHADOW_SPACING_PX // 2) / SHADOW_SPACING_PX, columns)
            for c in range(3):
                light = 0.0
                for k in range(6):
                    light += basis[y, x, k] * here[3 * k + c]
                above = (1 - e) * dark[j0, i0, c] + e * dark[j0, i0 + 1, c]
                below = (1 - e) * dark[j0 + 1, i0, c] + e * dark[j0 + 1, i0 + 1, c]
                out[y, x, c] = light - ((1 - d) * above + d * below)
    return out


@njit(cache=False)
def _between(at: float, last: int) -> tuple[int, float]:
    """The index below `at` among 0, 1, ... last, and the weight of the index above it; constant beyond the ends."""
    at = min(max(at, 0.0), last - 1e-9)
    return int(at), at - int(at)


@njit(cache=True)
def shadows(height: "Floats", lamps: "Floats", mm_per_px: float) -> "Floats":
    """How much (h, w, lamps), 0 to 1, of each lamp is hidden from each pixel, by the line to its nearest point.

    Args:
        height: of the face [mm], (h, w).
        lamps: ends of each strip and half its height [mm], (lamps, 7), in the frame of the picture's centre.
        mm_per_px: a pixel's size on the face.
    """
    h, w = height.shape
    lowest, step = height.min(), mm_per_px
    out = np.zeros((h, w, len(lamps)))
    for k in range(len(lamps)):
        along = lamps[k, 3:6] - lamps[k, :3]
        length2 = max((along * along).sum(), 1e-12)
        for y in range(h):
            for x in range(w):
                px, py, pz = (x + 0.5 - w / 2) * mm_per_px, (y + 0.5 - h / 2) * mm_per_px, height[y, x]
                t = ((px - lamps[k, 0]) * along[0] + (py - lamps[k, 1]) * along[1]) / length2
                t = min(max(t, 0.0), 1.0)
                dx, dy = lamps[k, 0] + t * along[0] - px, lamps[k, 1] + t * along[1] - py
                far = max(np.sqrt(dx * dx + dy * dy), 1e-9)
                rise = (lamps[k, 2] + t * along[2] - pz) / far
                s = step
                while s < far:
                    z = pz + s * rise
                    u, v = x + s * dx / far / mm_per_px, y + s * dy / far / mm_per_px
                    if u < 0 or v < 0 or u > w - 1 or v > h - 1 or (z < lowest and rise <= 0):
                        break
                    share = (z - height[int(v + 0.5), int(u + 0.5)]) / max(lamps[k, 6] * s / far, 1e-3)
                    out[y, x, k] = max(out[y, x, k], min(share, 1.0))
                    s += step
    return out
