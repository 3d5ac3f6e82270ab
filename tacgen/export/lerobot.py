"""LeRobot, dataset format v3.0: Parquet tables of frames with embedded images, one episode per scene.

    https://github.com/huggingface/lerobot (src/lerobot/datasets)

`observation.images.tactile` is the camera's image, `observation.state` the indenter's pose (x y z [mm], quaternion w
x y z) and `action` the pose of the next frame. If the scenes have them: `observation.force` [N], `.torque` [N mm],
`.markers` and `.marker_flow` [px] (x and y in turn), `.contact_mode` (a number, see tacgen.outputs.events),
`.contact`, and `observation.images.tactile_depth`, the indentation in 16 bits [um]. Beside these, with the prefix
that LeRobot plans for touch, `observation.tactile.wrench` is force and torque together, and
`observation.tactile.force` the force in each of 12 x 16 cells of the image (16 x 12 if it is upright), row by row, x
y z in turn [N].

The task tells the movements, none of the labels, and is the same for all episodes of these movements. Episodes are in
the order of the splits of `meta/info.json`: train, val, test, the same ones as of tacgen.torch; `splits.json` names
their scenes, and a Parquet file holds frames of one split. Quasi-static scenes have no time; their frames get a
nominal rate of NOMINAL_FPS.

The same contact on several sensors is one episode: `observation.images.digit`, `observation.force.digit`,
`observation.tactile.digit.wrench` and so on, and state and action concatenate the poses on all of them. So are the
two fingers of a grasp: `observation.images.left`, `observation.force.right`.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base.errors import UserError
from tacgen.base.output_file import add
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.caption import EVENT_MODE_PATH
from tacgen.bundle.image_file import encoded
from tacgen.export import needs, needs_package
from tacgen.export.episodes import SINGLE_SENSOR, Episode, episodes, split_ranges, state_and_action, write_splits
from tacgen.export.feats import shares

NOMINAL_FPS = 10
PARQUET_FILE_BYTES = 100_000_000  # size of a Parquet file, as in LeRobot
FILES_PER_FOLDER = 1000  # files in a folder
TACTILE_PREFIX = "observation.tactile."  # LeRobot's prefix for touch; a sensor among several is named after it
IMAGE_KEY, DEPTH_KEY = f"observation.images.{SINGLE_SENSOR}", f"observation.images.{SINGLE_SENSOR}_depth"
POSE_COMPONENTS = [*(f"{axis}_mm" for axis in "xyz"), *(f"q{axis}" for axis in "wxyz")]
CONTACT_COMPONENTS = {  # datasets of /frames/events, and the names of their components
    "stick_ratio": ["stick_ratio"],
    "friction_used": ["friction_used"],
    "center_of_pressure": ["center_x_mm", "center_y_mm", "center_z_mm"],
    "contact_area": ["area_mm2"],
    "patches": ["patches"],
}
VECTOR_UNITS = {"force": "n", "torque": "n_mm", "markers": "px", "marker_flow": "px"}  # and their units
COUNTS_PER_MM = 1000  # of a depth image: 1 um per count
MAX_DEPTH_COUNTS = 2**15 - 1  # LeRobot's reader gives 16 bits with a sign: up to 32 mm
FORCE_CELLS = (12, 16)  # of the image, in which forces are summed
Each = dict[str, dict[str, Any]]  # features of each sensor of an episode
INDEX_COLUMNS = ("frame_index", "episode_index", "index", "task_index")
STATISTIC_QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
DATA_PATH, EPISODES_PATH = "data/chunk-{:03d}/file-{:03d}.parquet", "meta/episodes/chunk-000/file-000.parquet"


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """Write the dataset's folder, to be read with LeRobotDataset(name, root=out).

    Raises:
        UserError: PyArrow is missing, a scene has no images, or sizes or frame rates differ.
    """
    needs_package("lerobot", "PyArrow")
    for bundle in bundles:
        needs(bundle, ("/frames/rgb",), "rgb")
    all_episodes = episodes(bundles)
    each = {role: _features([episode.scenes[role] for episode in all_episodes]) for role in all_episodes[0].scenes}
    common = {"timestamp": _vector("float32", 1)} | {name: _vector("int64", 1) for name in INDEX_COLUMNS}
    features, rates = _together(each, _joined) | common, {_fps(bundle) for bundle in bundles}
    if len(rates) > 1:
        where = bundles[0].path.parent
        raise UserError(f"{where}: LeRobot needs one frame rate, these have {sorted(rates)} frames a second")
    tasks = list(dict.fromkeys(episode.task for episode in all_episodes))
    made, rows = _data(all_episodes, tasks, each, out)
    info = {
        "codebase_version": "v3.0",
        "robot_type": ", ".join(bundle.attrs["sensor"] for bundle in all_episodes[0].scenes.values()),
        "total_episodes": len(all_episodes),
        "total_frames": sum(episode.frames for episode in all_episodes),
        "total_tasks": len(tasks),
        "chunks_size": FILES_PER_FOLDER,
        "data_files_size_in_mb": PARQUET_FILE_BYTES // 10**6,
        "video_files_size_in_mb": 200,
        "fps": rates.pop(),
        "splits": {name: f"{start}:{end}" for name, (start, end) in split_ranges(all_episodes).items()},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }
    stats = statistics([columns(episode, each) for episode in all_episodes])
    made.append(write_splits(all_episodes, out))
    made += [_table(out / "meta/tasks.parquet", *_tasks(tasks)), _table(out / EPISODES_PATH, rows)]
    for name, content in (("info", info), ("stats", stats)):
        made.append(add(out / "meta" / f"{name}.json", json.dumps(content, indent=4) + "\n"))
    return made


def split_files(folder: Path) -> dict[str, list[str]]:
    """The Parquet files of each split of an export, as paths below its folder."""
    from pyarrow import parquet

    ranges = json.loads((folder / "meta" / "info.json").read_text(encoding="utf-8"))["splits"]
    rows = parquet.read_table(folder / EPISODES_PATH, columns=["data/chunk_index", "data/file_index"]).to_pylist()
    paths = [DATA_PATH.format(row["data/chunk_index"], row["data/file_index"]) for row in rows]
    ends = {name: map(int, at.split(":")) for name, at in ranges.items()}
    return {name: list(dict.fromkeys(paths[slice(*of)])) for name, of in ends.items()}


def columns(episode: Episode, features: Each) -> dict[str, np.ndarray]:
    """Values of each feature over the frames, without the indices; `features` are those of each sensor."""
    parts = {role: _columns(bundle, features[role], episode.frames) for role, bundle in episode.scenes.items()}
    return _together(parts, lambda values: np.hstack(list(values.values())))


def _columns(bundle: Bundle, features: dict[str, Any], frames: int) -> dict[str, np.ndarray]:
    """Values of each feature of one sensor over the frames, with the names of a single sensor."""
    state, action = state_and_action(bundle, frames)
    columns = {IMAGE_KEY: bundle["/frames/rgb"], "observation.state": state, "action": action}
    for name in VECTOR_UNITS:
        if f"observation.{name}" in features:
            columns[f"observation.{name}"] = bundle[f"/frames/{name}"].reshape(bundle.frames, -1)
    if f"{TACTILE_PREFIX}wrench" in features:
        columns[f"{TACTILE_PREFIX}wrench"] = np.hstack([bundle["/frames/force"], bundle["/frames/torque"]])
    if f"{TACTILE_PREFIX}force" in features:
        columns[f"{TACTILE_PREFIX}force"] = np.stack([_cell_forces(bundle, k).ravel() for k in range(frames)])
    if "observation.contact" in features:
        parts = [bundle[f"/frames/events/{name}"] for name in CONTACT_COMPONENTS]
        columns["observation.contact"] = np.column_stack(parts)
        columns["observation.contact_mode"] = bundle[EVENT_MODE_PATH][:, None]
    if DEPTH_KEY in features:
        depth = (bundle["/reference/height"] - bundle["/frames/height"]) * COUNTS_PER_MM
        columns[DEPTH_KEY] = np.clip(np.rint(np.nan_to_num(depth)), 0, MAX_DEPTH_COUNTS).astype(np.uint16)
    return {n: v[:frames] if v.ndim > 2 else v[:frames].astype(features[n]["dtype"]) for n, v in columns.items()}


def _cell_forces(bundle: Bundle, k: int) -> np.ndarray:
    """Force on the gel in each of FORCE_CELLS (12, 16, 3), or (16, 12, 3) of an upright image [N]."""
    force = bundle.frame("/frames/force_map", k).astype(float)
    each = FORCE_CELLS if force.shape[0] <= force.shape[1] else FORCE_CELLS[::-1]
    rows, columns = (shares(n, cells) for n, cells in zip(force.shape, each, strict=False))
    return np.asarray(np.einsum("ri,ijx,cj->rcx", rows, force, columns))


def statistics(episodes: Sequence[dict[str, np.ndarray]]) -> dict[str, dict[str, list]]:
    """By feature: extremes, mean, deviation and quantiles of each component; of images per colour, in [0, 1]."""
    statistic = {}
    for name, first in episodes[0].items():
        if first.ndim > 2:  # every eighth pixel is enough
            colours, full = (3, 255.0) if first.ndim == 4 else (1, 1.0)
            values = np.concatenate([e[name][:, ::8, ::8].reshape(-1, colours) for e in episodes]) / full
        else:
            values = np.concatenate([e[name] for e in episodes]).astype(float)
        shape = (-1, 1, 1) if first.ndim > 2 else (-1,)
        kinds = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
        kinds |= {f"q{round(100 * q):02d}": np.quantile(values, q, axis=0) for q in STATISTIC_QUANTILES}
        statistic[name] = {kind: value.reshape(shape).tolist() for kind, value in kinds.items()}
        statistic[name]["count"] = [sum(len(e[name]) for e in episodes)]
    return statistic


def _vector(kind: str, size: int, names: list[str] | None = None) -> dict[str, Any]:
    return {"dtype": kind, "shape": [size], "names": names}


def _picture(shape: Sequence[int], **info: Any) -> dict[str, Any]:
    feature = {"dtype": "image", "shape": list(shape), "names": ["height", "width", "channels"]}
    return feature | ({"info": info} if info else {})


def _features(bundles: Sequence[Bundle]) -> dict[str, Any]:
    """LeRobot's description of one sensor's columns: the data that all scenes have with the same size."""
    sizes = {bundle.shapes["/frames/rgb"][1:] for bundle in bundles}
    if len(sizes) > 1:
        raise UserError(f"{bundles[0].path.parent}: LeRobot needs images of one size, these have {sorted(sizes)}")
    pose = _vector("float32", 7, POSE_COMPONENTS)
    features = {IMAGE_KEY: _picture(sizes.pop()), "observation.state": pose, "action": pose}
    for name, units in VECTOR_UNITS.items():
        shapes = {bundle.shapes.get(f"/frames/{name}", (0, 0))[1:] for bundle in bundles}
        if len(shapes) == 1 and (count := int(np.prod(shapes.pop()))):
            names = [f"{axis}_{units}" for axis in "xyz"] if count == 3 else None
            features[f"observation.{name}"] = _vector("float32", count, names)
    if {"observation.force", "observation.torque"} <= features.keys():
        wrench = [*features["observation.force"]["names"], *(f"torque_{axis}_n_mm" for axis in "xyz")]
        features[f"{TACTILE_PREFIX}wrench"] = _vector("float32", 6, wrench)
    if all("/frames/force_map" in bundle for bundle in bundles):
        features[f"{TACTILE_PREFIX}force"] = _vector("float32", 3 * FORCE_CELLS[0] * FORCE_CELLS[1])
    if all(EVENT_MODE_PATH in bundle for bundle in bundles):
        names = [name for parts in CONTACT_COMPONENTS.values() for name in parts]
        features["observation.contact"] = _vector("float32", len(names), names)
        features["observation.contact_mode"] = _vector("int64", 1)
    maps = {bundle.shapes.get("/frames/height", ())[1:] for bundle in bundles}
    if len(maps) == 1 and (shape := maps.pop()):
        features[DEPTH_KEY] = _picture((*shape, 1), is_depth_map=True, depth_unit="um")
    return features


def _together(parts: dict[str, dict[str, Any]], join: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
    """The columns of all sensors as those of one episode: state and action joined, others renamed by sensor."""
    if list(parts) == [SINGLE_SENSOR]:
        return parts[SINGLE_SENSOR]
    both = ("observation.state", "action")
    joined = {name: join({role: part[name] for role, part in parts.items()}) for name in both}
    own = {_named(name, role): part[name] for role, part in parts.items() for name in part if name not in both}
    return joined | own


def _named(name: str, role: str) -> str:
    """The name of a single sensor's column for one sensor of several."""
    if name.startswith(TACTILE_PREFIX):
        return f"{TACTILE_PREFIX}{role}.{name.removeprefix(TACTILE_PREFIX)}"
    return name.replace(SINGLE_SENSOR, role) if SINGLE_SENSOR in name else f"{name}.{role}"


