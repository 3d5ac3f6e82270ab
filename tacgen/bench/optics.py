"""How far pictures are from Mitsuba's `path`, and what they cost: sensors x solved faces x methods and settings.

PSNR in dB on the developed sRGB picture before rounding and without the camera's noise. The reference's own noise,
known from two independent halves, is taken off the mean square error. References are kept in the cache.
"""

import hashlib
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from tacgen import fields, mesh, plan, render, scene, solve
from tacgen.image.tracer import PathTracer
from tacgen.optics import response
from tacgen.optics.sheet import Sheet, Surface, Untouched
from tacgen.optics.view import Samples
from tacgen.recipe import QUALITIES
from tacgen.spec import assets
from tacgen.spec.sensor import LitSensor

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
WAYS = [("transport", quality) for quality in QUALITIES] + [("path", str(spp)) for spp in (16, 64, 256)]
CHUNK = 256  # paths a pixel that a reference is traced with at a time


@dataclass(frozen=True)
class Outcome:
    """A picture against its reference: PSNR [dB] with and without the reference's noise taken off, and its seconds of
    processor: a frame's, and what was made ready before the first one."""

    sensor: str
    face: str
    method: str
    setting: str
    decibel: float
    plain: float
    seconds: float
    ready: float
    pixels: tuple[int, int]

    @property
    def name(self) -> str:
        """What was measured, as a file's name."""
        return f"{self.sensor} {self.face} {self.method} {self.setting}".replace(" ", "_")

    def line(self) -> str:
        """A row of the table."""
        return (
            f"{self.sensor:<14} {self.face:<13} {self.method:<10} {self.setting:<10}"
            f" {self.decibel:6.1f} {self.plain:6.1f} {self.seconds:7.3f} {self.ready:7.2f}"
        )


HEADER = (
    f"{'sensor':<14} {'face':<13} {'method':<10} {'setting':<10} {'dB':>6} {'plain':>6} {'s/frame':>7} {'ready s':>7}"
)


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

        return render.cached("path", self.name(at.nodes), trace)

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


def decibel(picture: Array, halves: Array) -> tuple[float, float]:
    """(corrected, plain) PSNR [dB] of a picture (H, W, 3) in [0, 1] against the mean of two halves (2, H, W, 3)."""
    error = np.mean((picture - halves.mean(axis=0)) ** 2)
    noise = np.mean((halves[0] - halves[1]) ** 2) / 4
    corrected, plain = (float(-10 * np.log10(max(e, 1e-9))) for e in (error - noise, error))
    return corrected, plain


def measure(
    sensors: Sequence[str], faces: Sequence[str], spp: int, shrink: int, ways: Sequence[tuple[str, str]], variant: str
) -> Iterator[tuple[Outcome, Array, Array]]:
    """Each outcome with its picture and the reference's (H, W, 3) in [0, 1], `spp` paths a pixel in each half."""
    for name in sensors:
        ready: dict[tuple[str, str, bool], tuple[render.Renderer, float]] = {}
        for face in faces:
            sensor, surface, dots = solved(name, face, shrink)

            def shown(radiance: Array, sensor: LitSensor = sensor) -> Array:
                return response.srgb(response.expose(radiance.astype(np.float64), sensor.camera))

            halves = []
            for seed in (11, 12):
                kept = render.Renderer(sensor, 1, 0, dots, variant, "path")
                kept.light = Kept(sensor, dots, spp, seed, variant)
                halves.append(shown(kept.image(surface)))
            for way in ways:
                if (*way, dots) not in ready:
                    begun = time.process_time()
                    paths = QUALITIES[way[1]].spp if way[0] == "transport" else int(way[1])
                    made = render.Renderer(sensor, paths, 0, dots, variant, way[0])  # type: ignore[arg-type]
                    ready[(*way, dots)] = made, time.process_time() - begun
                    made.image(surface)  # compiles
                renderer, before = ready[(*way, dots)]
                begun = time.process_time()
                picture = shown(renderer.image(surface))
                seconds = time.process_time() - begun
                size = (sensor.camera.width_px, sensor.camera.height_px)
                told = Outcome(name, face, *way, *decibel(picture, np.array(halves)), seconds, before, size)
                yield told, picture, np.mean(halves, axis=0)


def write(outcomes: Sequence[Outcome], folder: Path, about: dict[str, Any]) -> None:
    """The table as text and JSON, and error against time as a picture."""
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "optics.txt").write_text("\n".join([HEADER, *(o.line() for o in outcomes)]) + "\n")
    table = {**about, "outcomes": [asdict(o) for o in outcomes]}
    (folder / "optics.json").write_text(json.dumps(table, indent=1) + "\n")
    sensors = list(dict.fromkeys(o.sensor for o in outcomes))
    figure = Figure(figsize=(4.2 * len(sensors), 4.0), layout="constrained")
    for axes, name in zip(figure.subplots(1, len(sensors), squeeze=False)[0], sensors, strict=True):
        own = [o for o in outcomes if o.sensor == name]
        for k, way in enumerate(dict.fromkeys((o.method, o.setting) for o in own)):
            for face, mark in zip(FACES, "os^D", strict=True):
                at = [(o.seconds, o.decibel) for o in own if (o.method, o.setting) == way and o.face == face]
                label = " ".join(way) if face == own[0].face else None
                axes.scatter(*zip(*at, strict=True), color=f"C{k}", marker=mark, s=28, label=label) if at else None
        axes.axhline(40.0, color="0.7", lw=0.8)
        axes.axvline(0.5, color="0.7", lw=0.8)
        axes.set(xscale="log", title=f"{name}, {own[0].pixels[0]} x {own[0].pixels[1]}", xlabel="s a frame, one core")
        axes.set_ylabel("PSNR against path [dB]")
        axes.legend(fontsize=7)
    figure.suptitle("o untouched   s ball   ^ sharp box   D sheared dots", fontsize=9)
    figure.savefig(folder / "optics.png", dpi=110)


def beside(picture: Array, truth: Array, path: Path) -> None:
    """A picture, its reference, and eight times their difference around grey, all (H, W, 3) in [0, 1]."""
    from matplotlib.image import imsave

    path.parent.mkdir(parents=True, exist_ok=True)
    imsave(path, np.concatenate([picture, truth, np.clip(0.5 + 8 * (picture - truth), 0, 1)], axis=1))
