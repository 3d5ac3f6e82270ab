"""Logs in npz and HDF5 files: arrays with the names of a Layout. Messages of ValueErrors are for people."""

import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import regular_file
from tacgen.base.csv_table import MAX_TABLE_VALUE
from tacgen.base.errors import UserError, why
from tacgen.bundle import hdf5_file
from tacgen.recipe import pose_table
from tacgen.recipe.trajectory import QUATERNION_TOL
from tacgen.replay.contact_log import QUATERNION_ORDERS, ContactLog, Conventions
from tacgen.replay.layouts import LOG_LAYOUTS, Force, Layout

Array = np.ndarray
Arrays = dict[str, Array]
MAX_LOG_BYTES = 2**33  # of a file, and of one array [bytes]
UNREAD_ARRAY = np.empty(0)  # in the place of arrays that are no part of a log
LZF_FILTER = 32000  # h5py's own filter


def archive(path: Path, layout: Layout) -> Arrays:
    """The arrays of a layout in an npz file, with the names of all others. Raises UserError: it cannot be read."""
    try:
        with warnings.catch_warnings(), regular_file.opened(path, MAX_LOG_BYTES) as content:
            warnings.simplefilter("ignore")  # about a header that an old NumPy wrote, or somebody crafted
            if not zipfile.is_zipfile(content):
                raise ValueError("it is no npz file")
            content.seek(0)
            with np.load(content, allow_pickle=False) as file:
                sizes = {info.filename.removesuffix(".npy"): info.file_size for info in file.zip.infolist()}
                if big := [name for name in layout.names & sizes.keys() if sizes[name] > MAX_LOG_BYTES]:
                    raise ValueError(f"{big[0]} is larger than {MAX_LOG_BYTES >> 30} GB")
                arrays = {name: file[name] if name in layout.names else UNREAD_ARRAY for name in file.files}
                if no_array := [name for name, array in arrays.items() if not isinstance(array, np.ndarray)]:
                    raise ValueError(f"{no_array[0]} is no array")
                return arrays
    except Exception as error:  # NumPy, zipfile and its decompressors fail in many ways on what is damaged or crafted
        raise UserError(f"{path}: cannot be read: {_said_by(error)}") from error


def hdf5(path: Path, group: str, layout: Layout) -> Arrays:
    """As `archive`, of one group of an HDF5 file."""
    with hdf5_file.opened(path) as root:
        try:
            inner = hdf5_file.item_at(root, group)
            names = _names(inner)
        except (KeyError, ValueError, AttributeError, TypeError):  # nothing, a link, a dataset
            there = ", ".join(_names(root)) or "none"
            raise UserError(f"{path}: cannot be read: it has no group {group}; there are: {there}") from None
        return {name: dataset(path, inner, name) if name in layout.names else UNREAD_ARRAY for name in names}


def _names(group: Any) -> list[str]:
    """The names of what is in a group; h5py gives bytes for one that is no text."""
    return [name if isinstance(name, str) else name.decode(errors="backslashreplace") for name in group]


def dataset(path: Path, group: Any, name: str) -> Array:
    """A dataset of numbers or text below an open group, in the file itself. Raises UserError: it is something else."""
    import h5py

    try:
        data = hdf5_file.item_at(group, name)
        kind, text = data.dtype.kind, h5py.check_string_dtype(data.dtype)
        if problem := hdf5_file.not_here(data.id, hdf5_file.ALLOWED_FILTERS | {LZF_FILTER}):
            raise ValueError(problem)
        if data.nbytes > MAX_LOG_BYTES or (kind == "O" and text is None):
            raise ValueError(f"it must be numbers or text of at most {MAX_LOG_BYTES >> 30} GB")
        return np.asarray(data.asstr()[()] if kind == "O" else data[()])
    except Exception as error:  # as of `opened`
        raise UserError(f"{path}: cannot be read: {name}: {_said_by(error)}") from error


def _said_by(error: Exception) -> str:
    return (why(error) or type(error).__name__).partition("\n")[0]


