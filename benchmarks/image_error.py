"""Error of images against Mitsuba's `path`, and their time: sensors x solved faces x methods and settings.

PSNR in dB on the developed image before rounding and without the camera's noise. The reference consists of several
independent parts. The mean product of the image's errors against each pair of parts, in linear light and converted to
counts by the slope of the response, is an unbiased estimate of the squared error, however noisy the parts are. Its
standard deviation falls with the number of paths per pixel, but only with the root of the number of pixels, so many
paths at few pixels are best. The pixels are drawn at random, one in each cell of a grid, which has no bias.
References are cached.
"""

import hashlib
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, cast

import numpy as np

from tacgen import mechanics
from tacgen.base import array_cache
from tacgen.mechanics import mesh
from tacgen.optics import camera_response
from tacgen.optics.camera_view import Samples
from tacgen.optics.surface_grid import Surface, Untouched
from tacgen.outputs import gel_surface
from tacgen.recipe import assets, plan, scene_of_row
from tacgen.recipe.model import QUALITIES
from tacgen.render import images, mitsuba_variants, traced_maps
from tacgen.render.mitsuba_path import PathTracer, Window, traced_sheet
from tacgen.sensor.model import Camera, LitSensor

Array = np.ndarray
BALL = "indenter={shape: sphere, radius_mm: 4}"
BOX = "indenter={shape: box, size_x_mm: 5, size_y_mm: 4, fillet_mm: 0.2}"
PRESS = "trajectory=[{press: {depth_mm: %g, frames: 2}}]"
SHEAR = "trajectory=[{press: {depth_mm: %g, frames: 2}}, {slide: {x_mm: 0.4, y_mm: 0.3, frames: 2}}]"
FACES = {  # indenter, movement, depth over that of the ball, and whether there are markers
    "untouched": (BALL, "", 0.0, False),
    "ball": (BALL, PRESS, 1.0, False),
    "sharp box": (BOX, PRESS, 0.5, False),
    "sheared dots": (BALL, SHEAR, 1.0, True),
}
DEPTHS = {"gelsight_mini": 1.0, "digit": 1.0, "ninedtact": 0.8}  # of the ball [mm]
DOTS = (  # for DIGIT, which has no markers: the Mini's grid, rotated
    "sensor.markers={columns: 7, rows: 9, pitch_mm: [2.0625, 2.0625], diameter_mm: 1.0, albedo: 0.065, source: bench}"
)
METHODS = [("transport", quality) for quality in QUALITIES] + [("path", str(spp)) for spp in (16, 64)]
BEST_METHOD = len(QUALITIES) - 1  # its index
PATH_FACE = "ball"  # the only face on which `path` is measured: its noise is the same on all
BAND_COUNT, BAND_SHARE = 4, 16  # bands in which paths are traced, and the number of all rows over theirs
MAX_SPP = 256  # paths a pixel in one pass over a whole picture


@dataclass(frozen=True)
class Outcome:
    """An image against its reference: PSNR [dB] and its standard deviation, and processor seconds of a frame and of the
    setup."""

    sensor: str
    face: str
    method: str
    setting: str
    decibel: float
    sure: float
    seconds: float
    ready: float
    pixels: tuple[int, int]


@dataclass(frozen=True)
class Truth:
    """How a reference is traced: number of parts, paths a pixel in each, number of pixels (None: all)."""

    parts: int
    spp: int
    pixels: int | None = None


class Reference(NamedTuple):
    """A sensor, a solved face, whether it has markers, and traced images (H, W, 3), nan outside the chosen pixels."""

    sensor: LitSensor
    surface: Surface
    dots: bool
    truths: list[Array]


