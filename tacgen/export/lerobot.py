"""LeRobot, dataset format v3.0: Parquet tables of frames with their images in them, an episode a scene.

    https://github.com/huggingface/lerobot (src/lerobot/datasets)

`observation.images.tactile` is the camera's image, `observation.state` the indenter's pose (x y z [mm], quaternion
w x y z) and `action` the pose of the next frame; `observation.force` [N], `.torque` [N mm], `.markers` and
`.marker_flow` [px] (x and y in turn), `.contact_mode` (a number, see tacgen.labels.events) and `.contact` are there if
the scenes have them. A task is a scene's caption. Quasi-static scenes know no time: frames then come at a nominal rate
of FPS.
"""

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.bundle.bundle import Bundle
from tacgen.bundle.caption import MODE, caption
from tacgen.errors import UserError
from tacgen.export import needs, poses

FPS = 10
FILE_BYTES = 100_000_000  # of a Parquet file, as LeRobot has it
FILES = 1000  # in a folder
IMAGE = "observation.images.tactile"
POSE = [*(f"{axis}_mm" for axis in "xyz"), *(f"q{axis}" for axis in "wxyz")]
CONTACT = {  # datasets of /frames/events, and the names of their components
    "stick_ratio": ["stick_ratio"],
    "friction_used": ["friction_used"],
    "center_of_pressure": ["center_x_mm", "center_y_mm", "center_z_mm"],
    "contact_area": ["area_mm2"],
    "patches": ["patches"],
}
KINDS = {"image": np.uint8, "float32": np.float32, "int64": np.int64}  # of what LeRobot calls so
INDICES = ("frame_index", "episode_index", "index", "task_index")
QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
DATA, EPISODES = "data/chunk-{:03d}/file-{:03d}.parquet", "meta/episodes/chunk-000/file-000.parquet"


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """The dataset's folder; to be read with LeRobotDataset(name, root=out).

    Raises:
        UserError: PyArrow is missing, a scene has no images, or they are not all of one size or at one rate.
    """
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise UserError("export lerobot needs PyArrow: pip install 'tacgen[lerobot]'") from None
    for bundle in bundles:
        needs(bundle, ("/frames/rgb",), "rgb")
    features, rates = _features(bundles), {_fps(bundle) for bundle in bundles}
    if len(rates) > 1:
        raise UserError(
            f"{bundles[0].path.parent}: LeRobot takes frames at one rate, these have {sorted(rates)} a second"
        )
    tasks = list(dict.fromkeys(map(caption, bundles)))
    made, rows = _data(bundles, tasks, features, out)
    info = {
        "codebase_version": "v3.0",
        "robot_type": bundles[0].attrs["sensor"],
        "total_episodes": len(bundles),
        "total_frames": sum(bundle.frames for bundle in bundles),
        "total_tasks": len(tasks),
        "chunks_size": FILES,
        "data_files_size_in_mb": FILE_BYTES // 10**6,
        "video_files_size_in_mb": 200,
        "fps": rates.pop(),
        "splits": {"train": f"0:{len(bundles)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }
    stats = statistics([columns(bundle, features) for bundle in bundles])
    made += [_table(out / "meta/tasks.parquet", *_tasks(tasks)), _table(out / EPISODES, rows)]
    for name, content in (("info", info), ("stats", stats)):
        made.append(out / "meta" / f"{name}.json")
        made[-1].write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")
    return made


def columns(bundle: Bundle, features: dict[str, Any]) -> dict[str, np.ndarray]:
    """Of each feature but the indices, its values frame by frame."""
    state = poses(bundle["/frames/pose"])
    found = {IMAGE: bundle["/frames/rgb"], "observation.state": state, "action": np.vstack([state[1:], state[-1:]])}
    for name in ("force", "torque", "markers", "marker_flow"):
        if f"observation.{name}" in features:
            found[f"observation.{name}"] = bundle[f"/frames/{name}"].reshape(bundle.frames, -1)
    if "observation.contact" in features:
        found["observation.contact"] = np.column_stack([bundle[f"/frames/events/{name}"] for name in CONTACT])
        found["observation.contact_mode"] = bundle[MODE][:, None]
    return {name: values.astype(KINDS[features[name]["dtype"]]) for name, values in found.items()}


def statistics(episodes: Sequence[dict[str, np.ndarray]]) -> dict[str, dict[str, list]]:
    """By feature: extremes, mean, deviation and quantiles of each component; of images by colour, in [0, 1]."""
    found = {}
    for name in episodes[0]:
        if name == IMAGE:  # every eighth pixel will do
            values = np.concatenate([e[name][:, ::8, ::8].reshape(-1, 3) for e in episodes]) / 255.0
        else:
            values = np.concatenate([e[name] for e in episodes]).astype(float)
        shape = (3, 1, 1) if name == IMAGE else (-1,)
        kinds = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
        kinds |= {f"q{round(100 * q):02d}": np.quantile(values, q, axis=0) for q in QUANTILES}
        found[name] = {kind: value.reshape(shape).tolist() for kind, value in kinds.items()}
        found[name]["count"] = [sum(len(e[name]) for e in episodes)]
    return found


def _features(bundles: Sequence[Bundle]) -> dict[str, Any]:
    """LeRobot's description of the columns: what every scene has in one size."""
    sizes = {bundle.shapes["/frames/rgb"][1:] for bundle in bundles}
    if len(sizes) > 1:
        raise UserError(f"{bundles[0].path.parent}: LeRobot takes images of one size, these have {sorted(sizes)}")
    found: dict[str, Any] = {
        IMAGE: {"dtype": "image", "shape": list(sizes.pop()), "names": ["height", "width", "channels"]},
        "observation.state": {"dtype": "float32", "shape": [7], "names": POSE},
        "action": {"dtype": "float32", "shape": [7], "names": POSE},
    }
    for name in ("force", "torque", "markers", "marker_flow"):
        shapes = {bundle.shapes.get(f"/frames/{name}", (0, 0))[1:] for bundle in bundles}
        if len(shapes) == 1 and (count := int(np.prod(shapes.pop()))):
            axes = ["x", "y", "z"] if count == 3 else None
            found[f"observation.{name}"] = {"dtype": "float32", "shape": [count], "names": axes}
    if all(MODE in bundle for bundle in bundles):
        names = [name for parts in CONTACT.values() for name in parts]
        found["observation.contact"] = {"dtype": "float32", "shape": [len(names)], "names": names}
        found["observation.contact_mode"] = {"dtype": "int64", "shape": [1], "names": None}
    found["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    return found | {name: {"dtype": "int64", "shape": [1], "names": None} for name in INDICES}


def _data(
    bundles: Sequence[Bundle], tasks: list[str], features: dict[str, Any], out: Path
) -> tuple[list[Path], list[dict[str, Any]]]:
    """Write the frames, episode after episode, and return the files and a row about each episode."""
    import pyarrow as pa
    from pyarrow import parquet

    made: list[Path] = []
    rows: list[dict[str, Any]] = []
    start, writer = 0, None
    for number, bundle in enumerate(bundles):
        content = columns(bundle, features)
        count = bundle.frames
        table = pa.table(_arrays(bundle, content, number, start, tasks))
        if writer is None or made[-1].stat().st_size > FILE_BYTES:
            if writer is not None:
                writer.close()
            made.append(out / DATA.format(*divmod(len(made), FILES)))
            made[-1].parent.mkdir(parents=True, exist_ok=True)
            writer = parquet.ParquetWriter(made[-1], table.schema, compression="snappy")
        writer.write_table(table)
        chunk, file = divmod(len(made) - 1, FILES)
        stats = statistics([content])
        rows.append(
            {
                "episode_index": number,
                "tasks": [caption(bundle)],
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
    bundle: Bundle, content: dict[str, np.ndarray], number: int, start: int, tasks: list[str]
) -> dict[str, Any]:
    """Arrow arrays of one episode: images as PNG files, vectors as lists of fixed length."""
    import pyarrow as pa

    count = bundle.frames
    images = [{"bytes": _png(image), "path": None} for image in content[IMAGE]]
    out: dict[str, Any] = {IMAGE: pa.array(images, _image_type())}
    for name, values in content.items():
        if name != IMAGE:
            flat = pa.array(values.ravel())
            out[name] = flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    times = bundle["/frames/time"] if "/frames/time" in bundle else np.arange(count) / FPS
    out["timestamp"] = pa.array((times - times[0]).astype(np.float32))
    task_index = tasks.index(caption(bundle))
    known = (np.arange(count), np.full(count, number), start + np.arange(count), np.full(count, task_index))
    return out | {name: pa.array(values) for name, values in zip(INDICES, known, strict=True)}


def _image_type() -> Any:
    import pyarrow as pa

    return pa.struct([("bytes", pa.binary()), ("path", pa.string())])


def _png(image: np.ndarray) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return file.getvalue()


def _fps(bundle: Bundle) -> int:
    """Frames a second, of a scene whose frames are evenly spaced in time; FPS where there is no time."""
    if "/frames/time" not in bundle or bundle.frames < 2:
        return FPS
    steps = np.diff(bundle["/frames/time"])
    if np.ptp(steps) > 1e-4 or steps[0] <= 0 or abs(1 / steps[0] - round(1 / steps[0])) > 1e-3:
        raise UserError(f"{bundle.path}: LeRobot takes frames at an even, whole rate a second, these come otherwise")
    return round(1 / float(steps[0]))


def _tasks(tasks: list[str]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The table of tasks, and what makes pandas take their names for its index."""
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
