"""The available sensors, recipes, objects, shapes, outputs and formats, one line each: for `tacgen list`."""

from collections.abc import Callable
from pathlib import Path

from tacgen.export import EXPORTERS
from tacgen.outputs import OUTPUT_NAMES, OUTPUTS
from tacgen.recipe import assets
from tacgen.recipe.indenters import INDENTER_SHAPES
from tacgen.sensor.yaml_source import at, load, text_of

Entries = dict[str, str]  # name -> description in one line


def sensors() -> Entries:
    """Shipped sensors by the description in their files, which are not checked: that may need a mesh to be read."""
    return {
        name: str(at(load(assets.sensor_path(name)).data, ("description",)) or "") for name in assets.list_sensors()
    }


def recipes() -> Entries:
    """Shipped recipes, described by the first comment of their files."""
    described = {}
    for name in assets.list_recipes():
        path = assets.recipe_path(name)
        load(path)  # raises UserError if it is not valid YAML
        described[name] = text_of(path).split("\n", 1)[0].lstrip("# ")
    return described


def objects() -> Entries:
    """Shipped objects, described by the first line of their README without the name."""
    return {name: _about(assets.object_path(name) / "README.md") for name in assets.list_objects()}


def _about(readme: Path) -> str:
    first = readme.read_text(encoding="utf-8").split("\n", 1)[0] if readme.is_file() else ""
    return first.lstrip("# ").split(": ", 1)[-1]


def shapes() -> Entries:
    """Indenter shapes and their fields, with defaults."""
    return {
        name: ", ".join(
            key if info.is_required() else f"{key}={_short(info.default)}"
            for key, info in kind.model_fields.items()
            if key != "shape" and (info.is_required() or info.default is not None)
        )
        + f"  ({(kind.__doc__ or '').rstrip('.')})"
        for name, kind in INDENTER_SHAPES.items()
    }


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


CATALOGUE_KINDS: dict[str, Callable[[], Entries]] = {
    "sensors": sensors,
    "recipes": recipes,
    "objects": objects,
    "shapes": shapes,
    "outputs": lambda: {name: OUTPUTS[name].text for name in OUTPUT_NAMES},
    "formats": lambda: EXPORTERS,
}
