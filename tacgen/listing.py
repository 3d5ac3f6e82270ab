"""What there is to choose from, one line each: for `tacgen list`."""

from collections.abc import Callable

from tacgen import assets
from tacgen.load import read_sensor
from tacgen.recipe import SHAPES
from tacgen.yamlfile import load

Entries = dict[str, str]  # name -> one line about it


def sensors() -> Entries:
    """Shipped sensors."""
    return {name: read_sensor(assets.sensor_path(name))[0].description for name in assets.list_sensors()}


def recipes() -> Entries:
    """Shipped recipes; the line about one is the first comment of its file."""
    found = {}
    for name in assets.list_recipes():
        path = assets.recipe_path(name)
        load(path)  # a recipe that is no YAML should not be offered
        found[name] = path.read_text(encoding="utf-8").split("\n", 1)[0].lstrip("# ")
    return found


def objects() -> Entries:
    """Shipped objects."""
    return {name: str(assets.object_path(name)) for name in assets.list_objects()}


def shapes() -> Entries:
    """Indenter shapes and their fields; those with a default can be left out."""
    return {
        name: ", ".join(
            key if info.is_required() else f"{key}={info.default:g}"
            for key, info in kind.model_fields.items()
            if key != "shape"
        )
        + f"  ({(kind.__doc__ or '').rstrip('.')})"
        for name, kind in SHAPES.items()
    }


KINDS: dict[str, Callable[[], Entries]] = {
    "sensors": sensors,
    "recipes": recipes,
    "objects": objects,
    "shapes": shapes,
}
