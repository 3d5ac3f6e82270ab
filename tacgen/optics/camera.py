"""A pinhole camera behind flat clear layers: exact refraction, forward (project) and back (rays).

Frame: x right, y down in the image, z from the camera to the object; z = 0 is the untouched coated face.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.physics import faces
from tacgen.physics.runtime import call

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor.model import Sensor

    Floats = NDArray[np.float64]


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
        pixels, each = np.empty((len(points), 2)), faces.POINTS_PER_THREAD
        call(faces.projected, (-(-len(points) // each),), points, self.lens, self.layers, pixels)
        if np.isnan(pixels).any():
            raise ValueError("a point lies at or behind the camera's pinhole")
        return pixels

    @property
    def lens(self) -> "Floats":
        """The numbers (16,) of faces.Lens."""
        whole = sum(self.stack.thicknesses)
        return np.array([*self.center, whole, *self.focal, *self.axis, *self.turn.ravel()])

    @property
    def layers(self) -> "Floats":
        """Thickness [mm] and index of each layer (n, 2)."""
        return np.column_stack([self.stack.thicknesses, self.stack.indices])

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
