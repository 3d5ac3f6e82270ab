"""Checks of the optics of a sensor file that has all parts that images need."""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from tacgen.sensor.base_model import Vec3
from tacgen.sensor.imperfections import COATING_PATTERN_FIELDS
from tacgen.sensor.model import Led, LitSensor
from tacgen.sensor.validation_messages import Issue

if TYPE_CHECKING:
    from tacgen.geometry.outline import Pad

GEOMETRY_TOL = 1e-6  # of distances [mm] and of the sine of the angle between two directions [-]
MAX_RAY_ANGLE_DEG = 80.0  # between a camera's ray and the plate's normal [deg]


def problems(sensor: LitSensor) -> Iterator[Issue]:
    """A problem for each part that is impossible; paths start at the sensor's root."""
    yield from _layers(sensor)
    eye = sensor.camera
    if not _in_housing(sensor.gel.pad, *eye.center_mm, 0.0):
        place = f"({eye.center_mm[0]:g}, {eye.center_mm[1]:g})"
        text = f"the camera's axis meets the coating outside the pad, at {place}: nearer to 0, 0"
        yield Issue(("camera", "center_mm"), text)
    if _steepest(sensor) > MAX_RAY_ANGLE_DEG:
        text = f"turns the picture's corner {_steepest(sensor):.0f} degrees off the plate's normal"
        text += ": less tilt, more distance_mm or a smaller picture"
        yield Issue(("camera", "tilt_deg"), text)
    if eye.colour_matrix and _singular(eye.colour_matrix):
        yield Issue(("camera", "colour_matrix"), "mixes three colours to two: its determinant is 0; change a row")
    yield from _dots(sensor)
    room = _Room.of(sensor)
    for i, led in enumerate(sensor.leds):
        problem = _wrong_led(room, led)
        if problem:
            yield Issue(("leds", i, problem[0]), f"{led.name}: {problem[1]}")


def _singular(matrix: tuple[Vec3, Vec3, Vec3]) -> bool:
    import numpy as np

    return bool(abs(np.linalg.det(matrix)) < GEOMETRY_TOL)


def _layers(sensor: LitSensor) -> Iterator[Issue]:
    gel, clear = sensor.gel, sensor.gel.clear_layers
    for i, layer in enumerate(gel.layers):
        if i >= len(clear) and layer.scattering:
            yield Issue(("gel", "layers", i, "scattering"), "no light comes here, behind an opaque layer: leave it out")
    scattering = [i for i, layer in enumerate(clear) if layer.scattering]
    if scattering and (len(clear) > 1 or gel.dome or gel.solid):
        text = (
            "a layer that scatters must be the only one that is not opaque, and under a flat face: leave scattering out"
        )
        yield Issue(("gel", "layers", scattering[0], "scattering"), text)
    elif gel.dome and len(clear) > 1:
        text = "light is followed through one clear layer under a dome, not several: leave dome out"
        yield Issue(("gel", "dome"), text)
    for key in COATING_PATTERN_FIELDS if scattering else ():
        if getattr(sensor.coating, key) is not None:
            yield Issue(("coating", key), "cannot be seen through a layer that scatters: leave it out", at_key=True)
    if scattering and sensor.camera.aspect != 1:
        text = "must be absent where a layer scatters: resize the pictures to square pixels"
        yield Issue(("camera", "pixel_aspect"), text)
    if scattering and sensor.markers:
        text = "cannot be seen through a layer that scatters: leave them out, or scattering"
        yield Issue(("markers",), text, at_key=True)


def _steepest(sensor: LitSensor) -> float:
    """Largest angle of a ray to the plate's normal [deg]: that of the picture's corner, plus the tilt."""
    eye, layers = sensor.camera, (sensor.plate, *sensor.gel.clear_layers)
    depth = eye.distance_mm + sum(layer.thickness_mm / layer.refractive_index for layer in layers)
    sizes = zip((eye.width_px, eye.height_px), eye.pixel_mm, eye.crop_mm, strict=True)
    corner = math.hypot(*(size * pixel / 2 + abs(crop) for size, pixel, crop in sizes))
    return math.degrees(math.atan2(corner, depth)) + math.hypot(*eye.tilt_deg)


