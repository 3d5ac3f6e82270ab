"""Deformed faces of one scene -> its camera pictures: rendered, over a photograph where there is one, and developed."""

from functools import lru_cache
from pathlib import Path
from typing import cast

import numpy as np

from tacgen.optics import camera_response
from tacgen.optics.surface_grid import Surface
from tacgen.recipe import background_photo
from tacgen.recipe.row import DRIFT, NOISE, Row
from tacgen.render.images import Method, Renderer
from tacgen.sensor.imperfections import Drift
from tacgen.sensor.model import Camera, LitSensor

Array = np.ndarray
WAVES = 64  # of which a drift is the sum: its distribution is normal to within a few per cent


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


@lru_cache(maxsize=2)
def _rendering(
    sensor: LitSensor, spp: int, seed: int, markers: bool, method: Method, untouched: Surface | None
) -> tuple[Renderer, Array]:
    """A renderer and its radiance (H, W, 3) of the untouched face, which scenes of one sensor share."""
    renderer = Renderer(sensor, spp, seed, markers, method=method, untouched=untouched)
    return renderer, renderer.flat()


class Pictures:
    """One scene's camera, with its recipe's renderer, photograph and noise."""

    def __init__(self, row: Row, untouched: Surface) -> None:
        """`untouched` is the face at rest that the camera sees."""
        lit, render = cast(LitSensor, row.sensor), row.recipe.render  # recipe/optics_checks lets no other through
        solid = untouched if lit.gel.solid is not None else None
        spp, markers = row.recipe.resolved().spp, lit.markers is not None
        own = render.method == "path"  # whose random numbers depend on the seed and count the images
        made = _rendering.__wrapped__ if own else _rendering
        seed = row.seed if own else 0
        self.renderer, flat = made(lit, spp, seed, markers, render.method, solid)  # type: ignore[arg-type]
        self._row, self._photo = row, None
        if row.photo_path is not None:
            self._photo = Backdrop(row.photo_path, flat, lit.camera)
        self.flat = self._over_photo(flat)

    def radiance(self, face: Surface) -> Array:
        """Linear light (H, W, 3) from a deformed face, float32."""
        return self._over_photo(self.renderer.image(face))

    def developed(self, radiance: Array, frame: int | None = None) -> Array:
        """The 8-bit picture (H, W, 3) of a radiance; in a frame with the camera's drift, and with its noise, if the
        recipe has noise.

        Both depend on the scene's seed and the frame's number alone, whatever process renders it.
        """
        if frame is None:
            return self.renderer.develop(radiance)
        drift = self.renderer.sensor.camera.drift
        gain = None if drift is None else drifted(drift, self._row.seed, frame)
        if not self._row.recipe.render.noise:
            return self.renderer.develop(radiance, gain=gain)
        seed = np.random.SeedSequence((self._row.seed, frame, NOISE))
        return self.renderer.develop(radiance, np.random.default_rng(seed), gain)

    def _over_photo(self, radiance: Array) -> Array:
        return radiance if self._photo is None else self._photo.under(radiance)


def drifted(drift: Drift, seed: int, frame: int) -> Array:
    """Gain of each colour (3,) in a frame: 1 plus a sum of waves over the frames, whose rates are drawn so that the
    correlation of two frames falls as exp(-(difference / frames)^2 / 2)."""
    random = np.random.default_rng(np.random.SeedSequence((seed, DRIFT)))
    rate, phase = random.standard_normal((3, WAVES)) / drift.frames, random.uniform(0, 2 * np.pi, (3, WAVES))
    return np.asarray(1 + drift.gain * np.sqrt(2 / WAVES) * np.cos(rate * frame + phase).sum(axis=1))
