"""The contact log of another simulator: poses of object and sensor over time, and the force that it reported.

A CSV log is a pose table (see tacgen.recipe.pose_table) with columns of the force. An npz or HDF5 log has arrays with
the names of a Layout. Both become a ContactLog: mm, s and N, poses in the world frame, the force on the sensor.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from tacgen import regular_file
from tacgen.errors import UserError, why
from tacgen.recipe import pose_table
from tacgen.recipe.trajectory import UNIT_TOLERANCE, Column
from tacgen.replay.layouts import LAYOUTS

Array = np.ndarray
TABLES, ARCHIVES, HDF5 = (".csv", ".txt"), (".npz",), (".h5", ".hdf5")
ORDERS = {"wxyz": [0, 1, 2, 3], "xyzw": [3, 0, 1, 2]}  # columns of w x y z
ON, FRAMES = ("sensor", "object"), ("world", "sensor")
LARGEST = 2**33  # of a file, and of one array [bytes]


@dataclass(frozen=True)
class Conventions:
    """How to read a log; empty where the file or its layout says it."""

    layout: str = "tacgen"  # a name of LAYOUTS
    quaternion: str = ""  # wxyz or xyzw
    units: str = ""  # of lengths: m or mm
    force_on: str = "sensor"  # or object
    force_frame: str = "world"  # or sensor: the axes of the recorded sensor body
    group: str = "/"  # of an HDF5 file
    columns: Mapping[Column, str] | None = None  # titles of a CSV file's columns

    def __post_init__(self) -> None:
        for option, value, known in (
            ("--from", self.layout, tuple(LAYOUTS)),
            ("--quaternion", self.quaternion, ("", *ORDERS)),
            ("--units", self.units, ("", *pose_table.MM)),
            ("--force-on", self.force_on, ON),
            ("--force-frame", self.force_frame, FRAMES),
        ):
            if value not in known:
                raise UserError(f"{option} {value}: must be one of {', '.join(filter(None, known))}")


@dataclass(frozen=True)
class ContactLog:
    """The rows of a log, n of them."""

    name: str
    row: Array  # (n,) number of each in the file, from 0
    time: Array  # (n,) [s]
    body: Array  # (n, 4, 4) pose of the object [mm]
    sensor: Array | None  # (n, 4, 4) pose of the sensor's body [mm]; None: it is not recorded
    force: Array | None  # (n, 3) on the sensor, world frame [N]; None: it is not recorded
    friction: bool  # whether the force includes friction

    def __len__(self) -> int:
        return len(self.row)

    def some(self, which: Array) -> "ContactLog":
        """The rows of these places."""
        sensor, force = (None if part is None else part[which] for part in (self.sensor, self.force))
        row, time, body = (part[which] for part in (self.row, self.time, self.body))
        return replace(self, row=row, time=time, body=body, sensor=sensor, force=force)


def read(path: Path, how: Conventions, environments: Sequence[int] = ()) -> list[ContactLog]:
    """Read a log, or one for each of some environments of a simulator that runs many at once.

    Raises:
        UserError: the file cannot be read, lacks an array, or does not say its units or the order of its quaternions.
    """
    suffix = path.suffix.lower()
    if suffix in TABLES:
        if how.quaternion or environments:
            raise UserError(
                f"{path}: is a table, whose columns qw, qx, qy, qz are named: leave --quaternion and --env out"
            )
        return [_oriented(_of_table(path, how), how)]
    if suffix not in (*ARCHIVES, *HDF5):
        raise UserError(f"{path}: is no log: it must be {', '.join((*TABLES, *ARCHIVES, *HDF5))}")
    try:
        arrays = _archive(path) if suffix in ARCHIVES else _hdf5(path, how.group)
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise UserError(f"{path}: cannot be read: {why(error)}") from None
    many: Sequence[int | None] = environments or [None]
    try:
        return [_oriented(_of_arrays(path, arrays, how, each), how) for each in many]
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None


def _of_table(path: Path, how: Conventions) -> ContactLog:
    try:
        rows = pose_table.read(path, how.units or None, how.columns).poses
    except UserError as error:
        raise UserError(f"{path}: {line}" for line in error.lines) from None
    sensors = [row.sensor for row in rows if row.sensor is not None]
    forces = [row.force for row in rows if row.force is not None]
    found = ContactLog(
        path.stem,
        np.arange(len(rows)),
        np.array([row.time for row in rows]),
        np.array([row.pose for row in rows]),
        np.array(sensors) if sensors else None,
        np.array(forces) if forces else None,
        True,
    )
    if found.force is not None and not np.isfinite(found.force).all():
        line = rows[int(np.flatnonzero(~np.isfinite(found.force).all(1))[0])].line
        raise UserError(f"{path}: line {line}: the force must be numbers")
    return found


def _archive(path: Path) -> dict[str, Array]:
    with regular_file.opened(path, LARGEST) as content, np.load(content, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _hdf5(path: Path, group: str) -> dict[str, Array]:
    import h5py

    regular_file.opened(path, LARGEST).close()  # not a pipe
    with h5py.File(path, "r") as file:
        if not isinstance(inner := file.get(group), h5py.Group):
            raise ValueError(f"it has no group {group}; there are: {', '.join(file) or 'none'}")
        sets = {name: data for name, data in inner.items() if isinstance(data, h5py.Dataset)}
        if big := [name for name, data in sets.items() if data.nbytes > LARGEST]:
            raise ValueError(f"{big[0]} is larger than {LARGEST >> 30} GB")
        return {
            name: np.asarray(data.asstr()[()] if data.dtype.kind == "O" else data[()]) for name, data in sets.items()
        }


def _of_arrays(path: Path, arrays: dict[str, Array], how: Conventions, environment: int | None) -> ContactLog:
    """The log in the arrays of a file. Raises ValueError with a message for people."""
    layout = LAYOUTS[how.layout]
    fitting = [name for name, other in LAYOUTS.items() if other.names_of_object(arrays)]
    if how.layout not in fitting:
        wanted = " and ".join(names[0] for names in (layout.position, layout.rotation) if names) or layout.pose[0]
        hint = f"its arrays are those of --from {fitting[0]}" if fitting else f"--from {how.layout} reads these"
        raise ValueError(f"has no array {wanted} (it has: {', '.join(arrays)}); {hint}")
    order = _said("quaternion", how.quaternion, arrays, layout.quaternion, tuple(ORDERS))
    scale = pose_table.MM[_said("units", how.units, arrays, layout.units, tuple(pose_table.MM))]
    if "time" not in arrays:
        raise ValueError(f"has no array time [s] (it has: {', '.join(arrays)})")
    if arrays["time"].dtype.kind not in "fiu":
        raise ValueError("time holds no numbers")
    time = np.asarray(arrays["time"], float).ravel()
    if len(time) < 1 or not (np.diff(time) > 0).all():
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
    force = None if known is None else rows(known.name, 3)
    added = known is not None and known.friction in arrays
    if known is not None and force is not None and added:
        if arrays[known.friction].shape != arrays[known.name].shape:
            raise ValueError(f"{known.friction} has another shape than {known.name}: record both for the same body")
        force = force + np.nan_to_num(rows(known.friction, 3))  # nan where nothing touches
    if force is not None and not np.isfinite(force).all():
        raise ValueError(
            f"{known.name if known else ''} must be numbers, and is not in row {_first(~np.isfinite(force))}"
        )
    name = path.stem if environment is None else f"{path.stem}-env-{environment}"
    friction = known is None or known.total or added
    return ContactLog(name, np.arange(len(time)), time, body, sensor, force, friction)


def _said(what: str, option: str, arrays: dict[str, Array], usual: str, known: tuple[str, ...]) -> str:
    """A convention by the option, the file's own entry, or the layout."""
    own = str(arrays[what].item()) if what in arrays and arrays[what].ndim == 0 else ""
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
    from scipy.spatial.transform import Rotation

    length = np.linalg.norm(quaternion, axis=1)
    wrong = ~(np.isfinite(position).all(1) & (np.abs(length - 1) <= UNIT_TOLERANCE))
    if wrong.any():
        row = _first(wrong)
        raise ValueError(
            f"{name}: row {row}: a pose needs numbers and a quaternion of length 1 (got {length[row]:.4g})"
        )
    poses = np.tile(np.eye(4), (len(position), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(quaternion[:, ORDERS[order]], scalar_first=True).as_matrix()
    poses[:, :3, 3] = position
    return poses


def _first(wrong: Array) -> int:
    return int(np.flatnonzero(wrong.reshape(len(wrong), -1).any(1))[0])


def _oriented(log: ContactLog, how: Conventions) -> ContactLog:
    """A log with its force on the sensor, in the world frame."""
    if log.force is None:
        return log
    force = -log.force if how.force_on == "object" else log.force
    if how.force_frame == "sensor":
        if log.sensor is None:
            raise UserError(f"{log.name}: --force-frame sensor: the log has no pose of the sensor to turn forces by")
        force = np.einsum("nij,nj->ni", log.sensor[:, :3, :3], force)
    return replace(log, force=force)
