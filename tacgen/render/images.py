"""Sensor + deformed coated face -> camera images.

In a clear gel, `transport` is direct light with its reflection in the plate (optics/direct_light) plus interreflection
(optics/interreflection), without sampling noise. In a gel that scatters it is the untouched image and its change with
thickness (optics/scattering), traced once per sensor and cached. `PathTracer` is the unbiased reference for both.
`table` is calibrated on `transport`.
"""

from functools import cached_property
from importlib.metadata import version
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

import numpy as np

from tacgen.base import array_cache
from tacgen.optics import (
    adaptive_sampling,
    camera_response,
    coat_texture,
    housing,
    scattering,
    strip_light,
    taxim_table,
)
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.camera_view import CameraView, Samples
from tacgen.optics.direct_light import Direct
from tacgen.optics.interreflection import Radiosity
from tacgen.optics.surface_grid import Sheet, Surface, Untouched
from tacgen.render import jpeg, mitsuba_path, traced_maps
from tacgen.render import mitsuba_variants as probing
from tacgen.render.mitsuba_path import SHEET_SPACING_MM, PathTracer

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor.model import LitSensor, Sensor

    Floats = NDArray[np.float64]

Method = Literal["transport", "path", "table"]
DARKEST = 1e-12  # mean radiance up to which an automatic exposure brightens, as no camera can take it to infinity
BOUNCE_POINTS = 6, 8  # quadrature points along and up each strip, for interreflection
TABLE_COLUMNS = 64  # width of the images on which a table is calibrated [px]
TABLE_EFFORT = 256  # the level of `Effort` of those images
TABLE_VERSION = 1  # of how tables are made; part of their key in the cache


class Light(Protocol):
    """A method to compute the light on a face."""

    def seen(self, at: Samples) -> "Floats":
        """Linear radiance (H, W, 3) of what the camera's rays meet, in an array that the caller may change."""


class Traced:
    """Mitsuba's paths, with noise of its own for each image."""

    def __init__(self, sensor: "LitSensor", markers: bool, spp: int, seed: int, variant: str) -> None:
        self._tracer = PathTracer(sensor, mitsuba_path.traced_sheet(sensor), markers, variant)
        self._spp, self._seed, self._images = spp, seed, 0

    def seen(self, at: Samples) -> "Floats":
        """Linear radiance (H, W, 3), noisy."""
        self._images += 1
        seed = int(np.random.SeedSequence((self._seed, self._images)).generate_state(1)[0])
        return self._tracer.radiance(at.surface, self._spp, seed)


class Clear:
    """Direct light with its reflection in the plate, and the interreflection of the untouched face."""

    def __init__(self, sensor: "LitSensor", sheet: Sheet, markers: bool, spp: int, untouched: Surface) -> None:
        effort = TransportEffort.of(spp)
        self.direct = Direct(sensor, sheet, markers, untouched, effort.pieces, effort.samples, effort.sparse)
        radiosity = Radiosity(sensor, untouched)
        added = radiosity.added(sensor, strip_light.points(sensor.leds, *BOUNCE_POINTS))
        mixed = np.einsum("pktc,kc->ptc", added, [led.light for led in sensor.leds])
        self.glow = radiosity.glow(mixed, self.direct.view)

    def seen(self, at: Samples) -> "Floats":
        """Linear radiance (H, W, 3), without noise."""
        return self.direct.seen(at, self.glow)


class Cloudy:
    """The untouched image, and brightness as a function of the averaged thickness, as traced by `traced_maps`."""

    def __init__(self, sensor: "LitSensor", sheet: Sheet, markers: bool, spp: int, variant: str) -> None:
        samples = TransportEffort.of(spp).samples
        self._view, self._gel = CameraView(sensor, sheet, markers, samples), sensor.gel
        self.maps, self._bright, reach = traced_maps.scattered(sensor, spp, variant)
        map_ = np.einsum("khwc,kc->hwc", self.maps, [led.light for led in sensor.leds])
        self.scattered = traced_maps.spread(map_, PinholeCamera.from_sensor(sensor).shape)
        self._reach = reach / sensor.camera.mm_per_px * samples

    def seen(self, at: Samples) -> "Floats":
        """Linear radiance (H, W, 3), without noise of its own."""
        share = scattering.thickness(self._gel, at.position).reshape(self._view.shape)
        averaged = scattering.averaged(share, self._reach)
        made = self._view.picture(self._bright.tabulated.at(averaged.ravel()))
        made *= self.scattered
        return made


