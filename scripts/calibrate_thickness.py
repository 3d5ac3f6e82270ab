"""Fit a sensor whose gel scatters to photographs of it; called by calibrate_optics.py.

Light is linear in the LEDs' power: the untouched photograph gives their radiances, by least squares on pictures traced
with one LED at a time. The press gives the gain by thickness: the photograph's change over the transport's, on the
face that the solver finds, at the depth and place that fit best.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.optimize import nnls

from tacgen import fields, load, mesh, plan, render, solve
from tacgen import scene as stage
from tacgen.optics import cloudy, response
from tacgen.optics.layers import Camera
from tacgen.optics.sheet import Sheet
from tacgen.optics.view import View
from tacgen.sensor import LitSensor, Sensor
from tacgen.tracer import PathTracer

BALL = 4.0  # [mm] radius
PRESS = f"""\
tacgen: 1
name: press
sensor: {{sensor}}
indenter: {{{{shape: sphere, radius_mm: {BALL}}}}}
trajectory: [{{presses}}]
outputs: [force]
"""
COLUMNS = 46  # of the traced pictures
CHANGES = (-2.1, -1.6, -1.2, -0.8, -0.4, -0.15, 0.0, 0.08, 0.16, 0.24, 0.32, 0.45)  # [mm] where the gain is given


def linear(picture: np.ndarray) -> np.ndarray:
    """Linear light of an 8-bit sRGB picture."""
    e = picture.astype(float) / 255
    return np.where(e <= 0.04045, e / 12.92, ((e + 0.055) / 1.055) ** 2.4)


def radiances(sensor: LitSensor, untouched: np.ndarray, spp: int) -> np.ndarray:
    """(leds, 3): three LEDs a trace, one a channel, which takes a gel and coat without colour."""
    coarse = render.zoomed(sensor, COLUMNS)
    sheet, basis = Sheet.over(sensor.gel, render.SPACING), []
    for first in range(0, len(sensor.leds), 3):
        one = np.eye(3)
        leds = [
            led.model_copy(update={"radiance": tuple(one[k - first]) if first <= k < first + 3 else (0.0, 0.0, 0.0)})
            for k, led in enumerate(sensor.leds)
        ]
        tracer = PathTracer(
            coarse.model_copy(update={"leds": tuple(leds)}), sheet, False, render.probing.best().variant
        )
        picture = render.smooth(tracer.radiance(render.Untouched.of(sensor.gel), spp, first), render.SMOOTH)
        basis.append(response.expose(picture, coarse.camera).reshape(-1, 3)[:, : len(sensor.leds) - first])
    wanted = np.asarray(
        [np.asarray(Image.fromarray(linear(untouched)[..., c].astype(np.float32)).resize(
            (coarse.camera.width_px, coarse.camera.height_px), Image.Resampling.BOX)) for c in range(3)]
    )  # fmt: skip
    return np.array([nnls(np.hstack(basis), wanted[c].ravel())[0] for c in range(3)]).T


def presses(name: str, folder: Path, depths: Sequence[float]) -> Iterator[tuple[float, fields.Surface]]:
    """(depth [mm], the face that the camera sees) of the ball at each depth on its way down."""
    recipe = folder / "press.yaml"
    steps = ", ".join(f"{{press: {{depth_mm: {depth:g}, frames: 1}}}}" for depth in depths)
    recipe.write_text(PRESS.format(sensor=name, presses=steps))
    found = load.read(recipe, ())
    row = plan.expand(found.recipe, found.sensor, loaded=found).rows[0]
    built = stage.build(row)
    problem = solve.Problem.of(built, mesh.build(built.gel, mesh.footprint(built), built.edge))
    face = fields.seen(problem.mesh, len(row.sensor.gel.clear_layers))
    for state in solve.states(built, problem):
        yield -float(state.pose[2, 3]), face.moved(state.x)


class Shifted:
    """A surface moved in the plane."""

    def __init__(self, surface: Any, by: np.ndarray, size: tuple[float, float]) -> None:
        """`size` of the pad [mm]; what would come from off it stays where it is."""
        self.surface, self.by, self.half = surface, by, np.array(size) / 2 * (1 - 1e-9)

    def at(self, xy: np.ndarray) -> np.ndarray:
        """Current positions (n, 3) [mm] of rest positions (n, 2) [mm]."""
        from_ = np.clip(xy - self.by, -self.half, self.half)
        return self.surface.at(from_) + np.column_stack([xy - from_, np.zeros(len(xy))])


def dark_middle(change: np.ndarray) -> np.ndarray:
    """Centre (x, y) [px] of the dark disc of a change picture (h, w)."""
    weight = np.where(change < 0.4 * change.min(), -change, 0.0)
    y, x = np.mgrid[: change.shape[0], : change.shape[1]] + 0.5
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


def seen_at(camera: Camera, pixel: np.ndarray) -> np.ndarray:
    """Place (x, y) [mm] on a dent's floor behind a pixel (2,)."""
    origin, direction = camera.rays(pixel[None])
    return (origin + direction * (-1.5 - origin[:, 2:]) / direction[:, 2:])[0, :2]


