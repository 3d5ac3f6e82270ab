"""JSON Schemas of recipes and sensor files for editors, and the starter files of `tacgen init`."""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

from tacgen import output_file, regular_file
from tacgen.recipe import assets
from tacgen.recipe.model import Recipe
from tacgen.sensor.model import Sensor

SCHEMA_FILE, SENSOR_SCHEMA_FILE = "tacgen.schema.json", "tacgen-sensor.schema.json"
LARGEST_SCHEMA = 2**24  # [bytes]


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


def write_starter(path: Path, *, sensor: bool, overwrite: bool) -> tuple[Path, Path]:
    """Write a commented recipe or sensor file, and next to it the schema for completion in an editor.

    Returns:
        the file's and the schema's path.

    Raises:
        UserError: the file exists and `overwrite` is not set.
    """
    schema = path.parent / (SENSOR_SCHEMA_FILE if sensor else SCHEMA_FILE)
    plain = json.dumps(sensor_schema() if sensor else recipe_schema(), indent=1) + "\n"
    output_file.refuse(path, overwrite=overwrite)
    with suppress(FileNotFoundError):  # that of another version is replaced, anything else is not
        if '"$schema"' not in regular_file.read_bytes(schema, LARGEST_SCHEMA).decode(errors="replace"):
            output_file.refuse(schema, overwrite=overwrite)
    start = Path(__file__).with_name("starter_sensor.yaml") if sensor else assets.recipe_path("quickstart")
    title, *lines = start.read_text(encoding="utf-8").splitlines()
    said = f"#   tacgen validate {path}" if sensor else f"#   tacgen run {path} -o out/first"
    body = [said if line.startswith(("#   tacgen run", "#   tacgen validate")) else line for line in lines]
    text = "\n".join([f"# yaml-language-server: $schema={schema.name}", title, *body, ""])
    for target, content in ((path, text.replace("name: quickstart", "name: first")), (schema, plain)):
        with output_file.written(target, overwrite=overwrite or target == schema) as new:
            new.write_text(content, encoding="utf-8")
    return path, schema
