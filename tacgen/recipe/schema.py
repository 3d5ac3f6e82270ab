"""JSON Schemas of recipes and sensor files for editors, and the starter files of `tacgen init`."""

import json
import os
import re
from pathlib import Path
from typing import Any

from tacgen.base import output_file, regular_file
from tacgen.base.errors import UserError, printable
from tacgen.recipe import assets, loading
from tacgen.recipe.model import Recipe
from tacgen.sensor.model import Sensor
from tacgen.sensor.yaml_source import at, load, quoted, text_of

SCHEMA_FILE, SENSOR_SCHEMA_FILE = "tacgen.schema.json", "tacgen-sensor.schema.json"
MAX_SCHEMA_BYTES = 2**24  # [bytes]
STARTER_SENSOR = Path(__file__).with_name("starter_sensor.yaml")
PATH_KEYS = ("extends", "sensor", "sensors", "right", "file", "background", "choice")  # keys of texts that may be paths
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
        start: name or path of the file to copy; "": the one that ships for this purpose. What it names in its folder
            is copied to the same place beside `path`.
        overwrite: replace existing files.

    Returns:
        the file's and the schema's path.

    Raises:
        UserError: a file exists and `overwrite` is not set, or it is one that is copied; `start` cannot be found, or is
            not valid.
    """
    home, schema = path.parent, path.parent / (SENSOR_SCHEMA_FILE if sensor else SCHEMA_FILE)
    plain = json.dumps(sensor_schema() if sensor else recipe_schema(), indent=1) + "\n"
    found, text, beside = _start(path, sensor, start)
    files: dict[Path, tuple[bytes, dict[str, Any]]] = {path: (text.encode(), {"overwrite": overwrite})}
    ours = {"overwrite": overwrite or _is_schema(schema), "within": home}  # that of another version is replaced
    files[schema] = (plain.encode(), ours)
    for name, content in beside.items():
        if home / name in files:
            raise UserError(f"{home / name}: is named by {found}, which is copied: choose another name")
        files[home / name] = (content, {"overwrite": overwrite, "within": home})
    for target, (content, how) in files.items():
        if target == path or not output_file.holds(target, content):
            output_file.refuse(target, [found], **how)
    for target, (content, how) in files.items():
        output_file.put(target, content, [found], **how)
    return path, schema


def _is_schema(path: Path) -> bool:
    """Whether a file is a schema that tacgen wrote."""
    try:
        text = regular_file.read_bytes(path, MAX_SCHEMA_BYTES, noted=False).decode(errors="replace")
    except OSError:
        return False
    return '"$schema"' in text and '"tacgen' in text


def _start(path: Path, sensor: bool, start: str) -> tuple[Path, str, dict[str, bytes]]:
    """The file that is copied, the text for its copy at `path`, and what lies beside it: path from there -> content."""
    name = start or ("" if sensor else "quickstart")
    found = STARTER_SENSOR if not name else assets.sensor_path(name) if sensor else assets.recipe_path(name)
    (loading.read_sensor if sensor else loading.read)(found)
    beside: dict[str, bytes] = {}
    same = os.path.realpath(found.parent) == os.path.realpath(path.parent)
    title, *lines = (text_of(found) if same else _moved(found, found.parent, beside)).splitlines()
    place = printable(" ".join(str(path).split()))
    use = f"#   tacgen validate {place}" if sensor else f"#   tacgen run {place} -o out/first"
    lines = [use if line.startswith(("#   tacgen run", "#   tacgen validate")) else line for line in lines]
    lines = [title, *lines] if use in lines else [title, use, *lines] if title.startswith("#") else [use, title, *lines]
    head = f"# yaml-language-server: $schema={SENSOR_SCHEMA_FILE if sensor else SCHEMA_FILE}"
    text = "\n".join([head, *lines, ""])
    if not sensor:
        text = text.replace("name: quickstart", "name: first")
    elif name:
        origin = name if name in assets.list_sensors() else ""
        called = path.stem if re.fullmatch(r"[a-zA-Z]\w*", path.stem) else quoted(Path(path.stem))
        lines = [f"name: {called}", *([f"base: {origin}{BASE_NOTE}"] if origin else [])]
        text = re.sub(r"^name:.*$", lambda _: "\n".join(lines), text, count=1, flags=re.M)
    return found, text, beside


def _moved(source: Path, folder: Path, beside: dict[str, bytes]) -> str:
    """The text of a YAML file in `folder`, or below, for the same place in another folder.

    Files of `folder` that it names are added to `beside`, by their paths from there: nothing else is copied. Shipped
    ones are named, and paths that lead out of it become absolute.
    """
    tree = load(source)
    lines = list(tree.spot(()).value.source.lines)
    for path, spot in sorted(tree.spots.items(), key=lambda item: (item[1].value.line, -item[1].value.column)):
        name, key = at(tree.data, path), next((step for step in reversed(path) if isinstance(step, str)), "")
        if not isinstance(name, str) or key not in PATH_KEYS or not Path(name).suffix or name.startswith(("/", "~")):
            continue
        other = source.parent / name
        if not other.is_file():
            continue
        place = os.path.relpath(other, folder)
        if _shipped(other):
            new = Path(other.stem)
        elif place.startswith("..") or not other.resolve().is_relative_to(folder.resolve()):
            new = other.resolve()
        else:
            if place not in beside:
                beside[place] = b""  # a file may name the one that names it
                if other.suffix in assets.YAML_SUFFIXES:
                    beside[place] = _moved(other, folder, beside).encode()
                else:
                    beside[place] = regular_file.content(other, assets.MAX_ASSET_BYTES)
            continue
        line, column = spot.value.line, spot.value.column
        written = next((t for t in (name, f'"{name}"', f"'{name}'") if lines[line][column:].startswith(t)), None)
        if written is None:
            raise UserError(spot.value.point("write this path in one line, without escapes, so that it can be copied"))
        lines[line] = lines[line][:column] + quoted(new) + lines[line][column + len(written) :]
    return "\n".join([*lines, ""])


def _shipped(path: Path) -> bool:
    """Whether a recipe or sensor is found by its name."""
    return path.resolve() in {(assets.folder(kind) / f"{path.stem}.yaml").resolve() for kind in ("recipes", "sensors")}
