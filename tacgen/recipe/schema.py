"""JSON Schemas of recipes and sensor files for editors, and the starter files of `tacgen init`."""

import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from tacgen import output_file, regular_file
from tacgen.recipe import assets, loading
from tacgen.recipe.model import Recipe
from tacgen.sensor.model import Sensor
from tacgen.sensor.yaml_source import at

SCHEMA_FILE, SENSOR_SCHEMA_FILE = "tacgen.schema.json", "tacgen-sensor.schema.json"
LARGEST_SCHEMA = 2**24  # [bytes]
STARTER = Path(__file__).with_name("starter_sensor.yaml")
BASE_NOTE = "  # parts that differ from it in numbers, but not in source, count as assumed"


def recipe_schema() -> dict[str, Any]:
    """JSON Schema of a recipe file."""
    schema = Recipe.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    about = "A recipe whose values this one overrides: a shipped one's name, or a path."
    schema["properties"]["extends"] = {"type": "string", "description": about}
    needed = schema.pop("required")
    several = ["sensors" if name == "sensor" else name for name in needed]
    # the extended recipe may hold the rest
    schema["anyOf"] = [{"required": needed}, {"required": several}, {"required": ["extends"]}]
    return schema


def sensor_schema() -> dict[str, Any]:
    """JSON Schema of a sensor file."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Sensor.model_json_schema()}


def write_starter(path: Path, *, sensor: bool, start: str = "", overwrite: bool) -> tuple[Path, Path]:
    """Write a commented recipe or sensor file, and next to it the schema for completion in an editor.

    Args:
        path: the file to write; a sensor gets its stem as name.
        sensor: write a sensor file instead of a recipe.
        start: name or path of the file to copy; "": the one that ships for this purpose. Meshes and tables beside
            it that it names are copied too.
        overwrite: replace existing files.

    Returns:
        the file's and the schema's path.

    Raises:
        UserError: a file exists and `overwrite` is not set, or `start` cannot be found.
    """
    schema = path.parent / (SENSOR_SCHEMA_FILE if sensor else SCHEMA_FILE)
    plain = json.dumps(sensor_schema() if sensor else recipe_schema(), indent=1) + "\n"
    output_file.refuse(path, overwrite=overwrite)
    with suppress(FileNotFoundError):  # that of another version is replaced, anything else is not
        if '"$schema"' not in regular_file.read_bytes(schema, LARGEST_SCHEMA).decode(errors="replace"):
            output_file.refuse(schema, overwrite=overwrite)
    for target, content in (*_copied(path, sensor, start), (schema, plain.encode())):
        with output_file.written(target, overwrite=overwrite or target == schema) as new:
            new.write_bytes(content)
    return path, schema


def _copied(path: Path, sensor: bool, start: str) -> list[tuple[Path, bytes]]:
    """The files that make a start, and their contents."""
    name = start or ("" if sensor else "quickstart")
    found = STARTER if not name else assets.sensor_path(name) if sensor else assets.recipe_path(name)
    title, *lines = found.read_text(encoding="utf-8-sig").splitlines()
    use = f"#   tacgen validate {path}" if sensor else f"#   tacgen run {path} -o out/first"
    lines = [use if line.startswith(("#   tacgen run", "#   tacgen validate")) else line for line in lines]
    lines = [title, *lines] if use in lines else [title, use, *lines] if title.startswith("#") else [use, title, *lines]
    head = f"# yaml-language-server: $schema={SENSOR_SCHEMA_FILE if sensor else SCHEMA_FILE}"
    text = "\n".join([head, *lines, ""])
    files: list[Path] = []
    if not sensor:
        text = text.replace("name: quickstart", "name: first")
        text = re.sub(r"^extends: (\w+)\.yaml$", lambda m: f"extends: {_shipped(m[1])}", text, flags=re.M)
        made = loading.read(found)
        files = [Path(str(at(made.tree.data, where))) for where in made.recipe.files]
    elif name:
        read, _ = loading.read_sensor(found)
        origin = name if name in assets.list_sensors() else ""
        lines = [f"name: {path.stem}", *([f"base: {origin}{BASE_NOTE}"] if origin else [])]
        text = re.sub(r"^name:.*$", lambda _: "\n".join(lines), text, count=1, flags=re.M)
        files = [Path(read.gel.solid.file)] if read.gel.solid else []
    beside = [file for file in files if (found.parent / file).is_file()]
    return [(path, text.encode()), *((path.parent / file, (found.parent / file).read_bytes()) for file in beside)]


def _shipped(recipe: str) -> str:
    """The name of a shipped recipe; of another one its file."""
    return recipe if recipe in assets.list_recipes() else f"{recipe}.yaml"
