"""Finding the finished scenes of a bundle, a folder of bundles or a packed folder.

A packed folder holds shards, which are HDF5 files with a bundle in each group, and their index, index.json:

    {"tacgen_pack": 1, "name": ..., "shards": [{"file", "bytes"}, ...],
     "scenes": [{"scene", "shard", "frames", "digest", "values"}, ...]}
"""

import os
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import NonNegativeInt

from tacgen.base.errors import LeftOut, UserError
from tacgen.bundle.bundle import Bundle, read
from tacgen.bundle.journal import read_plan
from tacgen.bundle.stored_json import Name, Stored, Value
from tacgen.bundle.stored_json import read as read_json

INDEX_FILE = "index.json"
PACK_FORMAT = 1
VIRTUAL_FRAMES_FILE = "frames.h5"  # all frames of a packed folder as virtual datasets
SHARD_FILE = "shard-{:05d}.h5"
CARD_FILES = ("README.md", "DATASET_CARD.md")  # of a data set; the second one if the first is somebody's


class Shard(Stored):
    """A file of a packed folder."""

    file: Name
    bytes: NonNegativeInt


class PackedScene(Stored):
    """A scene in a shard."""

    scene: Name
    shard: NonNegativeInt
    frames: NonNegativeInt
    digest: str
    values: dict[str, Value]


class Index(Stored):
    """The contents of index.json."""

    tacgen_pack: int
    name: str
    shards: list[Shard]
    scenes: list[PackedScene]


class _Format(Stored):
    tacgen_pack: int


def scenes(source: Path, *, merge: bool = False) -> list[Bundle]:
    """All scenes of a data set in order, including rejected ones.

    A data set is a bundle, a packed folder, or a folder of bundles. Where a folder holds the plan of a run, its scenes
    are those of the plan, made from the plan's inputs; other bundles there are left out with a LeftOut warning. Packed
    folders below a folder of bundles are not included.

    Args:
        merge: a folder may hold several data sets in folders of their own, which are taken as one.

    Raises:
        UserError: there is none, or several; a file is damaged, not a bundle, or of a newer format; a shard is missing.
    """
    try:
        os.stat(source)
    except FileNotFoundError:
        raise UserError(f"{source}: no such file or folder") from None
    except OSError as error:
        _refuse(error)
    if source.name == INDEX_FILE:
        source = source.parent
    if not source.is_dir():
        return [read(source)]
    if is_packed(source):
        return [read(path, group) for path, group in packed(source)]
    bundles, others = _planned(source, merge)
    if others:
        left = some([path.name for path in others])
        warnings.warn(f"{others[0].parent}: left out {left}: not of the plan there", LeftOut, stacklevel=2)
    if not bundles:
        hint = f"; packed scenes are in {inside[0]}" if (inside := packs(source)) else ""
        raise UserError(f"{source}: no bundles (*.h5) in this folder{hint}")
    return bundles


def _planned(source: Path, merge: bool) -> tuple[list[Bundle], list[Path]]:
    """The bundles of the plans in and below a folder, all bundles where there is no plan, and the files left out."""
    bundles: list[Bundle] = []
    others: list[Path] = []
    paths = files(source)
    folders = {folder: planned_keys(folder) for folder in dict.fromkeys(path.parent for path in paths)}
    if len(folders) > 1 and not merge:
        names = some([*map(str, folders)])
        raise UserError(f"{source}: holds {len(folders)} data sets: {names}: name one of them, or merge them (--merge)")
    for path in paths:
        keys = folders[path.parent]
        if keys.names(path) and keys.hold(bundle := read(path)):
            bundles.append(bundle)
        else:
            others.append(path)
    return bundles, others


@dataclass(frozen=True)
class PlannedKeys:
    """Input key of each bundle by its name, from the plan in a folder; without a plan every bundle belongs there."""

    by_name: dict[str, str] | None

    def names(self, path: Path) -> bool:
        """Whether the plan names a file."""
        return self.by_name is None or path.stem in self.by_name

    def hold(self, bundle: Bundle) -> bool:
        """Whether a bundle was made from the inputs of the plan."""
        return self.by_name is None or self.by_name.get(bundle.path.stem) == bundle.attrs["input_key"]


