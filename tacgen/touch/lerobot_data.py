"""LeRobot data sets of version 3: states and commands of their episodes, read from the Parquet tables."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import regular_file
from tacgen.base.errors import UserError, why
from tacgen.touch.columns import Named
from tacgen.touch.kinematics import Kinematics
from tacgen.touch.recording import RecordedRows

Array = np.ndarray
MAX_TABLE_BYTES = 2**34  # of a Parquet file, with its images [bytes]
INFO_PATH, EPISODES_FOLDER = "meta/info.json", "meta/episodes"
# features that may hold the positions, and the speeds, of all joints of a model in its order
WHOLE_STATES = (("observation.qpos",), ("observation.qvel", "observation.velocity"))
NUMBERS = ("float", "int", "bool", "uint")  # dtypes of features that are no pictures or texts


@dataclass(frozen=True)
class LeRobotFolder:
    """A data set's description. features: those of numbers, by name; lengths and places of the rows of each episode."""

    path: Path
    fps: float
    features: Mapping[str, Mapping[str, Any]]
    entries: list[dict[str, Any]]
    data_path: str
    model: Kinematics | None

    def __len__(self) -> int:
        return len(self.entries)

    def rows(self, number: int) -> RecordedRows:
        """One episode by its place. Raises UserError: it cannot be read, or has fewer rows than its data set says."""
        entry = self.entries[number]
        index, length = entry["episode_index"], entry["length"]
        place = {"chunk_index": entry["data/chunk_index"], "file_index": entry["data/file_index"]}
        table = _table(self.path / self.data_path.format(**place), tuple(self.features))
        here = table["episode_index"] == index
        if (there := int(here.sum())) != length:
            raise UserError(f"{self.path}: episode {index}: has {there} rows, and its data set says {length}")
        columns = {name: values[here] for name, values in table.items()}

        def get(name: str) -> Named:
            if name not in columns:
                raise KeyError(", ".join(columns))
            return columns[name].reshape(length, -1), _names(self.features[name])

        named, commands = dict[str, Array](), dict[str, Array]()
        for name in columns:
            values, names = get(name)
            target = commands if name == "action" or name.startswith("action.") else named
            for part, column in zip(names, values.T, strict=False):
                target.setdefault(part, column)
        time = columns["timestamp"].astype(float).ravel()
        qpos, qvel = self._whole(columns)
        exact = _exact(time, self.fps)
        return RecordedRows(str(index), exact, get, named, commands, qpos=qpos, qvel=qvel, model=self.model)

    def _whole(self, columns: Mapping[str, Array]) -> list[Array | None]:
        """Positions and speeds of all joints of the model, where features of the names and lengths are there."""
        sizes = (0, 0) if self.model is None else (self.model.model.nq, self.model.model.nv)
        some = [[columns[name] for name in names if name in columns] for names in WHOLE_STATES]
        return [next((v for v in each if v.shape[1:] == (n,)), None) for each, n in zip(some, sizes, strict=True)]


def opened(path: Path, model: Kinematics | None) -> LeRobotFolder:
    """The data set in a folder. Raises UserError: it is no LeRobot data set of version 3, or is damaged."""
    content = regular_file.content(path / INFO_PATH, MAX_TABLE_BYTES)
    try:
        info = json.loads(content)
        version, fps, data_path = str(info["codebase_version"]), float(info["fps"]), str(info["data_path"])
        features = {k: v for k, v in info["features"].items() if str(v["dtype"]).startswith(NUMBERS)}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"{path / INFO_PATH}: is no description of a LeRobot data set ({error!r})") from None
    if not version.startswith("v3"):
        raise UserError(f"{path}: is LeRobot {version}: bring it to v3.0 by LeRobot's convert_dataset_v21_to_v30 first")
    files = sorted((path / EPISODES_FOLDER).rglob("*.parquet"))
    wanted = ("episode_index", "length", "data/chunk_index", "data/file_index")
    entries: list[dict[str, Any]] = []
    for file in files:
        table = _table(file, wanted)
        entries += [dict(zip(wanted, map(int, row), strict=True)) for row in zip(*map(table.get, wanted), strict=True)]
    if not entries:
        raise UserError(f"{path / EPISODES_FOLDER}: names no episode")
    return LeRobotFolder(path, fps, features, sorted(entries, key=lambda e: e["episode_index"]), data_path, model)


@lru_cache(maxsize=2)
def _table(path: Path, names: tuple[str, ...]) -> dict[str, Array]:
    """Columns (rows, ...) of a Parquet file. Raises UserError: it lacks one, or cannot be read."""
    try:
        from pyarrow import parquet
    except ImportError:
        raise UserError("LeRobot data sets need PyArrow: pip install 'tacgen[lerobot]'") from None
    try:
        with regular_file.opened(path, MAX_TABLE_BYTES) as file:
            table = parquet.read_table(file, columns=list(names))
        found = {}
        for name in names:
            column = table[name].combine_chunks()
            rows = len(column)
            while hasattr(column, "flatten") and str(column.type).startswith(("list", "fixed_size_list", "large_list")):
                column = column.flatten()
            values = np.asarray(column.to_numpy(zero_copy_only=False))
            found[name] = values.reshape(rows, -1) if len(values) != rows else values
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {why(error)}") from None
    except (KeyError, ValueError) as error:  # PyArrow's errors are of these
        raise UserError(f"{path}: cannot be read: {str(error).partition(chr(10))[0]}") from None
    return found


def _names(feature: Mapping[str, Any]) -> list[str]:
    """Names of a feature's numbers: a list, or the first list below keys such as `motors`."""
    names: Any = feature.get("names")
    while isinstance(names, Mapping):
        names = next(iter(names.values()), None)
    return [str(name) for name in names] if isinstance(names, list) else []


def _exact(time: Array, fps: float) -> Array:
    """Times in double precision: single precision of the table rounds those of a steady rate."""
    steady = np.round(time * fps) / fps
    return steady if np.allclose(time, steady, rtol=1e-5, atol=1e-4) else time
