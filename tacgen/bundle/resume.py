"""Resuming a run: a bundle is kept only if it is complete and has the same inputs."""

import json
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tacgen.base import atomic_file
from tacgen.base.errors import UserError
from tacgen.base.version import __version__
from tacgen.bundle import bundle, dataset
from tacgen.bundle.hdf5_file import Damaged
from tacgen.recipe.row import Row
from tacgen.sensor.yaml_source import format_path, leaves

MAX_SHOWN_INPUTS = 3  # differing inputs that a message names


@dataclass(frozen=True)
class SceneResult:
    """The outcome of a scene. `seconds` by stage is empty if the bundle existed before; `bundles` are those that are
    there, opened, unless its maker does not say."""

    name: str
    path: Path
    status: str  # ok, rejected (a frame did not converge), failed (there is no bundle)
    reason: str
    frames: int
    seconds: dict[str, float] = field(default_factory=dict)
    bundles: tuple[bundle.Bundle, ...] = field(default=(), repr=False, compare=False)


@contextmanager
def claimed(row: Row, folder: Path, *, overwrite: bool = False) -> Iterator[SceneResult | Path]:
    """A scene's result, if its bundles exist, are complete and have the same inputs; else the path where the first of
    them is to be made, while no other process may make them.

    With `overwrite`, those that another version of tacgen wrote are made again, and those of other inputs are replaced.

    Raises:
        UserError: the bundle's name is taken by a file made from other inputs.
        atomic_file.Busy: another process is making this bundle.
    """
    paths = [folder / f"{each.name}.h5" for each in row.bundles]
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as claims:
        for path in paths:
            claims.enter_context(atomic_file.claim(path))
        found = [bundle.complete(path, each.key) for path, each in zip(paths, row.bundles, strict=True)]
        if overwrite:
            found = [one if one and one.attrs["tacgen_version"] == __version__ else None for one in found]
        kept = tuple(one for one in found if one)
        if len(kept) == len(paths):
            attrs, frames = kept[0].attrs, kept[0].frames
            yield SceneResult(row.name, paths[0], attrs["status"], attrs["reason"], frames, bundles=kept)
            return
        for path, each, one in zip(paths, row.bundles, found, strict=True):
            if path.exists() and not (one or overwrite):
                _refuse(path, each)
        yield paths[0]


def existing(rows: Iterable[Row], folder: Path) -> dict[str, str]:
    """The version of tacgen that wrote each existing bundle of these scenes, by its name. Reads attributes only.

    Raises:
        UserError: the folder is packed, or a bundle made from other inputs has a scene's name.
    """
    if dataset.is_packed(folder):
        raise UserError(f"{folder}: holds packed scenes; choose another folder")
    versions: dict[str, str] = {}
    if not any(folder.glob("*.h5")):
        return versions
    for row in (each for scene in rows for each in scene.bundles):
        path = folder / f"{row.name}.h5"
        if path.exists():
            try:
                attrs = bundle.read(path).attrs
            except (bundle.Unfinished, Damaged):
                continue
            except UserError:
                _refuse(path, row)
                continue
            if attrs["input_key"] != row.key:
                _refuse(path, row)
            versions[row.name] = attrs["tacgen_version"]
    return versions


def _refuse(path: Path, row: Row) -> None:
    """UserError if the file is a complete bundle; an unfinished or damaged one may be replaced."""
    try:
        other = bundle.read(path)
        other.verify()
    except (bundle.Unfinished, Damaged):
        return
    except UserError as error:
        raise UserError([*error.lines[:-1], f"{error.lines[-1]}; pass --overwrite to replace it"]) from None
    raise UserError(f"{path}: made from other inputs ({differences(other, row)}); --overwrite replaces it")


def differences(made: bundle.Bundle, row: Row) -> str:
    """The first inputs in which a bundle differs from a scene, as `contact.friction: 0.65 -> 0.62`."""
    sensor = json.loads(made.attrs.get("sensor_document", "{}"))
    before = {**made.recipe, "sensor file": sensor, "seed": made.attrs["seed"], "scene": made.attrs["scene_index"]}
    now = {**row.document(), "sensor file": row.sensor_document(), "seed": row.seed, "scene": row.index}
    old, new = ({format_path(path): value for path, value in leaves(inputs)} for inputs in (before, now))
    changed = [path for path in dict.fromkeys([*new, *old]) if old.get(path) != new.get(path)]
    said = [f"{path}: {_short(old.get(path))} -> {_short(new.get(path))}" for path in changed[:MAX_SHOWN_INPUTS]]
    more = f" and {len(changed) - MAX_SHOWN_INPUTS} more" if len(changed) > MAX_SHOWN_INPUTS else ""
    return (", ".join(said) or "another version of their keys") + more


def _short(value: Any) -> str:
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)[:40]
