"""Packing of many bundles into few files: shards of a chosen size, an index, and virtual datasets of all frames."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacgen.base import atomic_file
from tacgen.base.errors import UserError
from tacgen.base.version import __version__
from tacgen.bundle import dataset, whole_folder
from tacgen.bundle.bundle import Bundle, read
from tacgen.bundle.hdf5_file import opened, written_file

# scenes copied before a shard is closed and opened again: HDF5 holds 20 to 50 kB a scene until then
SCENES_PER_SHARD_OPENING = 100


@dataclass(frozen=True)
class Packed:
    """The files and counts of a packed folder."""

    folder: Path
    shards: tuple[Path, ...]
    scenes: int
    frames: int
    left_out: tuple[str, ...]  # names of rejected scenes


def pack(bundles: Sequence[Bundle], out: Path, size_mb: float = 1024.0) -> Packed:
    """Copy finished scenes, with their compressed bytes, into shards of about `size_mb`.

    Every scene is verified in its shard before the folder gets its name.

    Raises:
        UserError: a scene is damaged, two have the same name, none is finished, or `out` is not empty.
        OSError: `out` cannot be written.
    """
    good = [bundle for bundle in bundles if bundle.attrs["status"] == "ok"]
    if not good:
        raise UserError(f"{bundles[0].path.parent if bundles else out}: no finished scene to pack")
    names = _names(good)
    with whole_folder.written(out) as folder:
        shards: list[dict[str, Any]] = []
        scenes: list[dict[str, Any]] = []
        for number, part in enumerate(_parts(good, size_mb * 1e6)):
            path = folder / dataset.SHARD_FILE.format(number)
            _write(path, [(names[i], good[i]) for i in part])
            for i in part:
                kept = read(path, f"/{names[i]}")
                kept.verify()
                entry = {"scene": names[i], "shard": number, "frames": kept.frames, "digest": kept.attrs["digest"]}
                scenes.append({**entry, "values": json.loads(kept.attrs.get("values", "{}"))})
            shards.append({"file": path.name, "bytes": path.stat().st_size})
        index = {"tacgen_pack": dataset.PACK_FORMAT, "tacgen_version": __version__}
        index |= {"name": good[0].recipe.get("name", ""), "shards": shards, "scenes": scenes}
        atomic_file.write(folder / dataset.INDEX_FILE, (json.dumps(index, indent=1) + "\n").encode())
        join(folder)
    left_out = tuple(bundle.path.stem for bundle in bundles if bundle.attrs["status"] != "ok")
    frames = sum(scene["frames"] for scene in scenes)
    return Packed(out, tuple(out / shard["file"] for shard in shards), len(scenes), frames, left_out)


def join(folder: Path) -> Path:
    """Write `frames.h5`: virtual datasets that concatenate the frames of all scenes, where their shapes are equal.

    HDF5 reads zeros where a shard is missing, so all shards are checked first. Readers should do so too, with
    `dataset.packed`. /scene and /frame give the origin of each row; /scenes holds the names.

    Raises:
        UserError: a shard is missing or damaged.
    """
    import h5py
    import numpy as np

    bundles = dataset.scenes(folder)
    counts = [bundle.frames for bundle in bundles]
    target = folder / dataset.VIRTUAL_FRAMES_FILE
    with atomic_file.published(target) as sink:
        with written_file(sink, libver=("v110", "v110")) as file:
            file.attrs["tacgen_pack"] = dataset.PACK_FORMAT
            file["scenes"] = [bundle.group[1:] for bundle in bundles]
            file["scene"] = np.repeat(np.arange(len(counts)), counts)
            file["frame"] = np.concatenate([np.arange(n) for n in counts])
        for path, (shape, dtype) in _common(bundles).items():
            layout = h5py.VirtualLayout((sum(counts), *shape), dtype)
            start = 0
            for bundle, n in zip(bundles, counts, strict=True):
                name, inside = bundle.path.name, f"{bundle.group}{path}"
                layout[start : start + n] = h5py.VirtualSource(name, inside, (n, *shape), dtype)
                start += n
            # reopened for each: HDF5 holds 4 kB per source until the file is closed
            with written_file(sink, "r+", libver=("v110", "v110")) as file:
                file.create_virtual_dataset(path, layout)
    return target


def _common(bundles: Sequence[Bundle]) -> dict[str, tuple[tuple[int, ...], str]]:
    """Per-frame datasets that all scenes have with the same shape of a frame: that shape and the type."""
    from tacgen.bundle.schema import entry

    first, *others = [{p: n[1:] for p, n in b.shapes.items() if entry(p).per_frame} for b in bundles]
    alike = {path: shape for path, shape in first.items() if all(other.get(path) == shape for other in others)}
    return {path: (shape, entry(path).dtype) for path, shape in alike.items()}


def _names(bundles: Sequence[Bundle]) -> list[str]:
    """The name of each scene in its shard."""
    names = [bundle.group[1:] or bundle.path.stem for bundle in bundles]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        paths = [str(b.path) for b, name in zip(bundles, names, strict=True) if name == twice]
        raise UserError(f"{paths[0]} and {paths[1]} have the same name: pack one dataset at a time")
    return names


def _parts(bundles: Sequence[Bundle], size: float) -> list[list[int]]:
    """Indices of the scenes of each shard: consecutive scenes of `size` bytes in total at most."""
    parts: list[list[int]] = [[]]
    total = 0
    for i, bundle in enumerate(bundles):
        with opened(bundle.path, bundle.group) as group:
            own = sum(int(group[path[1:]].id.get_storage_size()) for path in bundle.shapes)
        if parts[-1] and total + own > size:
            parts.append([])
            total = 0
        parts[-1].append(i)
        total += own
    return parts


def _write(path: Path, scenes: Sequence[tuple[str, Bundle]]) -> None:
    with atomic_file.published(path) as sink:
        for first in range(0, len(scenes), SCENES_PER_SHARD_OPENING):
            with written_file(sink, "r+" if first else "w", libver=("v110", "v110")) as file:
                file.attrs["tacgen_pack"] = dataset.PACK_FORMAT
                for name, bundle in scenes[first : first + SCENES_PER_SHARD_OPENING]:
                    with opened(bundle.path, bundle.group) as original:
                        file.copy(original, file, name)
