"""Touch into a copy of an HDF5 file of demonstrations, as robomimic, LIBERO and ManiSkill keep them.

Each demonstration's group `obs` gets for each finger, with the prefix `tactile_<finger>_`:

    image                   (n, h, w, 3) the sensor's picture
    force, wrench           (n, 3) [N], and (n, 6) with the torque about the sensor's origin [N mm]
    markers                 (n, 2 m) x and y in turn [px]
    expected_error          (n, 1) of the force, over the force [-]
    correction              (n, 1) by which matching moved the object along the sensor's z [mm]
    engine_force            (n, 1) normal force that was asked for, or that the engine reported [N]
    contact, slip, lifted   (n, 1) booleans
    object, note            (n,) texts

Where there is a group `next_obs`, it gets the same a row later, the last row twice. All else is as it was.
"""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.bundle.hdf5_file import item_at, open_file, text_type, written_file
from tacgen.touch.episode import Array, EpisodeLog, Touch
from tacgen.touch.label_columns import Felt, columns
from tacgen.touch.recording import Recording

GZIP_LEVEL = 4  # of the pictures, as a middle between size and time


def write(source: Recording, felt: Felt, out: Path, *, overwrite: bool) -> list[Path]:
    """Write the copy `out`, which appears when it is complete; demonstrations that are not among `felt` get none.

    Raises:
        UserError: not such a file, touch is in it, its rows are not those of the episodes, or `out` is in the way.
    """
    open_file(source.path).close()  # it is HDF5, and an input from here on
    with output_file.written(out, [source.path], overwrite=overwrite) as new:
        shutil.copyfile(source.path, new)
        try:
            with written_file(new, "r+") as file:
                for index in sorted(felt):
                    _add(source.path, file, *felt[index])
        except (OSError, RuntimeError) as error:  # HDF5 says in many ways that the disk is full
            raise UserError(f"{out}: cannot be written: {str(error).partition(chr(10))[0]}") from error
    return [out]


def _add(path: Path, file: Any, episode: EpisodeLog, fingers: Sequence[Touch]) -> None:
    """Touch of all fingers into a demonstration."""
    demonstration = _group(path, file, episode)
    for name, later in (("obs", 0), ("next_obs", 1)):
        if name not in demonstration:
            if later:
                continue
            demonstration.create_group(name)
        group = item_at(demonstration, name)
        for key in group:
            if getattr(group.get(key), "shape", None) and (count := len(group[key])) != len(episode):
                raise UserError(f"{path}: {episode.name}: {name}/{key} has {count} rows, touch has {len(episode)}")
        rows = np.minimum(np.arange(len(episode)) + later, len(episode) - 1)
        for touch in fingers:
            _put(path, group, touch, rows)


def _group(path: Path, file: Any, episode: EpisodeLog) -> Any:
    """The group of a demonstration: below `data` as in robomimic and LIBERO, or alone as in ManiSkill."""
    for place in (f"data/{episode.name}", episode.name):
        try:
            return item_at(file, place)
        except (KeyError, ValueError):
            continue
    raise UserError(f"{path}: has no demonstration {episode.name}")


def _put(path: Path, group: Any, touch: Touch, rows: Array) -> None:
    prefix = f"tactile_{touch.finger}_"
    if f"{prefix}image" in group:
        raise UserError(f"{path}: has {group.name}/{prefix}image already")
    shape = touch.image(0).shape
    images = group.create_dataset(
        f"{prefix}image", (len(rows), *shape), np.uint8, chunks=(1, *shape), compression="gzip", shuffle=True,
        compression_opts=GZIP_LEVEL,
    )  # fmt: skip
    for k, row in enumerate(rows.tolist()):
        images[k] = touch.image(row)
    for name, values in columns(touch).items():
        group.create_dataset(prefix + name, data=values[rows])
    for name, texts in (("object", touch.touched), ("note", touch.note)):
        encoded = np.array([text.encode() for text in texts], object)
        group.create_dataset(prefix + name, data=encoded[rows], dtype=text_type())
