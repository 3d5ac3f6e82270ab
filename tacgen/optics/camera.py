"""A pinhole camera behind flat clear layers: exact refraction, forward (project) and back (rays).

Frame: x right, y down in the image, z from the camera to the object; z = 0 is the untouched coated face.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.base.compiled import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor.model import Sensor

    Floats = NDArray[np.float64]

PROJECTION_BATCH = 64  # points that are projected together


@dataclass(frozen=True)
class Stack:
    """Flat layers crossed from the pinhole to the coated face, in that order; the first is the air.

    A ray keeps k = n sin(theta) through them (Snell), and with x = tan(theta) in the air, k^2 = x^2/(1+x^2), its
    lateral travel in a layer of thickness t is t x / sqrt(n^2 + (n^2 - 1) x^2): concave in x for every n >= 1.
    """

    thicknesses: tuple[float, ...]  # [mm]
    indices: tuple[float, ...]  # [-], >= 1

    @property
    def tops(self) -> "Floats":
        """z of each layer's far side [mm], (layers,); the last is 0."""
        below = np.cumsum(self.thicknesses)
        return np.asarray(below - below[-1])

    @property
    def effective_depth(self) -> float:
        """Sum of t/n [mm]: the pinhole distance at which air alone would give the same paraxial scale."""
        return float(sum(t / n for t, n in zip(self.thicknesses, self.indices, strict=True)))