class Paths:
    """Light by Mitsuba's paths in some windows or everywhere; with `keep`, each image is cached."""

    def __init__(
        self, sensor: LitSensor, markers: bool, spp: int, variant: str, windows: Sequence[Window], keep: bool
    ) -> None:
        self.sensor, self.markers, self.spp, self.variant = sensor, markers, spp, variant
        self.windows, self.keep, self.looks, self.seconds = windows, keep, 0, 0.0

    @cached_property
    def _tracer(self) -> PathTracer:
        return PathTracer(self.sensor, traced_sheet(self.sensor), self.markers, self.variant)

    def seen(self, at: Samples) -> Array:
        """Linear radiance (H, W, 3), nan outside the windows."""
        self.looks += 1
        if not self.keep:
            return self._trace(at)
        width, height = self.sensor.camera.width_px, self.sensor.camera.height_px
        there, made = np.zeros((height, width), bool), np.full((height, width, 3), np.nan, np.float32)
        for x, y, w, h in self.windows or [(0, 0, width, height)]:
            there[y : y + h, x : x + w] = True
        made[there] = array_cache.kept_one("path", self.name(at.nodes), lambda: self._trace(at)[there])
        return made

    def _trace(self, at: Samples) -> Array:
        tracer, started = self._tracer, time.process_time()
        if self.windows:
            made = tracer.windows(tracer.sheet.at(at.surface), self.windows, self.spp, self.looks)
        else:
            parts = range(-(-self.spp // MAX_SPP))
            traced = [tracer.radiance(at.surface, min(self.spp, MAX_SPP), 1000 * self.looks + i) for i in parts]
            made = np.mean(traced, axis=0)
        self.seconds += time.process_time() - started
        return made.astype(np.float32)

    def name(self, nodes: Array) -> str:
        """Its key in the cache, independent of the variant."""
        dots = self.sensor.markers.model_dump() if self.markers and self.sensor.markers else None
        light = [led.light for led in self.sensor.leds]
        face = hashlib.sha256(nodes.astype(np.float32).tobytes()).hexdigest()
        return traced_maps.key(self.sensor, "any", light, dots, face, self.spp, self.windows, self.looks)


def chosen(camera: Camera, count: int, seed: int = 0) -> list[Window]:
    """About `count` pixels, one at random in each cell of a grid, with equal probability for all pixels."""
    width, height = camera.width_px, camera.height_px
    rows = max(1, round((count * height / width) ** 0.5))
    columns = max(1, round(count / rows))
    at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2)
    at = (at + np.random.default_rng(seed).random(at.shape)) * [width / columns, height / rows]
    return [(int(x), int(y), 1, 1) for x, y in at]


def solved(sensor: str, face: str, shrink: int) -> tuple[LitSensor, Surface, bool]:
    """The sensor with an image `shrink` times smaller, the solved face, and whether it has markers."""
    indenter, path, share, dots = FACES[face]
    sets = [f"sensor={sensor}", indenter, "contact.friction=0.8", "outputs=[force]"]
    sets += [path % (share * DEPTHS[sensor])] if path else []
    dots &= sensor != "ninedtact"  # invisible through a scattering gel
    row = plan.load(assets.recipe_path("quickstart"), [*sets, *([DOTS] if dots and sensor == "digit" else [])]).rows[0]
    lit = cast(LitSensor, row.sensor)
    lit = traced_maps.zoomed(lit, lit.camera.width_px // shrink) if shrink > 1 else lit
    if not path:
        return lit, Untouched.of(lit.gel), dots
    made = scene_of_row.build(row)
    problem = mechanics.Problem.of(made, mesh.of(made))
    *_, last = mechanics.states(made, problem)
    return lit, gel_surface.seen(problem.mesh, len(lit.gel.clear_layers)).pressed(problem, last), dots


def decibel(picture: Array, truths: Sequence[Array], camera: Camera, noisy: bool) -> tuple[float, float]:
    """PSNR [dB] of a radiance image (H, W, 3), which may be `noisy` itself, against several noisy ones where they are
    not nan, and its standard deviation [dB]. An error below the standard deviation counts as that."""
    lights = np.array([camera_response.expose(light.astype(np.float64), camera) for light in (picture, *truths)])
    x, *parts = lights[:, np.isfinite(lights).all((0, 3))]
    slope = camera_response.slope(np.clip(x, 0.0, 1.0), camera) * (x < 1.0)
    off = np.array(
        [
            camera_response.encoded(x, camera) - camera_response.encoded(part, camera) if noisy else slope * (x - part)
            for part in parts
        ]
    )
    products = (off.sum(0) ** 2 - (off**2).sum(0)).mean(1) / (len(off) * (len(off) - 1))  # of each with each other
    sure = float(products.std() / np.sqrt(products.size))
    error = max(float(products.mean()), sure, 1e-9)
    return float(-10 * np.log10(error)), float(10 * np.log10(1 + sure / error))


def reference(name: str, face: str, shrink: int, how: Truth, variant: str) -> Reference:
    """A solved face and its traced images, from the cache if they are there."""
    sensor, surface, dots = solved(name, face, shrink)
    windows = chosen(sensor.camera, how.pixels) if how.pixels else ()
    variant = mitsuba_variants.SCALAR_VARIANT if windows else variant  # others compile for each window
    kept = images.Renderer(sensor, 1, 0, dots, variant, "path")
    kept.light = Paths(sensor, dots, how.spp, variant, windows, True)
    return Reference(sensor, surface, dots, [kept.image(surface) for _ in range(how.parts)])


def measure(
    name: str, found: Mapping[str, Reference], ways: Sequence[tuple[str, str]], variant: str
) -> Iterator[Outcome]:
    """All outcomes of a sensor, for the given references of its faces."""
    ready: dict[tuple[str, str, bool], tuple[images.Renderer, float]] = {}
    for face, (sensor, surface, dots, truths) in found.items():
        size, best = (sensor.camera.width_px, sensor.camera.height_px), truths[0]
        for method, setting in ways:
            if method == "path":
                if face == PATH_FACE:
                    yield Outcome(name, face, method, setting, *_noise(found[face], int(setting), best, variant), size)
                continue
            if (method, setting, dots) not in ready:
                started, paths = time.process_time(), QUALITIES[setting].spp if method == "transport" else int(setting)
                made = images.Renderer(sensor, paths, 0, dots, variant, method)  # type: ignore[arg-type]
                ready[method, setting, dots] = made, time.process_time() - started
                made.image(surface)  # compiles
            renderer, before = ready[method, setting, dots]
            started = time.process_time()
            picture = renderer.image(surface)
            seconds = time.process_time() - started
            if (method, setting) == METHODS[BEST_METHOD]:
                best = picture
            error = decibel(picture, truths, sensor.camera, noisy=False)
            yield Outcome(name, face, method, setting, *error, seconds, before, size)


def _noise(seen: Reference, spp: int, best: Array, variant: str) -> tuple[float, float, float, float]:
    """PSNR [dB] of `path`, its standard deviation, seconds of a frame and of the setup: measured in bands of the image,
    against the best noise-free image, whose error is negligible here."""
    width, height = seen.sensor.camera.width_px, seen.sensor.camera.height_px
    rows = max(1, height // (BAND_COUNT * BAND_SHARE))
    bands = [(0, (2 * i + 1) * height // (2 * BAND_COUNT) - rows // 2, width, rows) for i in range(BAND_COUNT)]
    started = time.process_time()
    renderer = images.Renderer(seen.sensor, 1, 0, seen.dots, variant, "path")
    paths = renderer.light = Paths(seen.sensor, seen.dots, spp, variant, bands, False)
    before = time.process_time() - started
    paths.spp = 1
    renderer.image(seen.surface)  # compiles
    paths.spp, paths.seconds, started = spp, 0.0, time.process_time()
    picture = renderer.image(seen.surface)
    seconds = time.process_time() - started + paths.seconds * (height / (BAND_COUNT * rows) - 1)
    return *decibel(picture, [best, best], seen.sensor.camera, noisy=True), seconds, before