def log_of(name: str, arrays: Arrays, how: Conventions, environment: int | None) -> ContactLog:
    """The log in the arrays of a file, or that of one environment.

    Raises:
        ValueError: an array is missing, is of no numbers or of another shape; nothing says the unit of lengths or the
            order of quaternions.
    """
    layout = LOG_LAYOUTS[how.layout]
    fitting = [name for name, other in LOG_LAYOUTS.items() if other.names_of_object(arrays)]
    if how.layout not in fitting:
        wanted = " and ".join(names[0] for names in (layout.position, layout.rotation) if names) or layout.pose[0]
        hint = f"its arrays are those of --from {fitting[0]}" if fitting else f"--from {how.layout} reads these"
        raise ValueError(f"has no array {wanted} (it has: {', '.join(arrays)}); {hint}")
    order = _said("quaternion", how.quaternion, arrays, layout.quaternion, tuple(QUATERNION_ORDERS))
    scale = pose_table.MM_PER_UNIT[_said("units", how.units, arrays, layout.units, tuple(pose_table.MM_PER_UNIT))]
    if "time" not in arrays:
        raise ValueError(f"has no array time [s] (it has: {', '.join(arrays)})")
    if arrays["time"].dtype.kind not in "fiu":
        raise ValueError("time holds no numbers")
    time = np.asarray(arrays["time"], float).ravel()
    if len(time) < 1 or not ((np.abs(time) < MAX_TABLE_VALUE).all() and (np.diff(time) > 0).all()):
        raise ValueError("time must increase from row to row")

    def rows(name: str, width: int) -> Array:
        return _rows(name, arrays[name], len(time), width, environment)

    def poses(whole: str, position: str, rotation: str) -> Array:
        if whole:
            both = rows(whole, 7)
            return _poses(whole, both[:, :3] * scale, both[:, 3:7], order)
        return _poses(rotation, rows(position, 3) * scale, rows(rotation, 4), order)

    body = poses(*layout.names_of_object(arrays))
    of_sensor = layout.names_of_sensor(arrays)
    if not of_sensor and (half := [name for name in layout.half_of_sensor if name in arrays]):
        raise ValueError(f"has {half[0]} without {' or '.join(n for n in layout.half_of_sensor if n != half[0])}")
    sensor = poses(*of_sensor) if of_sensor else None
    known = next((force for force in layout.forces if force.name in arrays), None)
    force = None if known is None else _force(known, arrays, rows)
    friction = known is None or known.total or known.friction in arrays
    torque = None
    if force is not None and layout.torque in arrays:
        torque = _bounded(layout.torque, rows(layout.torque, 3) * scale)
    name = name if environment is None else f"{name}-env-{environment}"
    return ContactLog(name, np.arange(len(time)), time, body, sensor, force, friction, torque)


def _force(known: Force, arrays: Arrays, rows: Callable[[str, int], Array]) -> Array:
    """The force (n, 3) [N], with friction if that is an array of its own."""
    force = rows(known.name, 3)
    if known.friction in arrays:
        if arrays[known.friction].shape != arrays[known.name].shape:
            raise ValueError(f"{known.friction} has another shape than {known.name}: record both for the same body")
        force = force + np.nan_to_num(rows(known.friction, 3))  # nan where nothing touches
    return _bounded(known.name, force)


def _bounded(name: str, values: Array) -> Array:
    """Values (n, 3), if all are numbers of a usual size."""
    if (wrong := ~(np.abs(values) < MAX_TABLE_VALUE)).any():  # nan, too
        raise ValueError(f"{name} must be numbers, and is not in row {_first(wrong)} (below {MAX_TABLE_VALUE:g})")
    return values


def _said(what: str, option: str, arrays: Arrays, usual: str, known: tuple[str, ...]) -> str:
    """A convention by the option, the file's own entry, or the layout."""
    said = arrays[what].item() if what in arrays and arrays[what].ndim == 0 else ""
    own = said.decode("ascii", "backslashreplace") if isinstance(said, bytes) else str(said)
    if own and own not in known:
        raise ValueError(f"its {what} is {own!r}, and must be one of {', '.join(known)}")
    if own and option and own != option:
        raise ValueError(f"its {what} is {own}: leave --{what} {option} out")
    if not (found := option or own or usual):
        missing = {"quaternion": "the order of its quaternions", "units": "the unit of its lengths"}[what]
        raise ValueError(f"does not say {missing}: give --{what} {' or '.join(known)}")
    return found


def _rows(name: str, array: Array, count: int, width: int, environment: int | None) -> Array:
    """An array (rows, width) of one environment out of (rows, environments, bodies, ..., width)."""
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} holds no numbers")
    if array.ndim < 2 or len(array) != count or array.shape[-1] < width:
        raise ValueError(f"{name} has the shape {array.shape}: expected ({count}, ..., {width}), a row for each time")
    if array.ndim > 2:
        here = 0 if environment is None else environment
        if environment is None and array.shape[1] > 1:
            raise ValueError(f"{name} holds {array.shape[1]} environments: choose some with --env, from 0")
        if here >= array.shape[1]:
            raise ValueError(f"{name} holds {array.shape[1]} environments, and no --env {here}: count from 0")
        array = array[:, here]
    if any(size > 1 for size in array.shape[1:-1]):
        raise ValueError(
            f"{name} has the shape {array.shape} without environments: record one body and one counterpart"
        )
    return np.asarray(array.reshape(count, -1)[:, : array.shape[-1]], float)


def _poses(name: str, position: Array, quaternion: Array, order: str) -> Array:
    large = ~(np.abs(np.hstack([position, quaternion])) < MAX_TABLE_VALUE).all(1)  # or nan
    length = np.linalg.norm(np.where(large[:, None], np.nan, quaternion), axis=1)
    if (wrong := ~(np.abs(length - 1) <= QUATERNION_TOL)).any():
        row = _first(wrong)
        raise ValueError(
            f"{name}: row {row}: a pose needs numbers and a quaternion of length 1 (got {length[row]:.4g})"
        )
    return pose_table.matrices(position, quaternion[:, QUATERNION_ORDERS[order]])


def _first(wrong: Array) -> int:
    return int(np.flatnonzero(wrong.reshape(len(wrong), -1).any(1))[0])