@dataclass(frozen=True)
class PinholeCamera:
    """A pinhole camera that looks along +z, or nearly so, through a stack to the coating above it at `center`."""

    stack: Stack
    center: tuple[float, float]  # x, y [mm]
    focal_px: float  # pixel widths per unit slope in air
    shape: tuple[int, int]  # H, W [px]
    crop_px: tuple[float, float] = (0.0, 0.0)  # from the optical axis to the picture's middle, x and y
    tilt: tuple[float, float] = (0.0, 0.0)  # of the optical axis, toward +x and toward +y [rad]
    roll: float = 0.0  # about it, from x to y [rad]
    aspect: float = 1.0  # height of a pixel over its width

    @classmethod
    def from_sensor(cls, sensor: "Sensor") -> "PinholeCamera":
        """The camera of a sensor file; mm_per_px holds at the image centre on the untouched face.

        A file without a plate has none. Points in or behind an opaque layer are projected as if the last clear layer
        continued.
        """
        eye, clear = sensor.camera, (*((sensor.plate,) if sensor.plate else ()), *sensor.gel.clear_layers)
        opaque = sensor.gel.layers[len(sensor.gel.clear_layers) :]
        thicknesses = [slab.thickness_mm for slab in clear]
        thicknesses[-1] += sum(layer.thickness_mm for layer in opaque)
        stack = Stack((eye.distance_mm, *thicknesses), (1.0, *(slab.refractive_index for slab in clear)))
        shape, (x, y), (right, down) = (eye.height_px, eye.width_px), eye.crop_mm, np.radians(eye.tilt_deg)
        (wide, tall), roll = eye.pixel_mm, float(np.radians(eye.roll_deg))
        tilt = float(right), float(down)
        return cls(stack, eye.center_mm, stack.effective_depth / wide, shape, (x / wide, y / tall), tilt, roll,
                   eye.aspect)  # fmt: skip

    @property
    def pinhole(self) -> tuple[float, float, float]:
        """Position of the pinhole [mm]."""
        return (*self.center, -sum(self.stack.thicknesses))

    @property
    def mm_per_px(self) -> float:
        """Width of a pixel on the untouched face where an axis that is not tilted meets it [mm/px]."""
        return self.stack.effective_depth / self.focal_px

    @property
    def focal(self) -> "Floats":
        """Pixels per unit slope in air, across and down (2,)."""
        return np.array([self.focal_px, self.focal_px / self.aspect])

    @property
    def turn(self) -> "Floats":
        """Rotation (3, 3) from the camera's own frame, x right and y down in the picture, to the sensor's."""
        (right, down), c, s = self.tilt, np.cos(self.roll), np.sin(self.roll)
        toward_x = np.array([[np.cos(right), 0, np.sin(right)], [0, 1, 0], [-np.sin(right), 0, np.cos(right)]])
        toward_y = np.array([[1, 0, 0], [0, np.cos(down), np.sin(down)], [0, -np.sin(down), np.cos(down)]])
        return np.asarray(toward_x @ toward_y @ [[c, -s, 0], [s, c, 0], [0, 0, 1]])

    def slopes(self, pixels: "Floats") -> "Floats":
        """Slopes in air, dx/dz and dy/dz (n, 2), of the rays through pixels (n, 2)."""
        own = np.column_stack([(pixels - self.axis) / self.focal, np.ones(len(pixels))])
        ray = own @ self.turn.T
        return np.asarray(ray[:, :2] / ray[:, 2:])

    def project(self, points: Any) -> "Floats":
        """Pixels (n, 2), x right and y down, pixel centres at +0.5, of points (n, 3) [mm] in the gel.

        Raises:
            ValueError: a point lies at or behind the pinhole.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        stack = np.array(self.stack.thicknesses), np.array(self.stack.indices)
        pixels = _project(points, *self.center, *stack, self.turn, self.focal, self.axis)
        if np.isnan(pixels).any():
            raise ValueError("a point lies at or behind the camera's pinhole")
        return np.asarray(pixels)

    def rays(self, pixels: Any) -> tuple["Floats", "Floats"]:
        """Rays in the outermost gel layer through pixels (n, 2): origins (n, 3) [mm] on that layer's inner side and
        unit directions (n, 3), +z being outward. `project(origin + s direction)` is the pixel for every s >= 0."""
        pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        slope = self.slopes(pixels)
        x = np.hypot(slope[:, 0], slope[:, 1])
        n2, inner = np.square(self.stack.indices[:-1]), np.array(self.stack.thicknesses[:-1])
        ratio = (inner / np.sqrt(n2 + np.multiply.outer(x * x, n2 - 1.0))).sum(axis=1)
        origins = np.empty((len(x), 3))
        origins[:, :2] = slope * ratio[:, None] + self.center
        origins[:, 2] = -self.stack.thicknesses[-1]
        sine = slope / np.sqrt(1.0 + x * x)[:, None] / self.stack.indices[-1]
        directions = np.column_stack([sine, np.sqrt(1.0 - (sine * sine).sum(axis=1))])
        return origins, directions

    @property
    def axis(self) -> "Floats":
        """Position of the optical axis in the image [px]."""
        return np.array([self.shape[1] / 2, self.shape[0] / 2]) - self.crop_px


@njit(cache=True, error_model="numpy")
def _project(
    points: "Floats", x: float, y: float, thicknesses: "Floats", indices: "Floats", turn: "Floats", focal: "Floats",
    axis: "Floats",
) -> "Floats":  # fmt: skip
    """Pixels (n, 2) of points (n, 3) through a pinhole at x, y; nan of one at or behind it."""
    out, slope, rho = np.empty((len(points), 2)), np.empty(PROJECTION_BATCH), np.empty(PROJECTION_BATCH)
    work = np.empty((len(thicknesses) + 3, PROJECTION_BATCH))
    for start in range(0, len(points), PROJECTION_BATCH):
        some = points[start : start + PROJECTION_BATCH]
        for j in range(len(some)):
            rho[j] = np.sqrt((some[j, 0] - x) ** 2 + (some[j, 1] - y) ** 2)
        _slopes(rho, some[:, 2], thicknesses, indices, slope, work)
        for j in range(len(some)):
            ratio = slope[j] / rho[j] if rho[j] > 0.0 else 0.0
            sx, sy = (some[j, 0] - x) * ratio, (some[j, 1] - y) * ratio
            down = sx * turn[0, 2] + sy * turn[1, 2] + turn[2, 2]
            for k in range(2):
                pixel = focal[k] * (sx * turn[0, k] + sy * turn[1, k] + turn[2, k]) / down + axis[k]
                out[start + j, k] = pixel if slope[j] >= 0.0 else np.nan
    return out


@njit(cache=False, error_model="numpy")  # without checks of divisors, which would stop the compiler
def _slopes(rho: "Floats", z: "Floats", thicknesses: "Floats", indices: "Floats", x: "Floats", work: "Floats") -> None:
    """Slopes in air `x`, tan(theta) [-], of the rays that reach radii rho at heights z (n,) [mm]; nan at or behind the
    pinhole.

    Newton's method on the lateral travel, which is increasing and concave in x: from a start at or below the root, such
    as the paraxial slope, it converges monotonically without a safeguard. Loops over points are the inner ones, which
    the compiler turns into vector instructions. `work` (layers + 3, PROJECTION_BATCH) is overwritten.
    """
    n, last, whole = len(z), len(thicknesses) - 1, 0.0
    for thickness in thicknesses:
        whole += thickness
    length, (travel, rate, moving) = work[: last + 1], (work[last + 1], work[last + 2], work[last + 3])
    for j in range(n):
        left, depth = z[j] + whole, 0.0
        for k in range(last + 1):  # beyond the face the last layer continues
            length[k, j] = max(left if k == last else min(left, thicknesses[k]), 0.0)
            left -= thicknesses[k]
            depth += length[k, j] / indices[k]
        x[j], moving[j] = rho[j] / depth if depth > 0.0 else np.nan, 1.0
    for _ in range(50):
        for j in range(n):
            travel[j], rate[j] = length[0, j] * x[j], length[0, j]  # of the air
        for k in range(1, last + 1):
            n2 = indices[k] * indices[k]
            for j in range(n):
                inverse = 1.0 / (n2 + (n2 - 1.0) * x[j] * x[j])
                part = length[k, j] * np.sqrt(inverse)
                travel[j] += part * x[j]
                rate[j] += part * n2 * inverse
        count = 0
        for j in range(n):
            step = (rho[j] - travel[j]) / rate[j]
            x[j] += step if moving[j] > 0.0 else 0.0
            # the remaining error is of the order of the step's square
            moving[j] = 1.0 if moving[j] > 0.0 and abs(step) > 1e-8 * (1.0 + x[j]) else 0.0
            count += 1 if moving[j] > 0.0 else 0
        if count == 0:
            break