def _joined(parts: dict[str, Any]) -> dict[str, Any]:
    names = [f"{role}.{name}" for role, part in parts.items() for name in part["names"]]
    return _vector("float32", len(names), names)


def _data(
    all_episodes: Sequence[Episode], tasks: list[str], features: Each, out: Path
) -> tuple[list[Path], list[dict[str, Any]]]:
    """Write the frames of all episodes, and return the files and a row of metadata for each episode."""
    import pyarrow as pa
    from pyarrow import parquet

    made: list[Path] = []
    rows: list[dict[str, Any]] = []
    start, writer = 0, None
    for number, episode in enumerate(all_episodes):
        content = columns(episode, features)
        count = episode.frames
        table = pa.table(_arrays(episode, content, number, start, tasks))
        begins = number == 0 or episode.split != all_episodes[number - 1].split
        if writer is None or begins or made[-1].stat().st_size > PARQUET_FILE_BYTES:
            if writer is not None:
                writer.close()
            made.append(out / DATA_PATH.format(*divmod(len(made), FILES_PER_FOLDER)))
            made[-1].parent.mkdir(parents=True, exist_ok=True)
            writer = parquet.ParquetWriter(made[-1], table.schema, compression="snappy")
        writer.write_table(table)
        chunk, file = divmod(len(made) - 1, FILES_PER_FOLDER)
        stats = statistics([content])
        rows.append(
            {
                "episode_index": number,
                "tasks": [episode.task],
                "scene": episode.name,
                "length": count,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": start,
                "dataset_to_index": start + count,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                **{f"stats/{name}/{kind}": v for name, kinds in stats.items() for kind, v in kinds.items()},
            }
        )
        start += count
    if writer is not None:
        writer.close()
    return made, rows


