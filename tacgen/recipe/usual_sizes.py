"""Warnings about a recipe's lengths that are so small that they are probably in metres."""

from collections.abc import Iterator

from tacgen.recipe.model import Recipe
from tacgen.sensor.base_model import Part
from tacgen.sensor.validation_messages import Issue
from tacgen.sensor.yaml_source import KeyPath

# Below these [mm] a length is probably meant in metres. Depths are a tenth of a gel's thickness or more; a body below a
# tenth of a millimetre passes between the contact points of any mesh. Radii of edges and tips may be small.
MIN_USUAL_MM = {"depth_mm": 0.02, "tip_radius_mm": 0.01, "fillet_mm": 0.01, "x_mm": 0.02, "y_mm": 0.02}
MIN_USUAL_MM |= dict.fromkeys(("radius_mm", "tube_radius_mm", "length_mm", "size_x_mm", "size_y_mm", "size_mm"), 0.1)


def in_metres(key: str, value: object) -> str:
    """`lengths are in mm: 3 mm if it is in m?` for a length [mm] that is so small; "" for any other value."""
    if not isinstance(value, float) or not 0 < abs(value) < MIN_USUAL_MM.get(key, 0.0):
        return ""
    return f"lengths are in mm: {1000 * value:g} mm if it is in m?"


def unusual(recipe: Recipe) -> Iterator[Issue]:
    """A problem for each length of the indenter and of the movements that is probably in metres, not for x and y of a
    way whose other component is usual; paths start at the recipe's root."""
    yield from _within(recipe.indenter, ("indenter",))
    for i, step in enumerate(recipe.trajectory):
        yield from _within(step.move, ("trajectory", i, step.kind))


def _within(part: Part, path: KeyPath) -> Iterator[Issue]:
    values = {name: value for name, value in part if isinstance(value, float)}
    way = max((abs(values.get(name, 0.0)) for name in ("x_mm", "y_mm")), default=0.0)
    for name, value in values.items():
        aside = name in ("x_mm", "y_mm") and way >= MIN_USUAL_MM[name]
        if (hint := in_metres(name, value)) and not aside:
            yield Issue((*path, name), f"{value:g} mm is very small; {hint}")