def _dots(sensor: LitSensor) -> Iterator[Issue]:
    dots, gel = sensor.markers, sensor.gel
    if dots is None:
        return
    keys = ("rings", "rings") if dots.layout == "hexagonal" else ("columns", "rows")
    counts = max(dots.row_counts), len(dots.row_counts)
    sides = gel.width_mm, gel.height_mm
    for key, count, spacing, side, middle in zip(keys, counts, dots.spacing_mm, sides, dots.middle_mm, strict=True):
        if (count - 1) * spacing + 2 * abs(middle) > side:
            aside = f" and {middle:g} mm off its middle" if middle else ""
            text = f"{count} dots, {spacing:g} mm apart, do not fit on {side:g} mm of gel{aside}: fewer, or closer ones"
            yield Issue(("markers", key), text)


class _Room(NamedTuple):
    """The bounds of the LEDs: all of the sensor that decides whether an LED is inside. It is the key of a cache."""

    pad: "Pad"
    margin: float  # between the pad and the housing [mm]
    thickness: float  # of the whole gel [mm]
    clear: float  # thickness of the clear layers [mm]
    scattering: bool
    bottom: float  # z of the plate's air face [mm]
    camera: float  # z of the camera [mm]

    @classmethod
    def of(cls, sensor: LitSensor) -> "_Room":
        gel = sensor.gel
        total, clear = (sum(layer.thickness_mm for layer in layers) for layers in (gel.layers, gel.clear_layers))
        bottom = -sensor.plate.thickness_mm - total
        scattering = any(layer.scattering for layer in gel.clear_layers)
        margin, camera = sensor.walls.margin_mm, bottom - sensor.camera.distance_mm
        return cls(gel.pad, margin, total, clear, scattering, bottom, camera)

    def coating_z(self, x: float, y: float) -> float:
        """z of the coating's inner side at (x, y) [mm]; beside the pad, that of the crown."""
        if not _in_housing(self.pad, x, y, 0.0):
            return 0.0
        return (self.thickness + float(self.pad.top(x, y))) * self.clear / self.thickness - self.thickness


def wrong_led(sensor: LitSensor, led: Led) -> tuple[str, str] | None:
    """The key of an LED that is wrong, and the reason; None if the LED is possible."""
    return _wrong_led(_Room.of(sensor), led)


@lru_cache
def _wrong_led(room: _Room, led: Led) -> tuple[str, str] | None:
    """`wrong_led`, cached: scenes that vary other parts of the sensor check each LED once."""
    import numpy as np

    normal, along = np.array(led.normal), np.cross(led.up, led.normal)
    if np.linalg.norm(along) <= GEOMETRY_TOL * np.linalg.norm(led.up) * np.linalg.norm(normal):
        key = "up" if normal.any() else "normal"
        return key, f"normal {_vector(led.normal)} and up {_vector(led.up)} must be neither zero nor parallel"
    sides = np.array([along, np.cross(normal, along)])
    sides *= np.array(led.size_mm)[:, None] / 2 / np.linalg.norm(sides, axis=1)[:, None]
    corners = np.array(led.center_mm) + np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) @ sides
    bottom = room.bottom
    for x, y, z in corners.tolist():
        if not _in_housing(room.pad, x, y, room.margin):
            return "center_mm", f"pokes out of the housing, at {_vector((x, y, z))}: move it, or raise walls.margin_mm"
        if z > room.coating_z(x, y) - GEOMETRY_TOL:
            return "center_mm", f"reaches into the coating, at {_vector((x, y, z))}: lower, or smaller"
    below = [z < bottom - GEOMETRY_TOL for *_, z in corners]
    if any(below) and not all(below):
        return "center_mm", f"pokes out of the plate, whose air face is at z = {bottom:g}: higher, or smaller"
    if all(below) and not room.scattering:
        text = f"lies in the air under the plate (z < {bottom:g}): only a gel that scatters is lit from there: raise it"
        return "center_mm", text
    if all(below) and led.center_mm[2] < room.camera:
        return "center_mm", f"lies behind the camera, which is at z = {room.camera:g}: raise it"
    return None


def _in_housing(pad: "Pad", x: float, y: float, margin: float) -> bool:
    """Whether (x, y) is inside the housing, `margin` [mm] off the pad and with square corners."""
    return bool(pad.housing(margin).contains(x, y, GEOMETRY_TOL))


def _vector(v: tuple[float, ...]) -> str:
    return f"({', '.join(f'{c:.4g}' for c in v)})"