def fit(sensor: Sensor, folder: Path, scratch: Path, spp: int) -> None:
    """Print radiances, the press's depth and the gain table."""
    untouched, pressed = (
        np.asarray(Image.open(folder / name).convert("RGB"))
        for name in ("reference_rectified.png", "ball_R4mm_rectified.png")
    )
    found = radiances(sensor, untouched, spp)
    for led, row in zip(sensor.leds, found, strict=True):
        print(f"{led.name}: radiance {np.round(row, 4).tolist()}")
    leds = tuple(led.model_copy(update={"radiance": tuple(row)}) for led, row in zip(sensor.leds, found, strict=True))
    lit = sensor.model_copy(update={"leds": leds, "thickness_response": None})
    renderer, camera = render.Renderer(lit, 64, 0, False), Camera.from_sensor(lit)
    made = renderer.develop(renderer.flat())
    print("untouched mean", untouched.mean(axis=(0, 1)).round(1), "rendered", made.mean(axis=(0, 1)).round(1))
    ratio = linear(pressed) / linear(untouched)
    grey = pressed.mean(axis=2) - untouched.mean(axis=2)
    middle = dark_middle(grey)
    place = seen_at(camera, middle)
    view, base, best = View(lit, renderer.sheet, False), renderer.untouched, (np.inf,)
    flat = renderer.flat().astype(float)
    for depth, face in presses(sensor.name, scratch, np.arange(1.7, 2.0, 0.05)):
        shifted = Shifted(face, place, (sensor.gel.width_mm, sensor.gel.height_mm))
        at = view.look(shifted)
        change = at.position[:, 2] - base.at(at.position[:, :2])[:, 2]
        own = (renderer.image(shifted).astype(float) / flat).reshape(-1, 3)
        wanted = ratio.reshape(-1, 3) / own
        table = gains(change, wanted)
        left = np.hypot(*(camera.project(at.position) - middle).T) < 9.0 / camera.mm_per_px
        model = own * cloudy.between(change, np.array(CHANGES), table)
        off = 255 * (
            response.srgb(linear(untouched).reshape(-1, 3) * model) - response.srgb(linear(pressed).reshape(-1, 3))
        )
        misfit = float(np.sqrt(np.mean(off[left] ** 2)))
        print(f"depth {4 + depth if depth < 0 else depth:.2f} mm: {misfit:.2f} counts rms within 9 mm")
        if misfit < best[0]:
            best = (misfit, table)
    print("thickness_response:\n  change_mm:", list(CHANGES), "\n  gain:")
    for row in best[1]:
        print("    -", np.round(row, 3).tolist())


def gains(change: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Least-squares gain (changes, 3) at CHANGES, slightly smooth, through 1 at no change."""
    known = np.array(CHANGES)
    hat = np.array([np.interp(change, known, row) for row in np.eye(len(known))]).T
    bend = np.zeros((len(known) - 2, len(known)))
    for k in range(len(known) - 2):
        a, b = known[k + 1] - known[k], known[k + 2] - known[k + 1]
        bend[k, k : k + 3] = [1 / a, -1 / a - 1 / b, 1 / b]
    one = 300.0 * np.eye(len(known))[known == 0]
    rows = np.vstack([hat, 1.0 * bend, one])
    return np.array(
        [np.linalg.lstsq(rows, np.concatenate([w, np.zeros(len(bend)), [300.0]]), rcond=None)[0] for w in wanted.T]
    ).T