class Tabled:
    """A look-up table of light by slope and position, calibrated on images of dents by `Clear`: optics/taxim_table."""

    def __init__(self, sensor: "LitSensor", sheet: Sheet, markers: bool, spp: int, untouched: Surface) -> None:
        """`sensor` must be one without a layer that scatters."""
        self._view, self._mm = CameraView(sensor, sheet, markers), sensor.camera.mm_per_px
        self._lamps, light = housing.strips(sensor), np.array([led.light for led in sensor.leds])
        level = self._view.look(untouched)
        self._normals = level.normal.reshape(*self._view.shape, 3)
        fine = Sheet.over(sensor.gel, SHEET_SPACING_MM)  # of the dents, whatever the pictures'

        def calibrate() -> "Floats":
            coarse = traced_maps.zoomed(sensor, TABLE_COLUMNS)
            view = CameraView(coarse, fine, False)
            dented: list[Surface] = [untouched, *taxim_table.dents(sensor, untouched)]
            flat, *seen = (view.look(face) for face in dented)
            faces = [self._face(at, flat.normal.reshape(*view.shape, 3)) for at in seen]
            made = []
            for k, lamp in enumerate(self._lamps):
                alone = Clear(traced_maps.lit_by(coarse, {k}), fine, False, TABLE_EFFORT, untouched)
                bare = alone.seen(flat)
                added = [alone.seen(at) - bare for at in seen]
                made.append(taxim_table.TaximTable.fitted(faces, added, lamp[None], coarse.camera.mm_per_px).packed)
            return np.array(made)

        face = None if sensor.gel.solid is None else np.round(fine.at(untouched), 3).tolist()  # its file may be another
        how = TABLE_VERSION, TABLE_COLUMNS, TABLE_EFFORT, taxim_table.DENT_CENTRES, taxim_table.DENT_BALLS
        kept = array_cache.kept_one("table", traced_maps.key(sensor, None, *how, face), calibrate)
        self._table = taxim_table.TaximTable.mixed([taxim_table.TaximTable.unpacked(one) for one in kept], light)
        self._flat = Clear(sensor, sheet, False, min(spp, TABLE_EFFORT), untouched).seen(level)

    def seen(self, at: Samples) -> "Floats":
        """Linear radiance (H, W, 3), without noise."""
        added = self._table.added(self._face(at, self._normals), self._lamps, self._mm)
        return self._view.dimmed(at, np.maximum(self._flat + added, 0.0).reshape(-1, 3))

    @staticmethod
    def _face(at: Samples, untouched: "Floats") -> taxim_table.Face:
        shape = untouched.shape
        return taxim_table.Face.of(at.position[:, 2].reshape(shape[:2]), at.normal.reshape(shape), untouched)


