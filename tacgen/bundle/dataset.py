"""The finished scenes of a bundle, of a folder of bundles, or of a packed folder: whoever reads datasets starts here.

A packed folder holds shards, HDF5 files with a bundle in each group, and index.json, which says what is in them:

    {"tacgen_pack": 1, "name": ..., "shards": [{"file", "bytes"}, ...],
     "scenes": [{"scene", "shard", "frames", "digest", "values"}, ...]}
"""

import json
from pathlib import Path
from typing import Any

from tacgen import atomic_file
from tacgen.bundle.bundle import Bundle, read
from tacgen.errors import UserError

INDEX = "index.json"
PACK_FORMAT = 1
VIRTUAL = "frames.h5"  # every frame of a packed folder as one dataset


def scenes(source: Path) -> list[Bundle]:
    """All of them in order, rejected ones too.

    Raises:
        UserError: there is none, a file is damaged, foreign or of a newer format, or a shard is missing.
    """
    if not source.exists():
        raise UserError(f"{source}: no such file or folder")
    if source.name == INDEX:
        source = source.parent
    if not source.is_dir():
        return [read(source)]
    if is_packed(source):
        return [read(path, group) for path, group in packed(source)]
    found = [read(path) for path in files(source)]
    if not found:
        raise UserError(f"{source}: no bundles (*.h5) in this folder")
    return found


def files(folder: Path) -> list[Path]:
    """Bundles in a folder and below, in the order of their scenes; what a writer left unfinished is passed over."""
    found = [path for path in folder.rglob("*.h5") if not atomic_file.is_part(path)]
    return sorted(found, key=lambda path: (path.parent, len(path.name), path.name))


def is_packed(folder: Path) -> bool:
    """Whether a folder holds shards and their index."""
    return (folder / INDEX).exists()


def packed(folder: Path) -> list[tuple[Path, str]]:
    """The file and group of every scene of a packed folder.

    Raises:
        UserError: every shard that is missing or not as long as it was, or an index that cannot be read.
    """
    index = read_index(folder)
    problems = []
    for shard in index["shards"]:
        path = folder / shard["file"]
        if not path.is_file():
            problems.append(f"{path}: missing, though {INDEX} names it")
        elif path.stat().st_size != shard["bytes"]:
            problems.append(f"{path}: damaged: {path.stat().st_size} bytes long, and was {shard['bytes']}")
    if problems:
        raise UserError(problems)
    return [(folder / index["shards"][scene["shard"]]["file"], f"/{scene['scene']}") for scene in index["scenes"]]


def read_index(folder: Path) -> dict[str, Any]:
    """What index.json says. Raises UserError: unreadable, foreign or of a newer format."""
    path = folder / INDEX
    try:
        index = json.loads(path.read_text(encoding="utf-8"))
        number = index["tacgen_pack"]
    except (OSError, ValueError, KeyError, TypeError):
        raise UserError(f"{path}: no index of packed scenes, or damaged") from None
    if not isinstance(number, int) or number > PACK_FORMAT:
        raise UserError(f"{path}: pack format {number}; this tacgen reads up to {PACK_FORMAT}: upgrade it")
    found: dict[str, Any] = index
    return found
