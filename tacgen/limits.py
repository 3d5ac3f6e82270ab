"""What cannot be done on this sensor: the checks that need the recipe and the sensor side by side."""

import math
from pathlib import Path

from tacgen import assets
from tacgen.errors import UserError
from tacgen.explain import Problem
from tacgen.recipe import Indenter, Recipe
from tacgen.sensor import LIGHTS, Gel, Sensor
from tacgen.yamlfile import KeyPath

LEAST_RIM = 0.1  # of the crown's thickness: cells squeezed more would not be worth having


def sensor_problems(sensor: Sensor) -> list[Problem]:
    """What contradicts itself in a sensor file; paths start at the sensor's root."""
    return [*_outline(sensor.gel), *_lights(sensor)]


def recipe_problems(recipe: Recipe, sensor: Sensor, folder: Path | None = None) -> list[Problem]:
    """What this recipe asks for and this sensor cannot give; paths start at the recipe's root.

    `folder` is where the path of the indenter's mesh starts; None: the working directory.
    """
    wrong = [*_depths(recipe, sensor), *_places(recipe, sensor.gel), *_outputs(recipe, sensor)]
    return [*wrong, *_mesh(recipe.indenter, folder)]


def thickness_mm(gel: Gel) -> float:
    """From the bonded base to the coated face [mm]."""
    return sum(layer.thickness_mm for layer in gel.layers)


def on_pad(gel: Gel, x_mm: float, y_mm: float) -> bool:
    """Whether a point of the plane lies inside the pad's outline, or on it."""
    if gel.tip:
        r = gel.width_mm / 2
        past = gel.tip * y_mm - (gel.height_mm / 2 - r)  # beyond the semicircle's centre, toward the tip
        beside = abs(x_mm) <= r * (1 + 1e-9) and -gel.tip * y_mm <= gel.height_mm / 2 * (1 + 1e-9)
        return beside and math.hypot(x_mm, max(past, 0.0)) <= r * (1 + 1e-9)
    r = gel.corner_radius_mm
    past_x = max(abs(x_mm) - (gel.width_mm / 2 - r), 0.0)
    past_y = max(abs(y_mm) - (gel.height_mm / 2 - r), 0.0)
    return math.hypot(past_x, past_y) <= r + 1e-9 * gel.width_mm


def _outline(gel: Gel) -> list[Problem]:
    half, wrong = min(gel.width_mm, gel.height_mm) / 2, []
    if gel.corner_radius_mm > half:
        text = f"must be at most half the pad's shorter side, {half:g} (got {gel.corner_radius_mm:g})"
        wrong.append(Problem(("gel", "corner_radius_mm"), text))
    if gel.tip and gel.corner_radius_mm:
        wrong.append(Problem(("gel", "corner_radius_mm"), "must be 0 beside an outline with a semicircular end"))
    if gel.tip and gel.width_mm / 2 > gel.height_mm:
        text = f"a semicircle over {gel.width_mm:g} mm does not fit into the pad's height, {gel.height_mm:g}"
        wrong.append(Problem(("gel", "outline"), text))
    rim = thickness_mm(gel) - gel.drop_mm(gel.width_mm / 2, gel.height_mm / 2)
    if rim < LEAST_RIM * thickness_mm(gel):
        text = f"leaves {rim:.3g} mm of gel at the pad's corner, less than a tenth of what the crown has"
        wrong.append(Problem(("gel", "dome"), text))
    return wrong


def _lights(sensor: Sensor) -> list[Problem]:
    """A plate may stand alone; coating, walls and LEDs come together and with it, for none makes an image alone."""
    there = [name for name in LIGHTS if getattr(sensor, name) is not None]
    if sensor.lit or there in ([], ["plate"]):
        return []
    missing = [name for name in LIGHTS if name not in there]
    return [Problem((name,), f"is missing, and {there[-1]} is there", at_key=True) for name in missing]


def _depths(recipe: Recipe, sensor: Sensor) -> list[Problem]:
    """Depth counts from first touch: on a dome, from no lower than the face under the start."""
    gel, start = sensor.gel, recipe.start
    thick = thickness_mm(gel) - gel.drop_mm(start.x_mm, start.y_mm)
    return [
        Problem(
            ("trajectory", i, "press", "depth_mm"),
            f"must be less than the gel is thick, {thick:g} mm (got {segment.press.depth_mm:g})",
        )
        for i, segment in enumerate(recipe.trajectory)
        if segment.press and segment.press.depth_mm is not None and segment.press.depth_mm >= thick
    ]


def _places(recipe: Recipe, gel: Gel) -> list[Problem]:
    """The indenter's axis must stay over the pad; the first move off it is named, and ends the search."""
    pad = f"the pad of {gel.width_mm:g} x {gel.height_mm:g} mm"
    x, y = recipe.start.x_mm, recipe.start.y_mm
    if not on_pad(gel, x, y):
        path: KeyPath = ("start", "x_mm" if abs(x) > gel.width_mm / 2 else "y_mm")
        if abs(x) <= gel.width_mm / 2 and abs(y) <= gel.height_mm / 2:
            path = ("start",)  # in the cut-off corner: neither alone is to blame
        return [Problem(path, f"the indenter would start beside {pad}, at ({x:g}, {y:g})")]
    for i, segment in enumerate(recipe.trajectory):
        if segment.slide:
            x, y = x + segment.slide.x_mm, y + segment.slide.y_mm
            if not on_pad(gel, x, y):
                text = f"would carry the indenter's axis off {pad}, to ({x:g}, {y:g})"
                return [Problem(("trajectory", i, "slide"), text)]
    return []


def _outputs(recipe: Recipe, sensor: Sensor) -> list[Problem]:
    wrong = []
    if "markers" in recipe.outputs and sensor.markers is None:
        wrong.append(Problem(("outputs",), f"asks for markers, and the sensor {sensor.name} has none"))
    if "rgb" in recipe.outputs and not sensor.lit:
        wrong.append(Problem(("outputs",), f"asks for rgb: the sensor file {sensor.name} describes no lights yet"))
    return wrong


def _mesh(indenter: Indenter, folder: Path | None) -> list[Problem]:
    if indenter.shape != "mesh":
        return []
    try:
        found = assets.sha256(assets.mesh_path(indenter.file, folder))
    except UserError as error:
        return [Problem(("indenter", "file"), error.lines[0])]
    if indenter.sha256 in (None, found):
        return []
    return [Problem(("indenter", "sha256"), f"{indenter.file} is another file now ({found[:12]}...)")]
