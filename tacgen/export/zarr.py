"""Zarr: a replay buffer of diffusion policies, format 2 of Zarr, as read by ReplayBuffer.

    https://github.com/real-stanford/diffusion_policy (diffusion_policy/common/replay_buffer.py)

`replay_buffer.zarr/data/<key>` (T, ...) holds the frames of all episodes one after the other: `img` (H, W, 3),
`state`, the indenter's pose (x y z [mm], quaternion w x y z), `action`, the pose of the next frame, and every other
dataset of a frame that all scenes have in one size, except quality, by its name: `force`, `pressure`, `events_mode`,
... with `units` among its attributes. `meta/episode_ends` (episodes,) is where each ends, `meta/episode_split` its
split: 0 train, 1 val, 2 test, in this order; `splits.json` names their scenes.

A contact on several sensors, or of the two fingers of a grasp, is one episode: `img_left`, `force_right`, ..., and
`state` and `action` hold the poses on all of them.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.bundle.bundle import Bundle
from tacgen.bundle.schema import entry
from tacgen.bundle.splits import SPLITS
from tacgen.export import needs_package
from tacgen.export.episodes import SINGLE_SENSOR, Episode, common, episodes, state_and_action, write_splits

ZARR_FOLDER = "replay_buffer.zarr"
CHUNK_BYTES = 2_000_000  # as ReplayBuffer chooses
UNSTORED_PATHS = ("/frames/quality/", "/frames/pose")  # not keys: the pose is in `state`
ZSTD_LEVEL = 5  # of Zstandard


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """Write the buffer, episode by episode. Raises UserError: Zarr is missing."""
    zarr = needs_package("zarr", "Zarr")
    every = episodes(bundles)
    ends = np.cumsum([episode.frames for episode in every])
    root = zarr.open_group(out / ZARR_FOLDER, mode="w", zarr_format=2)
    meta, data = root.create_group("meta"), root.create_group("data")
    _array(meta, "episode_ends", ends.shape, "int64")[:] = ends
    _array(meta, "episode_split", ends.shape, "int64")[:] = [SPLITS.index(episode.split) for episode in every]
    kept = {
        role: common([episode.scenes[role] for episode in every], lambda path: not path.startswith(UNSTORED_PATHS))
        for role in every[0].scenes
    }
    arrays: dict[str, Any] = {}
    for episode, end in zip(every, ends, strict=True):
        for key, (values, units) in _values(episode, kept).items():
            if key not in arrays:
                arrays[key] = _array(data, key, (int(ends[-1]), *values.shape[1:]), values.dtype)
                arrays[key].attrs["units"] = units
            arrays[key][end - episode.frames : end] = values
    return [write_splits(every, out), *sorted(path for path in (out / ZARR_FOLDER).rglob("*") if path.is_file())]


def _values(episode: Episode, kept: dict[str, dict[str, Any]]) -> dict[str, tuple[np.ndarray, str]]:
    """Key -> values over the frames of an episode, and their units."""
    n = episode.frames
    both = zip(*(state_and_action(bundle, n) for bundle in episode.scenes.values()), strict=True)
    out = {key: (np.hstack(parts), "mm, 1") for key, parts in zip(("state", "action"), both, strict=True)}
    for role, bundle in episode.scenes.items():
        for path in kept[role]:
            name = "img" if path == "/frames/rgb" else path.removeprefix("/frames/").replace("/", "_")
            key = name if role == SINGLE_SENSOR else f"{name}_{role}"
            out[key] = bundle[path][:n], entry(path).units
    return out


def _array(group: Any, name: str, shape: tuple[int, ...], dtype: Any) -> Any:
    """An array in chunks of whole frames of about CHUNK_BYTES."""
    import numcodecs

    frame = int(np.prod(shape[1:])) * np.dtype(dtype).itemsize
    chunks = (max(1, min(shape[0], -(-CHUNK_BYTES // frame))), *shape[1:])
    return group.create_array(
        name, shape=shape, dtype=dtype, chunks=chunks, compressors=numcodecs.Zstd(level=ZSTD_LEVEL), fill_value=0
    )
