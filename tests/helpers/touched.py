"""Two recorded episodes of 20 rows, as a LeRobot data set and an HDF5 file made by hand, and what two fingers feel."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from tacgen.touch.episode import BodySurface, EpisodeLog, Thing, Touch
from tacgen.touch.label_columns import by_episode

ROWS, FPS, MARKERS = 20, 10.0, 4
IMAGE = (24, 32, 3)  # of the tactile sensor
CUBE = {"shape": "box", "size_x_mm": 10.0, "size_y_mm": 8.0}


@dataclass
class RecordedEpisodes:
    """A source that holds its episodes."""

    path: Path
    kind: str = "lerobot"
    fps: float = FPS
    things: Mapping[str, Thing] = field(default_factory=dict)
    held: tuple[EpisodeLog, ...] = ()

    def __len__(self) -> int:
        return len(self.held)


def recorded(path: Path, kind: str = "lerobot", name: str = "demo_{}") -> RecordedEpisodes:
    """Two episodes of a cube that two bodies of a gripper come to."""
    held = []
    for index in range(2):
        poses = np.tile(np.eye(4), (ROWS, 1, 1))
        poses[:, 2, 3] = 100 + np.arange(ROWS)
        beside = {f"finger_{side}": poses + np.eye(4)[3] * 0 for side in ("left", "right")}
        held.append(EpisodeLog(index, name.format(index), np.arange(ROWS) / FPS, {"cube": poses, **beside}))
    things = {"cube": Thing("cube", BodySurface(CUBE, np.eye(4)), 0.05)}
    return RecordedEpisodes(path, kind, FPS, things, tuple(held))


def felt(index: int, finger: str, rows: int = ROWS) -> Touch:
    """What a finger feels in an episode: nothing, then the cube, from the sixth row to the fifteenth."""
    draw = np.random.default_rng([index, len(finger)])
    on = (np.arange(rows) >= 5) & (np.arange(rows) < 15)
    images = draw.integers(0, 256, (rows, *IMAGE)).astype(np.uint8)
    images[~on] = 7
    return Touch(
        finger=finger,
        touched=["cube" if each else "" for each in on],
        force=draw.normal(size=(rows, 3)) * on[:, None],
        torque=draw.normal(size=(rows, 3)) * on[:, None],
        markers=draw.uniform(0, 30, (rows, MARKERS, 2)),
        error=np.where(on, draw.uniform(0, 0.05, rows), np.nan),
        correction=draw.normal(size=rows) * on,
        engine=np.where(on, draw.uniform(1, 2, rows), np.nan),
        moved=on & (draw.uniform(size=rows) < 0.5),
        lifted=on & (np.arange(rows) > 8),
        note=["two objects touch at once" if k == 7 else "" for k in range(rows)],
        image=lambda row: images[row],
    )


def both(count: int = 2) -> list[list[Touch]]:
    return [[felt(index, finger) for finger in ("left", "right")] for index in range(count)]


def written(
    by: ModuleType, source: RecordedEpisodes, touches: Sequence[Sequence[Touch]], out: Path, overwrite: bool = False
) -> list[Path]:
    """The files that a module writes of the touch of the source's first episodes."""
    return by.write(source, by_episode(source.held[: len(touches)], touches), out, overwrite=overwrite)


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def lerobot_folder(folder: Path, together: bool = True) -> Path:
    """A LeRobot data set by hand: state, action and a camera's pictures; its episodes in one file, or in two."""
    import pyarrow as pa
    from pyarrow import parquet

    from tacgen.bundle.image_file import encoded

    vector = {"dtype": "float32", "shape": [3], "names": ["x", "y", "z"]}
    picture = {"dtype": "image", "shape": [8, 8, 3], "names": ["height", "width", "channels"]}
    features: dict[str, Any] = {"observation.state": vector, "action": vector, "observation.images.front": picture}
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    for name in ("frame_index", "episode_index", "index", "task_index"):
        features[name] = {"dtype": "int64", "shape": [1], "names": None}
    tables, rows = [], []
    for index in range(2):
        draw = np.random.default_rng(index)
        pictures = (draw.integers(0, 256, (8, 8, 3)).astype(np.uint8) for _ in range(ROWS))
        png = [{"bytes": encoded(each, "PNG"), "path": None} for each in pictures]
        columns = {
            name: pa.FixedSizeListArray.from_arrays(pa.array(draw.normal(size=3 * ROWS).astype(np.float32)), 3)
            for name in ("observation.state", "action")
        } | {
            "observation.images.front": pa.array(png, pa.struct([("bytes", pa.binary()), ("path", pa.string())])),
            "timestamp": pa.array((np.arange(ROWS) / FPS).astype(np.float32)),
            "frame_index": pa.array(np.arange(ROWS)), "episode_index": pa.array(np.full(ROWS, index)),
            "index": pa.array(np.arange(ROWS) + index * ROWS), "task_index": pa.array(np.full(ROWS, index)),
        }  # fmt: skip
        tables.append(pa.table(columns))
        rows.append({
            "episode_index": index, "tasks": [f"task {index}"], "length": ROWS, "data/chunk_index": 0,
            "data/file_index": 0 if together else index, "dataset_from_index": index * ROWS,
            "dataset_to_index": (index + 1) * ROWS, "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
            "stats/action/mean": [0.0, 0.0, 0.0],
        })  # fmt: skip
    for place in ("data/chunk-000", "meta/episodes/chunk-000", "videos/observation.images.top/chunk-000"):
        (folder / place).mkdir(parents=True)
    for number, table in enumerate([pa.concat_tables(tables)] if together else tables):
        parquet.write_table(table, folder / f"data/chunk-000/file-{number:03d}.parquet")
    parquet.write_table(pa.Table.from_pylist(rows), folder / "meta/episodes/chunk-000/file-000.parquet")
    about = {"index_columns": ["task"], "column_indexes": [], "pandas_version": "2.2.0", "columns": [
        {"name": n, "field_name": n, "pandas_type": p, "numpy_type": q, "metadata": None}
        for n, p, q in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]}  # fmt: skip
    tasks = pa.Table.from_pylist([{"task_index": i, "task": f"task {i}"} for i in range(2)])
    parquet.write_table(tasks.replace_schema_metadata({"pandas": json.dumps(about)}), folder / "meta/tasks.parquet")
    info = {
        "codebase_version": "v3.0", "robot_type": "gripper", "total_episodes": 2, "total_frames": 2 * ROWS,
        "total_tasks": 2, "chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 200,
        "fps": int(FPS), "splits": {"train": "0:1", "test": "1:2"}, "video_path": None, "features": features,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    }  # fmt: skip
    stats = {"action": {k: [0.0] * 3 for k in ("min", "max", "mean")} | {"std": [1.0] * 3, "count": [2 * ROWS]}}
    (folder / "meta/info.json").write_text(json.dumps(info, indent=4))
    (folder / "meta/stats.json").write_text(json.dumps(stats, indent=4))
    (folder / "README.md").write_text("The card.\n")
    (folder / "videos/observation.images.top/chunk-000/file-000.mp4").write_bytes(bytes(range(256)) * 9)
    return folder


def demonstrations(path: Path) -> Path:
    """robomimic's HDF5 by hand, with attributes, a mask and `next_obs` in the first demonstration."""
    import h5py

    with h5py.File(path, "w") as file:
        file.create_group("data").attrs["env_args"] = '{"env_name": "Lift"}'
        for index in range(2):
            group = file.create_group(f"data/demo_{index}")
            group.attrs["num_samples"] = ROWS
            group.attrs["model_file"] = "<mujoco/>"
            group["actions"] = np.random.default_rng(index).normal(size=(ROWS, 7))
            for name in ("obs", "next_obs")[: 2 - index]:
                group[f"{name}/robot0_eef_pos"] = np.arange(3.0 * ROWS).reshape(ROWS, 3)
        file["mask/train"] = np.array([b"demo_0"])
    return path