class Renderer:
    """One sensor's camera."""

    def __init__(
        self,
        sensor: "LitSensor",
        spp: int,
        seed: int,
        markers: bool,
        variant: str | None = None,
        method: Method = "transport",
        untouched: Surface | None = None,
    ) -> None:
        """`spp`: paths a pixel, with `path` of each image, else of what is traced once; and the level of `Effort`.

        `variant` is Mitsuba's, where that is needed, the best here if None; `seed` is that of the paths in images;
        `untouched` is the face at rest, which a gel that is a solid must be given.

        Raises:
            ValueError: spp < 1.
        """
        if spp < 1:
            raise ValueError(f"spp must be at least 1, not {spp}")
        self.sensor = sensor
        effort, self.untouched = TransportEffort.of(spp), untouched or Untouched.of(sensor.gel)
        self.sheet = Sheet.over(sensor.gel, SHEET_SPACING_MM if method == "path" else effort.spacing)
        self._view = CameraView(sensor, self.sheet, markers, effort.samples)
        self.stray = camera_response.stray(sensor.camera) if any(sensor.camera.ambient) else None
        self.glare = None if sensor.camera.glare is None else camera_response.glare(sensor.camera).astype(np.float32)
        pixel = sensor.camera.mm_per_px / effort.samples
        self.texture = coat_texture.texture(sensor.coating, self.sheet.size, pixel)
        self.relief = coat_texture.relief(sensor.coating, self.sheet.size, pixel)
        self.light: Light
        if clear(sensor, method):
            self.name = "transport"
            self.light = Clear(sensor, self.sheet, markers, spp, self.untouched)
            return
        if method == "table":
            self.name = "table"
            self.light = Tabled(sensor, self.sheet, markers, spp, self.untouched)
            return
        variant = variant or probing.best().variant
        self.name = f"mitsuba {version('mitsuba')} {variant}"
        if method == "path":
            self.light = Traced(sensor, markers, spp, seed, variant)
        else:
            self.light = Cloudy(sensor, self.sheet, markers, spp, variant)

    def image(self, surface: Surface) -> "NDArray[np.float32]":
        """Linear radiance (H, W, 3) of a deformed face, before the response; transport's only noise is the map's. An
        automatic exposure has acted on it."""
        made, share = self._with_glare(self._without_glare(surface)), self.sensor.camera.auto_exposure
        if share:
            made *= (self._level / max(float(made.mean()), DARKEST)) ** share
        return made

    @cached_property
    def _level(self) -> float:
        """Mean radiance of the untouched face, for which the exposure is set."""
        return float(self._with_glare(self._bare).mean())

    def _with_glare(self, seen: "NDArray[np.float32]") -> "NDArray[np.float32]":
        if self.glare is None:
            return seen
        if self._scatters:
            return np.asarray(seen * self._brighter, np.float32)
        return np.asarray(np.maximum(seen + self.glare, 0), np.float32)

    @cached_property
    def _bare(self) -> "NDArray[np.float32]":
        """Radiance (H, W, 3) of the untouched face without glare."""
        return self._without_glare(self.untouched)

    @cached_property
    def _brighter(self) -> "NDArray[np.float32]":
        """Factor (H, W, 3) of the glare on light that a gel scatters, all of which comes through the gel."""
        assert self.glare is not None
        return np.asarray(np.maximum(1 + self.glare / np.where(self._bare > 0, self._bare, np.inf), 0), np.float32)

    @property
    def _scatters(self) -> bool:
        return any(layer.scattering for layer in self.sensor.gel.clear_layers)

    def _without_glare(self, surface: Surface) -> "NDArray[np.float32]":
        at = self._view.look(surface)
        if self.relief is not None:
            at.emboss(self.relief)
        made = np.asarray(self.light.seen(at), dtype=np.float64)
        if self.stray is not None:
            self._view.add_even(made, at, self.stray)
        if self.texture is not None:
            factor = coat_texture.sampled(self.texture, self.sheet.size, at.rest)
            made = made * self._view.picture(factor[:, None])
        if self.sensor.thickness_response is not None:
            change = at.position[:, 2] - self._height(at.position[:, :2])
            response, (wide, tall) = self.sensor.thickness_response, self.sensor.camera.pixel_mm
            gain = self._view.picture(scattering.tabulated(response).at(change))
            made *= scattering.spread(gain, response.spread_mm / tall, response.spread_mm / wide)
        return camera_response.blurred(made, self.sensor.camera).astype(np.float32)

    def _height(self, xy: "Floats") -> "Floats":
        face = self.untouched
        return face.height(xy) if isinstance(face, Untouched) else np.asarray(face.at(xy)[:, 2])

    def flat(self) -> "NDArray[np.float32]":
        """Linear radiance (H, W, 3) of the untouched face."""
        return self.image(self.untouched)

    def develop(
        self, radiance: "NDArray[np.float32]", random: np.random.Generator | None = None, gain: "Floats | None" = None
    ) -> "NDArray[np.uint8]":
        """The camera's 8-bit picture (H, W, 3) of a radiance picture, with its noise if `random` is given, and as JPEG
        leaves it if the camera compresses its pictures; `gain` (3,) is a factor on each colour."""
        return self.compressed(camera_response.develop(radiance, self.sensor.camera, random, gain))

    def compressed(self, picture: "NDArray[np.uint8]") -> "NDArray[np.uint8]":
        """An 8-bit picture (H, W, 3) as the camera sends it: as JPEG leaves it, or unchanged."""
        quality = self.sensor.camera.jpeg_quality
        return picture if quality is None else jpeg.compressed(picture, quality)


def clear(sensor: "Sensor", method: str) -> bool:
    """Whether light is computed by `Clear`."""
    return method == "transport" and not any(layer.scattering for layer in sensor.gel.clear_layers)


class TransportEffort(NamedTuple):
    """Parameters of `transport` that trade time for accuracy."""

    pieces: int  # along each strip
    samples: int  # rays along a pixel's side
    spacing: float  # [mm] between the sheet's nodes
    sparse: adaptive_sampling.SamplingTolerance

    @classmethod
    def of(cls, spp: int) -> "TransportEffort":
        """The parameters for `spp`, that of draft, default or reference."""
        if spp < 32:
            return cls(5, 1, 2 * SHEET_SPACING_MM, adaptive_sampling.SamplingTolerance(8, 1e-2, 0.6))
        if spp <= 256:
            return cls(6, 1, SHEET_SPACING_MM, adaptive_sampling.SamplingTolerance())
        return cls(16, 2, SHEET_SPACING_MM, adaptive_sampling.SamplingTolerance(4, 3e-3, 0.12))
