"""Deformed faces of one scene -> its camera pictures: rendered, over a photograph where there is one, and developed.

A frame's pictures are a shot. With a GPU the first one that is asked for is drawn together with those after it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from tacgen.optics import camera_response
from tacgen.optics.surface_grid import Surface, Untouched
from tacgen.render import photograph, tensor_drawing
from tacgen.render.images import Method, Renderer
from tacgen.sensor.imperfections import DRIFT_STREAM, NOISE_STREAM, Drift
from tacgen.sensor.model import Camera, LitSensor

Array = np.ndarray
# pixels at most, beyond those of a frame, that are drawn at once; each takes 30 bytes
MAX_BATCH_PIXELS = 64 * 320 * 240
# frames whose mean the untouched picture is, as units are photographed: it shows no steps of counts
UNTOUCHED_FRAMES = 16
DRIFT_WAVES = 64  # of which a drift is the sum: its distribution is normal to within a few per cent


_Drawn = tuple[Array | None, Array | None]  # a frame's radiance and 8-bit picture, each where it is needed


@dataclass(frozen=True)
class PictureSettings:
    """How a scene's pictures are made: the renderer's method and samples a pixel, the scene's seed, whether they have
    the camera's noise, the photograph behind them, and the outputs that are asked for."""

    sensor: LitSensor
    method: Method
    spp: int
    seed: int
    noise: bool
    photo: Path | None
    asked: frozenset[str]


