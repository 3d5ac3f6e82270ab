"""Checks of a sensor alone: contradictions in its file."""

import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, cast

from tacgen.base.errors import UserError
from tacgen.recipe import assets, sensor_base
from tacgen.sensor import optics_checks
from tacgen.sensor.base_model import Axis
from tacgen.sensor.model import LIGHT_FIELDS, Gel, LitSensor, Sensor, Solid
from tacgen.sensor.validation_messages import Issue, needs, validate

MAX_SOLID_SIZE_ERROR = 0.01  # largest difference between a solid's sides and those in its sensor file, relative [-]
MIN_SIDE_PX = 8  # smallest number of the image's pixels along the gel's shorter side
MIN_RIM_RATIO = 0.1  # thickness of a domed gel at its corner over that at the crown [-]; below, cells are too flat


def check(data: Any, folder: Path | None = None, images: bool = True) -> tuple[Sensor | None, list[Issue]]:
    """A sensor from plain data, or all that is wrong with it; paths start at the sensor's root.

    The path of the gel's solid is relative to `folder`, by default the working directory. Without `images` the lights
    are not checked: a recipe that makes the gel thinner may leave them outside.
    """
    sensor, wrong = validate(Sensor, data)
    wrong += _lights(data)
    if sensor is not None:
        wrong += [*_outline(sensor.gel), *_solid(sensor.gel, folder), *_seen(sensor), *sensor_base.problems(sensor)]
        wrong += optics_checks.problems(cast(LitSensor, sensor)) if images and sensor.lit else []
    return (None if wrong or sensor is None else sensor_base.marked(sensor)), wrong


def _lights(data: Any) -> list[Issue]:
    """The parts that images need and that are missing from a sensor file, given as plain data.

    A plate may be given alone; coating, walls and LEDs need each other and the plate.
    """
    there = [name for name in LIGHT_FIELDS if isinstance(data, dict) and data.get(name) is not None]
    if there in ([], ["plate"]):
        return []
    text, missing = f"is missing, and {there[-1]} is there", [name for name in LIGHT_FIELDS if name not in there]
    return [Issue((name,), f"{text}{needs(Sensor, (name,))}", at_key=True) for name in missing]


def _outline(gel: Gel) -> Iterator[Issue]:
    half = min(gel.width_mm, gel.height_mm) / 2
    if gel.corner_radius_mm > half:
        text = f"must be at most half the pad's shorter side, {half:g} (got {gel.corner_radius_mm:g})"
        yield Issue(("gel", "corner_radius_mm"), text)
    if gel.tip and gel.corner_radius_mm:
        yield Issue(("gel", "corner_radius_mm"), "must be 0 beside an outline with a semicircular end")
    if gel.tip and gel.width_mm / 2 > gel.height_mm:
        text = f"a semicircle over {gel.width_mm:g} mm does not fit into a height of {gel.height_mm:g}"
        yield Issue(("gel", "outline"), f"{text}: leave outline out")
    rim = gel.thickness_mm - gel.drop_mm(gel.width_mm / 2, gel.height_mm / 2)
    if rim < MIN_RIM_RATIO * gel.thickness_mm:
        text = f"leaves {rim:.3g} mm of gel at the pad's corner, less than a tenth of what the crown has: larger radii"
        yield Issue(("gel", "dome"), text)


def _seen(sensor: Sensor) -> Iterator[Issue]:
    """The camera must see the coating; a wrong unit leaves the gel a few pixels, or dots on top of each other."""
    dots, scale = sensor.markers, sensor.camera.mm_per_px
    side = min(sensor.gel.width_mm, sensor.gel.height_mm)
    if sensor.gel.layers[0].opaque:
        text = "hides the coating: layers are from the bonded base outward, and the first must be clear"
        yield Issue(("gel", "layers", 0, "opaque"), text)
    if side < MIN_SIDE_PX * scale:
        text = f"leaves {side / scale:.2g} pixels for the gel, {side:g} mm: a wrong unit?"
        yield Issue(("camera", "mm_per_px"), text)
    if dots and dots.diameter_mm >= dots.nearest_mm:
        text = f"dots of {dots.diameter_mm:g} mm touch at a pitch of {dots.nearest_mm:g} mm: smaller or farther ones"
        yield Issue(("markers", "diameter_mm"), text)


def _solid(gel: Gel, folder: Path | None) -> list[Issue]:
    """The file must exist, have the right hash, be closed, be bonded, and have the size that the sensor file says."""
    if gel.solid is None:
        return []
    text = "cannot be given beside solid, which is the whole shape: leave it out"
    if excluded := [name for name in ("outline", "dome", "corner_radius_mm") if getattr(gel, name)]:
        return [Issue(("gel", name), text, at_key=True) for name in excluded]
    from tacgen.geometry import mesh_import

    try:
        path = assets.mesh_path(gel.solid.file, folder)
        sizes, loose = mesh_import.sizes(path, gel.solid.up, gel.solid.scale), _bonded(gel.solid, path)[1]
    except UserError as error:
        return [Issue(("gel", "solid", "file"), error.lines[0])]
    if gel.solid.sha256 not in (None, sha256 := assets.sha256(path)):
        return [Issue(("gel", "solid", "sha256"), f"{gel.solid.file} {assets.changed(sha256)}")]
    said = {"width_mm": gel.width_mm, "height_mm": gel.height_mm, "layers": gel.thickness_mm}
    wrong = [
        Issue(("gel", key), f"the solid measures {size:.4g} mm along {axis} (got {value:g}): is scale or up wrong?")
        for (key, value), size, axis in zip(said.items(), sizes, "xyz", strict=True)
        if abs(size - value) > MAX_SOLID_SIZE_ERROR * value
    ]
    return wrong or ([Issue(("gel", "solid"), loose)] if loose else [])


def bonded_note(sensor: Sensor, folder: Path | None) -> list[str]:
    """A line on how much of a solid gel is bonded; `folder` as for `check`."""
    if (solid := sensor.gel.solid) is None:
        return []
    share = _bonded(solid, assets.mesh_path(solid.file, folder))[0]
    return [f"{share:.0%} of the gel's footprint is bonded to the plate"]


def _bonded(solid: Solid, path: Path) -> tuple[float, str]:
    """Part of a solid's footprint that is bonded [-], and why that is too little; cached until its file changes."""
    state = path.stat()
    how = (math.radians(solid.bonded_deg), solid.bonded_mm)
    return _held_by(path, solid.up, solid.scale, how, state.st_mtime_ns, state.st_size)


@cache
def _held_by(path: Path, up: Axis, scale: float, how: tuple[float, float | None], *_: int) -> tuple[float, str]:
    from tacgen.geometry import gel, mesh_file, mesh_import

    return gel.held_by(mesh_import.placed(mesh_file.read(path), up=up, scale=scale), *how)
