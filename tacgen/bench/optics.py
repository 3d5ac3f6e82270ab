"""How far pictures are from Mitsuba's `path`, and what they cost: sensors x solved faces x methods and settings.

PSNR in dB on the developed sRGB picture before rounding and without the camera's noise. The reference comes in two
independent halves: the mean of the product of the two errors, in linear light and turned into sRGB by the slope at the
picture measured, has none of their noise in it, however strong that is. References are kept in the cache.
"""

import hashlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from tacgen import fields, mesh, plan, render, scene, solve
from tacgen.files import store
from tacgen.image.tracer import PathTracer
from tacgen.optics import response
from tacgen.optics.sheet import Sheet, Surface, Untouched
from tacgen.optics.view import Samples
from tacgen.recipe import QUALITIES
from tacgen.spec import assets
from tacgen.spec.sensor import Camera, LitSensor

Array = np.ndarray
BALL = "indenter={shape: sphere, radius_mm: 4}"
BOX = "indenter={shape: box, size_x_mm: 5, size_y_mm: 4, fillet_mm: 0.2}"
PRESS = "trajectory=[{press: {depth_mm: %g, frames: 2}}]"
SHEAR = "trajectory=[{press: {depth_mm: %g, frames: 2}}, {slide: {x_mm: 0.4, y_mm: 0.3, frames: 2}}]"
FACES = {  # what is pressed, the movement, its depth against the ball's, and whether there are dots
    "untouched": (BALL, "", 0.0, False),
    "ball": (BALL, PRESS, 1.0, False),
    "sharp box": (BOX, PRESS, 0.5, False),
    "sheared dots": (BALL, SHEAR, 1.0, True),
}
DEPTHS = {"gelsight_mini": 1.0, "digit": 1.0, "ninedtact": 0.8}  # of the ball [mm]
DOTS = (  # printed on a DIGIT, which has none: as on the Mini, turned
    "sensor.markers={columns: 7, rows: 9, pitch_mm: [2.0625, 2.0625], diameter_mm: 1.0, albedo: 0.065, source: bench}"
)
WAYS = [("transport", quality) for quality in QUALITIES] + [("path", str(spp)) for spp in (16, 64)]
PATH_FACE = "ball"  # that paths are held against themselves on: their noise is the same on all
CHUNK = 256  # paths a pixel that a reference is traced with at a time


@dataclass(frozen=True)
class Outcome:
    """A picture against its reference: PSNR [dB] and how sure that is, and its seconds of processor: a frame's, and
    what was made ready before the first one."""

    sensor: str
    face: str
    method: str
    setting: str
    decibel: float
    sure: float
    seconds: float
    ready: float
    pixels: tuple[int, int]


class Kept:
    """Light from the cache, traced where it is not there yet."""

    def __init__(self, sensor: LitSensor, markers: bool, spp: int, seed: int, variant: str) -> None:
        self.sensor, self.markers, self.spp, self.seed, self.variant = sensor, markers, spp, seed, variant

    def seen(self, at: Samples) -> Array:
        """Linear radiance (H, W, 3) at `spp` paths a pixel."""

        def trace() -> Array:
            sheet = Sheet.over(self.sensor.gel, render.SPACING)
            tracer, parts = PathTracer(self.sensor, sheet, self.markers, self.variant), range(-(-self.spp // CHUNK))
            traced = [tracer.render(at.nodes, min(self.spp, CHUNK), self.seed + 1000 * i) for i in parts]
            return np.asarray(np.mean(traced, axis=0))

        return store.kept_one("path", self.name(at.nodes), trace)

    def name(self, nodes: Array) -> str:
        """Its place in the cache, whatever the variant."""
        dots = self.sensor.markers.model_dump() if self.markers and self.sensor.markers else None
        light = [led.light for led in self.sensor.leds]
        face = hashlib.sha256(nodes.astype(np.float32).tobytes()).hexdigest()
        return render.key(self.sensor, "any", light, dots, face, self.spp, self.seed)


def solved(sensor: str, face: str, shrink: int) -> tuple[LitSensor, Surface, bool]:
    """The sensor with a picture `shrink` times smaller, the face that it sees, and whether dots are on it."""
    indenter, path, share, dots = FACES[face]
    sets = [f"sensor={sensor}", indenter, "contact.friction=0.8", "outputs=[force]"]
    sets += [path % (share * DEPTHS[sensor])] if path else []
    dots &= sensor != "ninedtact"  # they cannot be seen through what scatters
    row = plan.load(assets.recipe_path("quickstart"), [*sets, *([DOTS] if dots and sensor == "digit" else [])]).rows[0]
    lit = cast(LitSensor, row.sensor)
    lit = render.zoomed(lit, lit.camera.width_px // shrink) if shrink > 1 else lit
    if not path:
        return lit, Untouched.of(lit.gel), dots
    made = scene.build(row)
    problem = solve.Problem.of(made, mesh.of(made))
    *_, last = solve.states(made, problem)
    return lit, fields.seen(problem.mesh, len(lit.gel.clear_layers)).moved(last.x), dots


def decibel(picture: Array, halves: Sequence[Array], camera: Camera, noisy: bool) -> tuple[float, float]:
    """PSNR [dB] of a radiance picture (H, W, 3), that may be `noisy` itself, against two noisy ones, and its standard
    deviation [dB]; where that hides the error, no more PSNR than is sure."""
    x, *truths = (response.expose(light.astype(np.float64), camera) for light in (picture, *halves))
    slope = response.slope(np.clip(x, 0.0, 1.0)) * (x < 1.0)
    off = [response.srgb(x) - response.srgb(truth) if noisy else slope * (x - truth) for truth in truths]
    product = np.prod(off, axis=0).mean(axis=2)
    sure = float(product.std() / np.sqrt(product.size))
    error = max(float(product.mean()), sure, 1e-9)
    return float(-10 * np.log10(error)), float(10 * np.log10(1 + sure / error))


def measure(
    sensors: Sequence[str], faces: Sequence[str], spp: int, shrink: int, ways: Sequence[tuple[str, str]], variant: str
) -> Iterator[Outcome]:
    """Each outcome, against references of `spp` paths a pixel in each half."""
    for name in sensors:
        ready: dict[tuple[str, str, bool], tuple[render.Renderer, float]] = {}
        for face in faces:
            sensor, surface, dots = solved(name, face, shrink)
            halves = []
            for seed in (11, 12):
                kept = render.Renderer(sensor, 1, 0, dots, variant, "path")
                kept.light = Kept(sensor, dots, spp, seed, variant)
                halves.append(kept.image(surface))
            for way in ways:
                if way[0] == "path" and face != PATH_FACE:
                    continue
                if (*way, dots) not in ready:
                    begun = time.process_time()
                    paths = QUALITIES[way[1]].spp if way[0] == "transport" else int(way[1])
                    made = render.Renderer(sensor, paths, 0, dots, variant, way[0])  # type: ignore[arg-type]
                    ready[(*way, dots)] = made, time.process_time() - begun
                    made.image(surface)  # compiles
                renderer, before = ready[(*way, dots)]
                begun = time.process_time()
                picture = renderer.image(surface)
                seconds = time.process_time() - begun
                size = (sensor.camera.width_px, sensor.camera.height_px)
                found = decibel(picture, halves, sensor.camera, noisy=way[0] == "path")
                yield Outcome(name, face, *way, *found, seconds, before, size)
