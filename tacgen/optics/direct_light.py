"""The camera's picture by direct light and its mirror image alone: no noise, no scattered light."""

from typing import TYPE_CHECKING

import numpy as np

from tacgen.optics import adaptive_sampling, coating, strip_light
from tacgen.optics.camera_view import Samples, View
from tacgen.optics.rasterize import draw
from tacgen.optics.shadows import Terrain
from tacgen.optics.strip_light_table import Beams, shine
from tacgen.optics.surface_grid import Sheet, Surface

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.description import LitSensor

    Floats = NDArray[np.float64]


class Direct:
    """One sensor's LEDs, layers and camera, ready to light any deformed face."""

    def __init__(
        self,
        sensor: "LitSensor",
        sheet: Sheet,
        markers: bool,
        pieces: tuple[int, int] = (8, 4),
        samples: int = 1,
        tolerance: adaptive_sampling.Tolerance = adaptive_sampling.Tolerance(),  # noqa: B008
    ) -> None:
        """`pieces`: points on each strip (along, up); `samples` x `samples` rays a pixel."""
        self.sensor, self.sheet, self._tolerance = sensor, sheet, tolerance
        self.view = View(sensor, sheet, markers, samples)
        self.points = strip_light.points(sensor.leds, *pieces)
        self._beams = Beams.of(sensor, self.points, pieces[1], sheet)
        self._toward, self._seen = self.view.toward_camera(), self.view.transmission()

    def light(self, at: Samples) -> "Floats":
        """What the camera sees per unit radiance of each LED, 0 off the pad: (samples, strips, 2) of a white matt and
        of a mirror-rough coat, the latter only where the coat has some gloss."""
        return self._summed(at, np.eye(len(self.sensor.leds)))

    def seen(self, at: Samples) -> "Floats":
        """Linear radiance (H, W, 3) of what the camera's rays meet."""
        coat, markers = self.sensor.coating, self.view.markers
        light = self._summed(at, np.array([led.light for led in self.sensor.leds]))
        matt = light[..., 0]
        seen = (1 - coat.specular) * matt * coat.albedo
        if coat.specular:
            seen += coat.specular * coating.METAL * light[..., 1]
        if markers is not None:
            seen += at.paint * (markers.albedo * matt - seen)
        return self.view.picture(seen)

    def _summed(self, at: Samples, radiance: "Floats") -> "Floats":
        """The same by LEDs of radiance (strips, c): (samples, c, 1 or 2)."""
        coat, strips = self.sensor.coating, len(radiance)
        terrain = Terrain.of(heights(self.sheet, at.nodes), self.sheet.size)
        kinds = 2 if coat.specular else 1

        def gather(index: "NDArray[np.int64]") -> "Floats":
            seen = at.position[index], at.normal[index], self._toward[index]
            gathered = shine(*seen, self._beams, strips, coat.roughness if coat.specular else 0.0, terrain)
            return np.asarray(np.einsum("nkr,kc->ncr", gathered[..., :kinds], radiance).reshape(len(index), -1))

        found = adaptive_sampling.evaluate(gather, at.normal, self.view.shape, self._tolerance) * self._seen[:, None]
        return np.asarray(found.reshape(len(found), -1, kinds))

    def radiance(self, surface: Surface) -> "Floats":
        """Linear radiance (H, W, 3) of a deformed face."""
        return self.seen(self.view.look(surface))


def heights(sheet: Sheet, nodes: "Floats") -> "Floats":
    """A deformed face as heights (rows, columns) [mm] over the pad's rectangle, 0 where it drew back."""
    rows, columns = sheet.shape
    scale = np.array([columns - 1, rows - 1]) / sheet.size
    screen = (nodes[:, :2] + np.array(sheet.size) / 2) * scale + 0.5
    z = nodes[:, 2].copy()
    return np.nan_to_num(draw(sheet.faces, screen, z, z[:, None], (rows, columns))[..., 0])