def _arrays(
    episode: Episode, content: dict[str, np.ndarray], number: int, start: int, tasks: list[str]
) -> dict[str, Any]:
    """Arrow arrays of an episode: images as PNG files, vectors as lists of fixed length."""
    import pyarrow as pa

    bundle, out = episode.first, dict[str, Any]()
    count, kind = episode.frames, pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    for name, values in content.items():
        if values.ndim > 2:
            out[name] = pa.array([{"bytes": encoded(image, "PNG"), "path": None} for image in values], kind)
        else:
            flat = pa.array(values.ravel())
            out[name] = flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    times = bundle["/frames/time"][:count] if "/frames/time" in bundle else np.arange(count) / NOMINAL_FPS
    out["timestamp"] = pa.array((times - times[0]).astype(np.float32))
    task_index = tasks.index(episode.task)
    known = (np.arange(count), np.full(count, number), start + np.arange(count), np.full(count, task_index))
    return out | {name: pa.array(values) for name, values in zip(INDEX_COLUMNS, known, strict=True)}


def _fps(bundle: Bundle) -> int:
    """Frame rate of a scene, whose frames must be evenly spaced in time; NOMINAL_FPS without time."""
    if "/frames/time" not in bundle or bundle.frames < 2:
        return NOMINAL_FPS
    steps = np.diff(bundle["/frames/time"])
    if np.ptp(steps) > 1e-4 or steps[0] <= 0 or abs(1 / steps[0] - round(1 / steps[0])) > 1e-3:
        raise UserError(f"{bundle.path}: LeRobot needs evenly spaced frames, a whole number a second")
    return round(1 / float(steps[0]))


def _tasks(tasks: list[str]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The table of tasks, and the metadata by which pandas uses their names as index."""
    kinds = (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    keys = ("name", "field_name", "pandas_type", "numpy_type", "metadata")
    about = [dict(zip(keys, (name, name, kind, plain, None), strict=True)) for name, kind, plain in kinds]
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": about, "pandas_version": "2.2.0"}
    return [{"task_index": i, "task": name} for i, name in enumerate(tasks)], {"pandas": json.dumps(pandas)}


def _table(path: Path, rows: list[dict[str, Any]], metadata: dict[str, Any] | None = None) -> Path:
    import pyarrow as pa
    from pyarrow import parquet

    path.parent.mkdir(parents=True, exist_ok=True)
    table = pa.Table.from_pylist(rows)
    parquet.write_table(table.replace_schema_metadata(metadata) if metadata else table, path)
    return path