def planned_keys(folder: Path) -> PlannedKeys:
    """The keys in the plan of a folder. Raises UserError: it is damaged."""
    plan = read_plan(folder)
    return PlannedKeys(None if plan is None else {row.scene: row.key for row in plan.scenes})


def unplanned(folder: Path) -> list[Path]:
    """Bundles in a folder of a run that its plan does not name, by their names alone."""
    keys = planned_keys(folder)
    return [path for path in files(folder) if path.parent == folder and not keys.names(path)]


def some(names: Sequence[str]) -> str:
    """The first of many names, for a message."""
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def contacts(bundles: Sequence[Bundle]) -> list[list[int]]:
    """Groups of indices of bundles that belong together: the same contact on different sensors, or the two fingers of a
    grasp. Any other bundle is alone."""
    groups: dict[object, list[int]] = {}
    for place, bundle in enumerate(bundles):
        number = bundle.attrs.get("scene_index" if "finger" in bundle.attrs else "pair")
        key = place if number is None else (bundle.path.parent, bundle.recipe.get("name"), number)
        groups.setdefault(key, []).append(place)
    return list(groups.values())


def role(bundle: Bundle) -> str:
    """The name of a bundle among those of its contact: `left` or `right` of a grasp, otherwise the sensor's."""
    return str(bundle.attrs.get("finger", bundle.attrs["sensor"]))


def files(folder: Path) -> list[Path]:
    """Bundles in and below a folder, in the order of their scenes, without part files."""
    paths = [path for place, names in _folders(folder) for name in names if (path := place / name).suffix == ".h5"]
    return sorted(paths, key=lambda path: (path.parent, len(path.name), path.name))


def packs(folder: Path) -> list[Path]:
    """Packed folders below a folder."""
    inside = (Path(place, name) for place, inner, _ in os.walk(folder) for name in inner if not name.startswith("."))
    return sorted(path for path in inside if _is_pack(path))


def _folders(folder: Path) -> Iterator[tuple[Path, list[str]]]:
    """Each folder from `folder` down with its files, without hidden and packed folders."""
    for place, inner, names in os.walk(folder, onerror=_refuse):
        inner[:] = [name for name in inner if not name.startswith(".") and not _is_pack(Path(place, name))]
        yield Path(place), names


def _refuse(error: OSError) -> None:
    """Raise UserError: a folder that cannot be read must not count as empty."""
    raise UserError(f"{error.filename}: cannot be read: {error.strerror}") from None


def is_packed(folder: Path) -> bool:
    """Whether a folder holds shards and their index."""
    return os.path.exists(folder / INDEX_FILE)  # False without permission


def _is_pack(folder: Path) -> bool:
    """Whether a folder that the user did not name is packed: its index.json may belong to another program."""
    return is_packed(folder) and os.path.exists(folder / SHARD_FILE.format(0))


def packed(folder: Path) -> list[tuple[Path, str]]:
    """The file and group of every scene of a packed folder.

    Raises:
        UserError: shards that are missing or have another size, or an index that cannot be read.
    """
    index = read_index(folder)
    problems = []
    for shard in index.shards:
        path = folder / shard.file
        if not path.is_file():
            problems.append(f"{path}: missing, though {INDEX_FILE} names it")
        elif path.stat().st_size != shard.bytes:
            problems.append(f"{path}: damaged: {path.stat().st_size} bytes long, expected {shard.bytes}")
    if problems:
        raise UserError(problems)
    return [(folder / index.shards[scene.shard].file, f"/{scene.scene}") for scene in index.scenes]


def read_index(folder: Path) -> Index:
    """The contents of index.json. Raises UserError: unreadable, of another program, or of a newer format."""
    path = folder / INDEX_FILE
    number = read_json(_Format, path).tacgen_pack
    if number > PACK_FORMAT:
        raise UserError(f"{path}: pack format {number}; this tacgen reads up to {PACK_FORMAT}: upgrade it")
    index = read_json(Index, path)
    for name, count in Counter(scene.scene for scene in index.scenes).items():
        if count > 1:
            raise UserError(f"{path}: damaged: {name} is listed {count} times")
    for scene in index.scenes:
        if scene.shard >= len(index.shards):
            raise UserError(f"{path}: damaged: {scene.scene} is in a shard that is not listed")
    return index
