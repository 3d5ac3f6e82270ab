"""The coated face as the camera sees it: the point behind each ray, and the markers printed there."""

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from tacgen.optics import coating, strip_light
from tacgen.optics.camera import Camera
from tacgen.optics.drawn_face import DrawnFace
from tacgen.optics.surface_grid import Sheet, Surface, unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.description import LitSensor

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Samples:
    """Where rays meet the coated face; nan where they miss the pad."""

    position: "Floats"  # [mm], (samples, 3)
    normal: "Floats"  # unit, into the gel, (samples, 3)
    rest: "Floats"  # rest position [mm], (samples, 2)
    nodes: "Floats"  # the whole face: the sheet's nodes now [mm], (nodes, 3)
    paint: "Floats"  # share of marker paint, (samples, 1)


class View:
    """Camera and coating of a sensor, for any deformed face."""

    def __init__(self, sensor: "LitSensor", sheet: Sheet, markers: bool, samples: int = 1) -> None:
        """`samples` x `samples` rays a pixel."""
        self.sensor, self.sheet, self.samples = sensor, sheet, samples
        self.markers = sensor.markers if markers else None
        self.camera = Camera.from_sensor(sensor)
        h, w = self.shape
        self._pixels = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), axis=-1).reshape(-1, 2) / samples

    @property
    def shape(self) -> tuple[int, int]:
        """Rays down and across the picture."""
        return self.camera.shape[0] * self.samples, self.camera.shape[1] * self.samples

    def toward_camera(self) -> "Floats":
        """Unit directions in the gel from the point behind each ray to the camera (samples, 3)."""
        return -self.camera.rays(self._pixels)[1]

    def transmission(self) -> "Floats":
        """Radiance in air over that in the gel, per ray (samples,): Fresnel losses and 1/n^2."""
        slope = self.camera.slopes(self._pixels)
        k = np.hypot(*slope.T) / np.sqrt(1 + (slope**2).sum(axis=1))
        share, n = np.ones(len(k)), self.camera.stack.indices
        for a, b in pairwise(n):
            share *= strip_light.fresnel_transmission(k, a, b)
        return np.asarray(share / n[-1] ** 2)

    def look(self, surface: Surface) -> Samples:
        """The points behind the camera's rays."""
        drawn = DrawnFace(self.sheet, surface, self.camera, self.samples)
        found = (drawn.behind(values) for values in (drawn.nodes, drawn.facing, self.sheet.rest))
        position, normal, rest = (values.reshape(-1, values.shape[2]) for values in found)
        return Samples(position, unit(normal), rest, drawn.nodes, self._paint(rest))

    def dimmed(self, at: Samples, bare: "Floats") -> "Floats":
        """Radiance (H, W, 3) of the coating with its markers; `bare` (samples, 3) is that without markers."""
        if self.markers is not None:
            dots, bare = np.flatnonzero(at.paint), bare.copy()
            bare[dots] *= 1 + at.paint[dots] * (self.markers.albedo / coating.white(self.sensor.coating) - 1)
        return self.picture(bare)

    def samples_of(self, picture: "Floats") -> "Floats":
        """A picture (H, W, c) at each pixel's samples (samples, c)."""
        n = self.samples
        return np.repeat(np.repeat(picture, n, axis=0), n, axis=1).reshape(-1, picture.shape[2])

    def _paint(self, rest: "Floats") -> "Floats":
        if self.markers is None:
            return np.zeros((len(rest), 1))
        fade = self.sensor.camera.mm_per_px / self.samples
        share = coating.paint(self.markers, rest, fade)[:, np.newaxis]
        return np.where(np.isnan(share), 0.0, share)

    def picture(self, samples: "Floats") -> "Floats":
        """Means (H, W, c) over each pixel's samples (samples, c)."""
        (h, w), n = self.camera.shape, self.samples
        if n == 1:
            return samples.reshape(h, w, -1)
        return np.asarray(samples.reshape(h, n, w, n, -1).mean(axis=(1, 3)))
