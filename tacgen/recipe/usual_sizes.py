"""Warnings about a recipe's numbers that are probably mistakes: lengths in metres, friction, depth."""

from collections.abc import Iterator

from tacgen.recipe.model import Recipe
from tacgen.sensor.base_model import Part
from tacgen.sensor.model import Gel
from tacgen.sensor.validation_messages import Issue
from tacgen.sensor.yaml_source import KeyPath

# Below these [mm] a length is probably meant in metres. Depths are a tenth of a gel's thickness or more; a body below a
# tenth of a millimetre passes between the contact points of any mesh. Radii of edges and tips may be small.
MIN_USUAL_MM = {"depth_mm": 0.02, "tip_radius_mm": 0.01, "fillet_mm": 0.01, "x_mm": 0.02, "y_mm": 0.02}
MIN_USUAL_MM |= dict.fromkeys(("radius_mm", "tube_radius_mm", "length_mm", "size_x_mm", "size_y_mm", "size_mm"), 0.1)

MAX_USUAL_FRICTION = 3.0  # coefficient of soft, clean silicone on smooth glass, the largest that is measured [-]
MAX_USUAL_DEPTH = 0.7  # of a press, over the gel's thickness under it [-]; beyond it elements are nearly crushed


def in_metres(key: str, value: object) -> str:
    """`lengths are in mm: 3 mm if it is in m?` for a length [mm] that is so small; "" for any other value."""
    if not isinstance(value, float) or not 0 < abs(value) < MIN_USUAL_MM.get(key, 0.0):
        return ""
    return f"lengths are in mm: {1000 * value:g} mm if it is in m?"


def unusual(recipe: Recipe, gel: Gel) -> Iterator[Issue]:
    """A problem for each length of the indenter and of the movements that is probably in metres, not for x and y of a
    way whose other component is usual; for a friction that no gel has, and for a press through nearly all the gel.
    Paths start at the recipe's root."""
    yield from _within(recipe.indenter, ("indenter",))
    if (friction := recipe.contact.friction) > MAX_USUAL_FRICTION:
        text = f"a coefficient of {friction:g}; that of gels is at most about {MAX_USUAL_FRICTION:g}"
        yield Issue(("contact", "friction"), text)
    thick = thickness_mm(recipe, gel)
    for i, step in enumerate(recipe.trajectory):
        yield from _within(step.move, ("trajectory", i, step.kind))
        depth = step.press.depth_mm if step.press else None
        if depth is not None and MAX_USUAL_DEPTH * thick < depth:
            text = f"presses {depth:g} mm into a gel {thick:g} mm thick: forces so deep are uncertain"
            yield Issue(("trajectory", i, "press", "depth_mm"), text)


def thickness_mm(recipe: Recipe, gel: Gel) -> float:
    """The gel's thickness under the start."""
    return gel.thickness_mm - gel.drop_mm(recipe.start.x_mm, recipe.start.y_mm)


def _within(part: Part, path: KeyPath) -> Iterator[Issue]:
    values = {name: value for name, value in part if isinstance(value, float)}
    way = max((abs(values.get(name, 0.0)) for name in ("x_mm", "y_mm")), default=0.0)
    for name, value in values.items():
        aside = name in ("x_mm", "y_mm") and way >= MIN_USUAL_MM[name]
        if (hint := in_metres(name, value)) and not aside:
            yield Issue((*path, name), f"{value:g} mm is very small; {hint}")
