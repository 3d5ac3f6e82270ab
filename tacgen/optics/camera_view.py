"""The coated face as the camera sees it: the point behind each ray, and the markers printed there."""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tacgen.geometry.rasterize import blend
from tacgen.optics import coat_texture, coating, strip_light
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.drawn_face import DrawnFace
from tacgen.optics.surface_grid import Sheet, Surface
from tacgen.physics import coat
from tacgen.physics.runtime import call

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor.model import LitSensor

    Floats = NDArray[np.float64]


class Samples(DrawnFace):
    """Where rays meet the coated face, nan where they miss the pad; each property is computed once, if at all."""

    def __init__(self, view: "CameraView", surface: Surface) -> None:
        super().__init__(view.sheet, surface, view.camera, view.samples)
        self._view = view

    @cached_property
    def position(self) -> "Floats":
        """[mm], (samples, 3)."""
        return self.behind(self.nodes).reshape(-1, 3)

    @cached_property
    def normal(self) -> "Floats":
        """Unit, into the gel, (samples, 3)."""
        return blend(self.hits, self.facing, unit=True)

    def emboss(self, slopes: "Floats") -> None:
        """Turn the normals, from now on, by slopes of the coating's relief (2, h, w) where something touches."""
        share = blend(self.hits, self.sheet.touched(self.surface)[:, None])[:, 0]
        self.normal = coat_texture.embossed(self.normal, share, self.rest, slopes, self.sheet.size)

    @cached_property
    def rest(self) -> "Floats":
        """Rest position [mm], (samples, 2)."""
        return blend(self.hits, self.sheet.rest)

    @cached_property
    def paint(self) -> "Floats":
        """Share of marker paint (samples, 1)."""
        return self._view.paint(self)


class CameraView:
    """Camera and coating of a sensor, for any deformed face."""

    def __init__(self, sensor: "LitSensor", sheet: Sheet, markers: bool, samples: int = 1) -> None:
        """`samples` x `samples` rays a pixel."""
        self.sensor, self.sheet, self.samples = sensor, sheet, samples
        self.markers = sensor.markers if markers else None
        self.camera = PinholeCamera.from_sensor(sensor)
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
        n = self.camera.stack.indices
        return strip_light.transmission(k, n) / n[-1] ** 2

    def look(self, surface: Surface) -> Samples:
        """The points behind the camera's rays."""
        return Samples(self, surface)

    def dimmed(self, at: Samples, bare: "Floats") -> "Floats":
        """Radiance (H, W, 3) of the coating with its markers, from that without them, `bare` (samples, 3), which is
        overwritten."""
        if self.markers is not None:
            call(coat.dim, (len(bare),), bare, at.paint.reshape(-1), self.change[None], None)
        return self.picture(bare)

    def add_even(self, made: "Floats", at: Samples, light: "Floats") -> None:
        """Add to a picture `made` (H, W, 3), in place, the coating in light under which it would have the radiance
        `light` (3,) everywhere without markers."""
        share = self.picture(at.paint).reshape(-1)
        call(coat.dim, share.shape, made.reshape(-1, 3), share, self.change[None], light[None])

    @property
    def change(self) -> "Floats":
        """Relative change (3,) of the coating's radiance under full paint."""
        albedo = self.markers.albedo if self.markers else 0.0
        return np.asarray(albedo / coating.white(self.sensor.coating) - 1)

    def paint(self, at: Samples) -> "Floats":
        """Share of marker paint (samples, 1); 0 where there is no gel."""
        if self.markers is None:
            return np.zeros((self.shape[0] * self.shape[1], 1))
        eye = self.sensor.camera
        fade = eye.mm_per_px * eye.aspect**0.5 / self.samples
        return coating.paint(self.markers, at.rest, fade)[:, np.newaxis]

    def picture(self, samples: "Floats") -> "Floats":
        """Means (H, W, c) over each pixel's samples (samples, c)."""
        (h, w), n = self.camera.shape, self.samples
        if n == 1:
            return samples.reshape(h, w, -1)
        return np.asarray(samples.reshape(h, n, w, n, -1).mean(axis=(1, 3)))
