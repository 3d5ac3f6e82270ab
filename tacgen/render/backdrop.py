"""A photograph of the untouched sensor behind rendered light."""

from pathlib import Path

import numpy as np

from tacgen.optics import camera_response
from tacgen.recipe import background_photo
from tacgen.sensor.model import Camera

Array = np.ndarray


class Backdrop:
    """A photograph of the untouched sensor as the background of rendered radiance.

    The image is photograph x (deformed render / untouched render) in linear light; beside the gel, where nothing is
    rendered, it is the photograph alone.
    """

    def __init__(self, path: Path, flat: Array, camera: Camera) -> None:
        """`flat` (H, W, 3) is the radiance rendered untouched."""
        light = camera_response.linear(background_photo.read(path) / 255.0, camera)
        rendered = camera_response.expose(flat, camera)
        lit = rendered > 0
        self._camera = camera
        self._gain = np.where(lit, light / np.where(lit, rendered, 1.0), 0.0)
        self._alone = np.where(lit, 0.0, light)

    def under(self, radiance: Array) -> Array:
        """Radiance (H, W, 3) as photographed."""
        light = camera_response.expose(radiance, self._camera) * self._gain + self._alone
        return camera_response.unexposed(light, self._camera).astype(radiance.dtype)
