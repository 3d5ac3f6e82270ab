"""Opens recorded episodes: which reader it takes is seen from what is in the path."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tacgen.base.errors import UserError
from tacgen.replay.log_file import HDF5_SUFFIXES
from tacgen.touch import columns as columns_file
from tacgen.touch import kinematics, lerobot_data, logs, state_files, umi
from tacgen.touch.columns import ColumnNames
from tacgen.touch.kinematics import Kinematics
from tacgen.touch.lerobot_data import LeRobotFolder
from tacgen.touch.logs import Logs
from tacgen.touch.recording import Recording
from tacgen.touch.state_files import StateFile
from tacgen.touch.umi import Buffer

Reader = LeRobotFolder | Buffer | StateFile | Logs
EPISODE_FILES = (
    "a LeRobot folder (meta/info.json), HDF5 with data/demo_0 or traj_0, UMI's zarr, or logs (.csv, .npz, .h5)"
)


def open_source(
    path: Path, model: Path | None = None, objects: Iterable[str] = (), columns: Path | Mapping[str, Any] | None = None
) -> Recording:
    """The episodes in a file or folder.

    Args:
        path: one of EPISODE_FILES.
        model: MJCF or URDF whose joints the episodes have; those of robomimic carry one.
        objects: BODY of the model, NAME=mesh file, or NAME={shape: ...} as a recipe has it; without any, all bodies
            of the model that have a free joint.
        columns: see tacgen.touch.columns.

    Raises:
        UserError: nothing there can be read; the model or a mesh cannot.
    """
    given, known = columns_file.read(columns), kinematics.opened(model) if model else None
    asked = {name: text for name, _, text in (each.partition("=") for each in objects)}
    if not path.exists():
        raise UserError(f"{path}: there is no such file or folder")
    kind, found = _reader(path, known, asked, given)
    return Recording(path, kind, given.fps or found.fps, len(found), found.rows, asked, given)


def _reader(path: Path, model: Kinematics | None, asked: Mapping[str, str], given: ColumnNames) -> tuple[str, Reader]:
    """The kind of the episodes, and who reads them."""
    if (path / lerobot_data.INFO_PATH).is_file():
        return "lerobot", lerobot_data.opened(path, model)
    if path.name.endswith((".zarr", ".zarr.zip")) or any((path / name).is_file() for name in (".zgroup", "zarr.json")):
        return "umi", umi.opened(path, given.fps, model)
    if path.suffix.lower() in HDF5_SUFFIXES and (found := state_files.opened(path, model, given.fps)) is not None:
        return found.kind, found
    if path.is_dir() or path.suffix.lower() in logs.LOG_SUFFIXES:
        return "log", logs.opened(path, given, list(asked))
    raise UserError(f"{path}: is none of these: {EPISODE_FILES}")
