"""The camera's picture by direct light and its mirror image alone: no noise, no scattered light."""

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from tacgen.optics import coating, sparse, transport
from tacgen.optics.layers import Camera
from tacgen.optics.raster import draw
from tacgen.optics.sheet import Sheet, Surface

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor import LitSensor

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Samples:
    """Where rays meet the coated face; nan where they miss the pad."""

    position: "Floats"  # [mm], (samples, 3)
    normal: "Floats"  # unit, into the gel, (samples, 3)
    rest: "Floats"  # rest position [mm], (samples, 2)
    heights: "Floats"  # the whole face, for shadows [mm], (rows, columns)


class Direct:
    """One sensor's LEDs, layers and camera, ready to look at any deformed face."""

    def __init__(
        self, sensor: "LitSensor", sheet: Sheet, markers: bool, pieces: tuple[int, int] = (8, 4), samples: int = 1
    ) -> None:
        """`pieces`: points on each strip (along, up); `samples` x `samples` rays a pixel."""
        self.sensor, self.sheet, self.samples = sensor, sheet, samples
        self.markers = sensor.markers if markers else None
        self.camera = Camera.from_sensor(sensor)
        self.points = transport.points(sensor.leds, *pieces)
        self.slab = transport.Slab.of(sensor)
        h, w = self.camera.shape[0] * samples, self.camera.shape[1] * samples
        pixels = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), axis=-1).reshape(-1, 2) / samples
        self.view = -self.camera.rays(pixels)[1]
        self.seen = camera_transmission(self.camera, pixels)

    def look(self, surface: Surface) -> "Samples":
        """What the camera's rays meet."""
        nodes = self.sheet.at(surface)
        shape = (self.camera.shape[0] * self.samples, self.camera.shape[1] * self.samples)
        values = np.column_stack([nodes, self.sheet.normals(nodes), self.sheet.rest])
        screen = self.camera.project(nodes) * self.samples
        hit = draw(self.sheet.faces, screen, nodes[:, 2].copy(), values, shape).reshape(-1, 8)
        normal = hit[:, 3:6] / np.linalg.norm(hit[:, 3:6], axis=1, keepdims=True)
        return Samples(np.ascontiguousarray(hit[:, :3]), normal, hit[:, 6:8], self._heights(nodes))

    def light(self, at: "Samples") -> "Floats":
        """What the camera sees of a white matt and of a mirror-rough coat per unit radiance of each LED:
        (samples, strips, 2), 0 off the pad."""
        points, slab, strips = self.points, self.slab, len(self.sensor.leds)

        def gather(index: "NDArray[np.int64]") -> "Floats":
            gathered = transport.gather(
                at.position[index], at.normal[index], self.view[index],
                points.at, points.normal, points.area, points.half, points.strip, strips,
                slab.bottoms, slab.tops, slab.indices, self.sensor.coating.roughness,
                at.heights, np.array(self.sheet.size),
            )  # fmt: skip
            return np.asarray(gathered.reshape(len(index), -1))

        h, w = self.camera.shape[0] * self.samples, self.camera.shape[1] * self.samples
        found = sparse.evaluate(gather, at.normal, (h, w)) * self.seen[:, None]
        return np.asarray(found.reshape(h * w, strips, 2))

    def radiance(self, surface: Surface, scattered: "Floats | None" = None) -> "Floats":
        """Linear radiance (H, W, 3); `scattered` (H, W, 3) is what a bare coat shows of all other light."""
        coat, at = self.sensor.coating, self.look(surface)
        light = np.einsum("nkc,kr->ncr", self.light(at), [led.radiance for led in self.sensor.leds])
        seen = (1 - coat.specular) * light[:, 0] * coat.albedo + coat.specular * coating.METAL * light[:, 1]
        if self.markers is not None:
            seen += self._dots(at) * (self.markers.albedo * light[:, 0] - seen)
        picture = self._pixels(seen)
        return picture if scattered is None else picture + self.dimmed(at, scattered)

    def dimmed(self, at: "Samples", bare: "Floats") -> "Floats":
        """What the coat with its dots shows (H, W, 3) of light by which a bare coat would show `bare` (H, W, 3)."""
        coat, n = self.sensor.coating, self.samples
        other = np.repeat(np.repeat(bare, n, axis=0), n, axis=1).reshape(-1, 3)
        if self.markers is not None:
            white = (1 - coat.specular) * np.array(coat.albedo) + coat.specular * coating.METAL
            other = other * (1 + self._dots(at) * (self.markers.albedo / white - 1))
        return self._pixels(other)

    def _dots(self, at: "Samples") -> "Floats":
        """Share of marker paint at each sample (samples, 1)."""
        assert self.markers is not None
        fade = self.sensor.camera.mm_per_px / self.samples
        return np.nan_to_num(coating.paint(self.markers, at.rest, fade))[:, np.newaxis]

    def _pixels(self, samples: "Floats") -> "Floats":
        """Means (H, W, 3) over each pixel's samples (samples, 3)."""
        (h, w), n = self.camera.shape, self.samples
        return np.asarray(samples.reshape(h, n, w, n, 3).mean(axis=(1, 3)))

    def _heights(self, nodes: "Floats") -> "Floats":
        """The deformed face as heights (rows, columns) [mm] over the pad's rectangle, 0 where it drew back."""
        rows, columns = self.sheet.shape
        scale = np.array([columns - 1, rows - 1]) / self.sheet.size
        screen = (nodes[:, :2] + np.array(self.sheet.size) / 2) * scale + 0.5
        z = nodes[:, 2].copy()
        return np.nan_to_num(draw(self.sheet.faces, screen, z, z[:, None], (rows, columns))[..., 0])


def camera_transmission(camera: Camera, pixels: "Floats") -> "Floats":
    """What is left in the air of a unit radiance in the gel, per pixel (n,): Fresnel's losses and 1/n^2."""
    slope = (pixels - [camera.shape[1] / 2, camera.shape[0] / 2]) / camera.focal_px
    k = np.hypot(*slope.T) / np.sqrt(1 + (slope**2).sum(axis=1))
    share, n = np.ones(len(k)), camera.stack.indices
    for a, b in pairwise(n):
        share *= transport.fresnel_transmission(k, a, b)
    return np.asarray(share / n[-1] ** 2)
