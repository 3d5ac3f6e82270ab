"""The camera's image by direct light and its reflection in the plate, without sampling noise."""

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from tacgen.geometry.rasterize import nearest
from tacgen.optics import adaptive_sampling, coating
from tacgen.optics.camera_view import CameraView, Samples
from tacgen.optics.shadows import Terrain
from tacgen.optics.strip_light_table import Columns, toward_camera
from tacgen.optics.surface_grid import Sheet, Surface

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tacgen.optics.interreflection import Glow
    from tacgen.sensor.model import LitSensor

    Floats = NDArray[np.float64]
    Light = Callable[[NDArray[np.int64]], Floats]


class Direct:
    """LEDs, layers and camera of a sensor, for any deformed face."""

    def __init__(
        self,
        sensor: "LitSensor",
        sheet: Sheet,
        markers: bool,
        untouched: Surface,
        pieces: int = 8,
        samples: int = 1,
        tolerance: adaptive_sampling.SamplingTolerance = adaptive_sampling.SamplingTolerance(),  # noqa: B008
    ) -> None:
        """Each strip in so many `pieces`; `samples` x `samples` rays a pixel."""
        self.sensor, self.sheet, self.tolerance = sensor, sheet, tolerance
        self.view = CameraView(sensor, sheet, markers, samples)
        self.untouched = heights(sheet, sheet.at(untouched))
        leds = tuple(led.model_copy(update={"radiance": (1.0, 1.0, 1.0), "power": 1.0}) for led in sensor.leds)
        lamps = sensor.model_copy(update={"leds": leds, "markers": None})
        self.columns = _columns(lamps, sheet, untouched, pieces)  # type: ignore[arg-type]
        self.toward, self.transmission = self.view.toward_camera(), self.view.transmission()

    def light(self, at: Samples) -> "Floats":
        """Light at the camera per unit radiance of each LED, 0 off the pad: (samples, strips, 2) of a white Lambertian
        coat and of a rough mirror, the latter only if the coat is specular."""
        each, none = np.eye(leds := len(self.sensor.leds)), np.zeros((leds, leds))
        gather = self._gatherer(at, np.hstack([each, none]), np.hstack([none, each]))
        kinds = 2 if self.sensor.coating.specular else 1
        return self._everywhere(gather, at).reshape(len(at.normal), 2, leds).swapaxes(1, 2)[..., :kinds]

    def seen(self, at: Samples, glow: "Glow | None" = None) -> "Floats":
        """Linear radiance (H, W, 3) of the points behind the camera's rays, with the interreflection `glow`."""
        markers, white, dots = self.view.markers, coating.white(self.sensor.coating), self._dotted
        gather = self._gatherer(at, *self.shares())

        def bare(index: "NDArray[np.int64]") -> "Floats":
            seen = gather(index)
            if glow is not None:
                bounced = glow.at(at.normal, index)
                seen[:, :3] += bounced
                seen[:, 3:] += bounced / white if dots else 0.0
            return seen

        radiance = self._everywhere(bare, at)
        if markers is None or not dots:
            return self.view.dimmed(at, radiance)
        return self.view.picture(radiance[:, :3] + at.paint * (markers.albedo * radiance[:, 3:] - radiance[:, :3]))

    def shares(self) -> "tuple[Floats, Floats]":
        """Radiance of which each strip gives a part by a white Lambertian coat and by a rough mirror, (strips, 3) each;
        where a glossy coat has dots (strips, 6), since paint reflects the light that arrives."""
        coat, led = self.sensor.coating, np.array([led.light for led in self.sensor.leds])
        matt, gloss = (1 - coat.specular) * led * coat.albedo, coat.specular * coating.METAL_REFLECTANCE * led
        return (np.hstack([matt, led]), np.hstack([gloss, 0 * led])) if self._dotted else (matt, gloss)

    @property
    def _dotted(self) -> bool:
        """Whether a glossy coat has dots."""
        return self.view.markers is not None and self.sensor.coating.specular > 0.0

    def _gatherer(self, at: Samples, matt: "Floats", gloss: "Floats") -> "Light":
        """A function of sample indices (n,): radiance toward the camera (n, c), of which each strip gives `matt` and
        `gloss` (strips, c) by a white Lambertian coat and by a rough mirror."""
        coat = self.sensor.coating
        terrain = Terrain.of(heights(self.sheet, at.nodes), self.sheet.size, self.untouched)
        alpha = coat.roughness if coat.specular else 0.0

        seen = at.hits, at.nodes, at.normal, self.toward, self.transmission
        return lambda index: toward_camera(index, *seen, self.columns, matt, gloss, alpha, terrain)

    def _everywhere(self, light: "Light", at: Samples) -> "Floats":
        return adaptive_sampling.evaluate(light, at.normal, self.view.shape, self.tolerance)

    def radiance(self, surface: Surface) -> "Floats":
        """Linear radiance (H, W, 3) of a deformed face."""
        return self.seen(self.view.look(surface))


@lru_cache(maxsize=1)
def _columns(sensor: "LitSensor", sheet: Sheet, untouched: Surface, pieces: int) -> Columns:
    """Sensors that differ in radiance or markers share it, as in a calibration."""
    return Columns.of(sensor, pieces, Terrain.of(heights(sheet, sheet.at(untouched)), sheet.size))


def heights(sheet: Sheet, nodes: "Floats") -> "Floats":
    """A deformed face as heights (rows, columns) [mm] over the pad's rectangle, 0 where there is no gel."""
    rows, columns = sheet.shape
    screen = np.empty((len(nodes), 2))
    for k, (side, count) in enumerate(zip(sheet.size, (columns, rows), strict=True)):
        screen[:, k] = (nodes[:, k] + side / 2) * ((count - 1) / side) + 0.5  # exact at the rim
    found = nearest(sheet.faces, screen, nodes[:, 2].copy(), (rows, columns))
    found[np.isnan(found)] = 0.0
    return found