class Backdrop:
    """A photograph of the untouched sensor as the background of rendered radiance.

    The image is photograph x (deformed render / untouched render) in linear light; beside the gel, where nothing is
    rendered, it is the photograph alone.
    """

    def __init__(self, path: Path, flat: Array, camera: Camera) -> None:
        """`flat` (H, W, 3) is the radiance rendered untouched."""
        light = camera_response.linear(photograph.read(path) / 255.0, camera)
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
    """One scene's camera, with its renderer, photograph and noise."""

    def __init__(self, settings: PictureSettings, untouched: Surface, device: str | None = None) -> None:
        """`untouched` is the face at rest that the camera sees; `device`, PyTorch's, draws shots if it can draw what
        the renderer does. What it cannot for lack of memory the CPU draws, and `notes` say so."""
        lit, method = settings.sensor, settings.method
        if settings.photo is not None and lit.coating.grain is not None:  # which the photograph has
            lit = lit.model_copy(update={"coating": lit.coating.model_copy(update={"grain": None})})
        solid = untouched if lit.gel.solid is not None else None
        own = method == "path"  # whose random numbers depend on the seed and count the images
        made = _rendering.__wrapped__ if own else _rendering
        seed = settings.seed if own else 0
        self.renderer, flat = made(lit, settings.spp, seed, lit.markers is not None, method, solid)  # type: ignore[arg-type]
        self._device, self._drawn, self.notes = device, dict[int, _Drawn](), list[str]()
        self._by = ""  # name of the device, once it has drawn
        self._settings, self._photo = settings, None
        if settings.photo is not None:
            self._photo = Backdrop(settings.photo, flat, lit.camera)
        self.flat = self.over_photo(flat)

    @property
    def name(self) -> str:
        """The renderer's, and that of the device if it has drawn shots."""
        return f"{self.renderer.name} on {self._by}" if self._by else self.renderer.name

    def radiance(self, face: Surface) -> Array:
        """Linear light (H, W, 3) from a deformed face, float32."""
        return self.over_photo(self.renderer.image(face))

    def developed(self, radiance: Array, frame: int | None = None) -> Array:
        """The 8-bit picture (H, W, 3) of a radiance; in a frame with the camera's drift, and with its noise, if the
        recipe has noise. Without a frame it is the mean of UNTOUCHED_FRAMES with noise, the same in all scenes, or the
        recipe's photograph as it is.

        Noise and drift depend on the scene's seed and the frame's number alone, whatever process renders it.
        """
        if frame is not None:
            return self.renderer.develop(radiance, *self._disturbed(frame))
        camera = self.renderer.sensor.camera
        if camera.noise is None or not self._settings.noise or self._photo is not None:
            return self.renderer.develop(radiance)
        fainter = {"strength": camera.noise.strength / math.sqrt(UNTOUCHED_FRAMES)}
        camera = camera.model_copy(update={"noise": camera.noise.model_copy(update=fainter)})
        random = np.random.default_rng(np.random.SeedSequence(NOISE_STREAM))
        return self.renderer.compressed(camera_response.develop(radiance, camera, random))

    def over_photo(self, radiance: Array) -> Array:
        """Rendered radiance (H, W, 3) over the recipe's photograph, if it has one."""
        return radiance if self._photo is None else self._photo.under(radiance)

    def shot(self, frame: int, face: Surface, later: Callable[[int], Mapping[int, Surface]]) -> "Shot":
        """The pictures of a frame with this face; `later`: so many of the faces after it, at most, by their frames."""
        if self._device is not None and frame not in self._drawn and tensor_drawing.drawable(self.renderer):
            self._drawn = {}  # before there are others
            at_once = max(1, MAX_BATCH_PIXELS // (self.flat.size // 3))
            self._drawn = self._together({frame: face, **later(at_once - 1)}, self._device)
        return Shot(self, frame, face, *self._drawn.get(frame, (None, None)))

    def _disturbed(self, frame: int) -> tuple[np.random.Generator | None, Array | None]:
        """The source of a frame's noise, if the recipe has noise, and the gain (3,) of its drift, if there is one."""
        drift, seed = self.renderer.sensor.camera.drift, self._settings.seed
        gain = None if drift is None else drifted(drift, seed, frame)
        if not self._settings.noise:
            return None, gain
        return np.random.default_rng(np.random.SeedSequence((seed, frame, NOISE_STREAM))), gain

    def _together(self, faces: Mapping[int, Surface], device: str) -> dict[int, "_Drawn"]:
        """Draw frames by their faces, all at once; nothing, from now on, where the device fails."""
        sheet, touched = self.renderer.sheet, None
        nodes = np.stack([sheet.at(face) for face in faces.values()])
        if self.renderer.relief is not None:
            touched = np.stack([sheet.touched(face) for face in faces.values()])
        asked = self._settings.asked
        radiance: Sequence[Array | None] = [None] * len(faces)
        developed = radiance
        try:
            name = tensor_drawing.taken(device)
            drawing = tensor_drawing.drawing(self.renderer, device)
            light = drawing.radiance(nodes, touched)
            if self._photo is not None or "radiance" in asked:
                radiance = list(light.cpu().numpy())
            if self._photo is None and "rgb" in asked:
                random, gains = zip(*map(self._disturbed, faces), strict=True)
                developed = list(drawing.developed(light, random, gains))
        except RuntimeError as error:  # PyTorch's, as when the GPU's memory is full
            self._device, (why, *_) = None, [*str(error).splitlines(), type(error).__name__]
            first = next(iter(faces))
            self.notes.append(f"pictures{f' from frame {first + 1} on' * (first > 0)} drawn by the CPU: {why}")
            return {}
        self._by = name
        return dict(zip(faces, zip(radiance, developed, strict=True), strict=True))


def prepare(settings: PictureSettings, device: str) -> None:
    """Make ready in this process for pictures on a device with these settings, by drawing the untouched face."""
    from threadpoolctl import threadpool_limits

    if settings.sensor.gel.solid is not None:  # its face at rest is that of its mesh
        return
    with threadpool_limits(1, user_api="blas"):  # as scenes do: the renderer is theirs
        face = Untouched.of(settings.sensor.gel)
        Pictures(settings, face, device).shot(0, face, lambda most: {})


class Shot:
    """A frame's pictures, each made when it is first asked for."""

    def __init__(
        self, pictures: Pictures, frame: int, face: Surface, light: Array | None, developed: Array | None
    ) -> None:
        """`light` (H, W, 3), without a photograph, and `developed` (H, W, 3), before JPEG, where they are drawn."""
        self._pictures, self._frame, self._face = pictures, frame, face
        self._light, self._developed = light, developed

    @cached_property
    def radiance(self) -> Array:
        """Linear light (H, W, 3), float32."""
        return self._pictures.radiance(self._face) if self._light is None else self._pictures.over_photo(self._light)

    @cached_property
    def rgb(self) -> Array:
        """The 8-bit picture (H, W, 3)."""
        if self._developed is None:
            return self._pictures.developed(self.radiance, self._frame)
        return self._pictures.renderer.compressed(self._developed)


def drifted(drift: Drift, seed: int, frame: int) -> Array:
    """Gain of each colour (3,) in a frame: 1 plus a sum of waves over the frames, whose rates are drawn so that the
    correlation of two frames falls as exp(-(difference / frames)^2 / 2)."""
    random = np.random.default_rng(np.random.SeedSequence((seed, DRIFT_STREAM)))
    rate, phase = (
        random.standard_normal((3, DRIFT_WAVES)) / drift.frames,
        random.uniform(0, 2 * np.pi, (3, DRIFT_WAVES)),
    )
    return np.asarray(1 + drift.gain * np.sqrt(2 / DRIFT_WAVES) * np.cos(rate * frame + phase).sum(axis=1))
