"""Files that a scene's recipe names and that its bundle holds: the mesh of its object, the tables of its replays.

What ships with tacgen is not kept, and no file that is MAX_KEPT_BYTES or more, since it would be in each bundle of a
data set.
"""

import hashlib
import json
import re
import shutil
import weakref
from collections.abc import Iterator
from functools import cache, lru_cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

from tacgen.base import output_file, regular_file
from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.stored_json import parsed
from tacgen.recipe import assets, loading
from tacgen.recipe.row import Row
from tacgen.sensor.model import Sensor
from tacgen.sensor.yaml_source import KeyPath, Tree, at, format_path, put

MAX_KEPT_BYTES = 16 * 2**20  # [bytes], a binary STL of 330 000 triangles


class Folder:
    """A temporary folder, removed with the last object that holds it. (TemporaryDirectory would warn of that.)"""

    def __init__(self) -> None:
        self.path = Path(mkdtemp(prefix="tacgen-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


@cache
def folder() -> Folder:
    """Where files are put that bundles hold, until this process ends."""
    return Folder()


def _places(recipe: Any) -> Iterator[KeyPath]:
    """The places in a recipe's plain values that name a file which is kept."""
    steps = at(recipe, ("trajectory",))
    for where in (("indenter", "file"), *(("trajectory", i, "replay", "file") for i in range(len(steps or ())))):
        if isinstance(at(recipe, where), str):
            yield where


def _dataset(where: KeyPath) -> str:
    return f"/files/{format_path(where)}"


def _files(row: Row) -> Iterator[tuple[KeyPath, Path]]:
    """The files of a scene that do not ship with tacgen, and their places in the recipe."""
    for where in _places(document := row.recipe.document()):
        name, start = str(at(document, where)), row.folders.get(where)
        if where[0] != "indenter":
            yield where, assets.beside(name, start)
        elif not assets.object_path(name, start).is_dir():
            yield where, row.mesh_path


def of(row: Row) -> dict[str, np.ndarray]:
    """The datasets of a scene's files, each (bytes,). Raises OSError: one of them cannot be read."""
    kept = {_dataset(where): path for where, path in _files(row) if path.stat().st_size < MAX_KEPT_BYTES}
    return {name: np.frombuffer(regular_file.read_bytes(path, MAX_KEPT_BYTES), np.uint8) for name, path in kept.items()}


def note(row: Row) -> str:
    """The note on files that are too large to be kept; empty if there are none."""
    names = [path.name for _, path in _files(row) if path.stat().st_size >= MAX_KEPT_BYTES]
    large = f"is larger than {MAX_KEPT_BYTES / 1e6:.2g} MB and not in the bundle: keep it beside the bundle"
    return f"{', '.join(names)} {large}" if names else ""


def contents(bundle: Bundle) -> dict[KeyPath, bytes]:
    """The files in a bundle by their places in its recipe."""
    return {where: bundle[path].tobytes() for where in _places(bundle.recipe) if (path := _dataset(where)) in bundle}


def located(bundle: Bundle) -> dict[KeyPath, Path]:
    """Copies of the files in a bundle by their places in its recipe; they last as long as this process."""
    return {where: _copy(str(at(bundle.recipe, where)), content) for where, content in contents(bundle).items()}


def runnable(bundle: Bundle) -> dict[str, Any]:
    """The resolved recipe, with the paths of copies of what it names and the bundle holds: its files, and its sensor
    where the name does not give that one. (Of a grasp the sensor of the other finger is not there.)"""
    recipe: Any = bundle.recipe
    for where, path in located(bundle).items():
        recipe = put(recipe, where, str(path))
    held = json.loads(bundle.attrs.get("sensor_document", "{}"))
    file = at(held, ("gel", "solid", "file"))
    named = str(recipe.get("sensor")), json.dumps(recipe.get("sensor_overrides", {})), json.dumps(held)
    if held and "finger" not in bundle.attrs and (file is None or Path(file).is_absolute()) and not _gives(*named):
        copy = _copy(f"{held['name']}.yaml", json.dumps(held).encode())
        recipe = {**recipe, "sensor": str(copy), "sensor_overrides": {}}
    return dict(recipe)


@lru_cache(maxsize=64)
def _gives(name: str, overrides: str, document: str) -> bool:
    """Whether the file of a sensor, with these overrides (JSON), gives this sensor (JSON)."""
    try:
        tree = Tree({"sensor": name, "sensor_overrides": json.loads(overrides)})
        found, _, wrong = loading.named_sensor(tree, images=False)
        return not wrong and found == parsed(Sensor, document)
    except (UserError, ValueError):
        return False


def _copy(name: str, content: bytes) -> Path:
    """A file with this content, and the last part of this name."""
    last = re.sub(r"[^\w. -]", "_", re.split(r"[/\\]", name)[-1]).lstrip(".") or "file"
    path = folder().path / hashlib.sha256(content).hexdigest() / last
    path.parent.mkdir(exist_ok=True)
    output_file.put(path, content)
    return path
