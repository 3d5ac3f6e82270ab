"""Pose tables: CSV with a header and one pose a row, of a body or of a body and a sensor. Errors name the line."""

import functools
import hashlib
import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tacgen.base import csv_table, regular_file
from tacgen.base.errors import UserError, why
from tacgen.recipe.trajectory import Column, Quaternion, Vector, unit

if TYPE_CHECKING:
    from numpy import ndarray

    from tacgen.recipe.trajectory import Placement

# Accepted titles of each column. The prefix of ROS names (`field.pose.position.x`, from `rostopic echo -p`) is ignored;
# x, y and z may end in _mm or _m, time in _s, _ms, _us or _ns, a force in _n; upper and lower case are the same.
COLUMN_TITLES = {
    "time": ("time", "timestamp", "t", "%time"),
    **{axis: (axis, f"t{axis}", f"p{axis}", f"position_{axis}", f"position.{axis}") for axis in "xyz"},
    **{f"q{part}": (f"q{part}", f"orientation_{part}", f"orientation.{part}") for part in "wxyz"},
    **{f"sensor_{axis}": (f"sensor_{axis}", f"sensor_position_{axis}") for axis in "xyz"},
    **{f"sensor_q{part}": (f"sensor_q{part}", f"sensor_orientation_{part}") for part in "wxyz"},
    **{f"force_{axis}": (f"force_{axis}", f"force.{axis}") for axis in "xyz"},
    **{f"object_{axis}": (f"object_{axis}", f"object_position_{axis}") for axis in "xyz"},
    **{f"object_q{part}": (f"object_q{part}", f"object_orientation_{part}") for part in "wxyz"},
    "grip": ("grip", "grip_force"),
    "width": ("width", "gripper_width"),
}
BODY_COLUMNS = ("x", "y", "z", "qw", "qx", "qy", "qz")
SENSOR_COLUMNS = tuple(f"sensor_{name}" for name in BODY_COLUMNS)  # all of them, or none
OBJECT_COLUMNS = tuple(f"object_{name}" for name in BODY_COLUMNS)  # likewise
FORCE_COLUMNS = ("force_x", "force_y", "force_z")  # used by a replay with match: force
OPTIONAL_CELLS = {*OBJECT_COLUMNS, *FORCE_COLUMNS, "grip", "width"}  # columns whose cells may be empty
LENGTH_COLUMNS = (*BODY_COLUMNS[:3], *SENSOR_COLUMNS[:3], *OBJECT_COLUMNS[:3], "width")
MM_PER_UNIT = {"mm": 1.0, "m": 1000.0}
SECONDS_PER_UNIT = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
NEWTONS_PER_UNIT = {"n": 1.0}
UNIT_SUFFIXES: dict[str, Mapping[str, float]] = {
    "time": SECONDS_PER_UNIT,
    **dict.fromkeys(LENGTH_COLUMNS, MM_PER_UNIT),
    **dict.fromkeys((*FORCE_COLUMNS, "grip"), NEWTONS_PER_UNIT),
}
MAX_POSE_TABLE_BYTES = 200_000_000  # [bytes]
Placed = tuple[Vector, Quaternion]  # position [mm] and rotation
# line, time as in the file, body, sensor, force [N], object, grip [N] and width [mm]
Row = tuple[int, float, Placed, Placed | None, Vector | None, Placed | None, float, float]


class TimedPose(NamedTuple):
    """One row: the poses of a body and, if it is recorded, of the sensor in the table's frame, lengths in mm."""

    line: int  # of the file, from 1
    time: float  # [s]
    pose: "ndarray"  # (4, 4)
    sensor: "ndarray | None" = None  # (4, 4)
    force: Vector | None = None  # on the sensor, in the table's frame [N]; its components may be nan
    held: "ndarray | None" = None  # (4, 4) of the object that a gripper holds
    grip: float = math.nan  # normal force of each finger [N]
    width: float = math.nan  # distance of the fingers' untouched faces [mm]
    normal: float = math.nan  # that a matched replay asks for, pressing on the gel; in a grasp the grip [N]


@dataclass(frozen=True)
class PoseTable:
    """The poses of a file in order."""

    sha256: str
    poses: tuple[TimedPose, ...]


def read(path: Path, units: str | None = None, columns: Mapping[Column, str] | None = None) -> PoseTable:
    """Read a table. `units`: of x, y and z if the header does not say; `columns`: titles that are not in COLUMN_TITLES.

    Raises:
        UserError: the file cannot be read or is not such a table; its lines do not name the file.
    """
    try:
        raw = regular_file.read_bytes(path, MAX_POSE_TABLE_BYTES)
    except (OSError, ValueError) as error:
        raise UserError(f"cannot be read: {why(error)}") from None
    return _parsed(raw, units, tuple((columns or {}).items()))


def matrices(positions: "list[Vector] | ndarray", quaternions: "list[Quaternion] | ndarray") -> "ndarray":
    """Poses (n, 4, 4) from positions [mm] and unit quaternions w, x, y, z.

    Not by SciPy's RigidTransform, which orthogonalises each rotation and so changes its last bits.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    poses[:, :3, 3] = positions
    return poses


def relative(
    rows: "Sequence[TimedPose]", sensor_pose: "Placement", indenter_pose: "Placement | None" = None
) -> "ndarray":
    """Poses (n, 4, 4) of the indenter in the sensor's frame.

    Args:
        rows: of one table.
        sensor_pose: of the sensor's frame in the recorded sensor body or, without that, in the table's frame.
        indenter_pose: of the indenter's frame in the recorded body; None: the same.
    """
    import numpy as np

    frames = (sensor_pose, indenter_pose or type(sensor_pose)())
    sensor, inner = matrices([p.position_mm for p in frames], [p.quaternion for p in frames])
    bodies = [row.sensor for row in rows if row.sensor is not None]
    mounted = np.array(bodies) @ sensor if bodies else sensor
    return np.asarray(np.linalg.inv(mounted) @ np.array([row.pose for row in rows]) @ inner)


@functools.lru_cache(maxsize=8)
def _parsed(raw: bytes, units: str | None, columns: tuple[tuple[str, str], ...]) -> PoseTable:
    """The table in the bytes of a file; cached, so that the scenes of a batch parse it once."""
    try:
        read, wrong = csv_table.records(raw, comments=("#",))
    except ValueError as error:
        raise UserError(str(error)) from None
    if not read:
        raise UserError("is empty: it must start with a header such as time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz")
    (_, header), *lines = read
    where, scale, second = _columns(header, units, dict(columns))
    rows: list[Row] = []
    for line, cells in lines:
        try:
            rows.append(_row(line, cells, where, scale, rows[-1] if rows else None))
        except ValueError as error:
            wrong.append((line, str(error)))
    if wrong:
        raise UserError(csv_table.few([f"line {line}: {said}" for line, said in sorted(wrong)]))
    if not rows:
        raise UserError("holds no pose below its header: a row for each is needed")
    numbers, times, bodies, sensors, forces, held, *more = (list(column) for column in zip(*rows, strict=True))
    each = zip(numbers, times, _stacked(bodies), _stacked(sensors), forces, _stacked(held), *more, strict=True)
    found = tuple(TimedPose(number, second * time, *others) for number, time, *others in each)
    return PoseTable(hashlib.sha256(raw).hexdigest(), found)


def _stacked(places: "list[Placed | None]") -> "list[ndarray | None]":
    """Poses (4, 4), None where there is none."""
    known = [place for place in places if place is not None]
    found = iter(matrices(*map(list, zip(*known, strict=True))) if known else ())
    return [None if place is None else next(found) for place in places]


def _columns(header: list[str], units: str | None, columns: Mapping[str, str]) -> tuple[dict[str, int], float, float]:
    """The index of each column, and the factors from the file's units to mm and s."""
    where: dict[str, int] = {}
    said: dict[str, str] = {}  # column -> unit in its name
    titles = {title: column for column, title in columns.items()}
    shown = f"(its header: {','.join(header)})"
    if len(header) == 1:
        raise UserError(f"has one column: commas must separate its cells {shown}")
    for i, title in enumerate(header):
        name = ".".join(re.split(r"[./]", title.lower())[-2:])
        stem, _, suffix = name.rpartition("_")
        for column, names in COLUMN_TITLES.items():
            known = UNIT_SUFFIXES.get(column, {})
            bare, unit_said = (stem, suffix) if stem and suffix in known else (name, "")
            if titles.get(title) == column or (column not in columns and bare in names):
                if column in where:
                    both = f"{header[where[column]]} and {title}"
                    raise UserError(f"the columns {both} are both {column}: name one under columns")
                where[column], said[column] = i, unit_said or ("ns" if bare == "%time" else "")
    wrong = []
    if lost := [title for title, column in titles.items() if column not in where]:
        wrong.append(f"has no column {', '.join(lost)}, which columns names {shown}")
    groups = [group for group in (SENSOR_COLUMNS, OBJECT_COLUMNS) if {*where, *columns}.intersection(group)]
    needed = ("time", *BODY_COLUMNS, *itertools.chain(*groups))
    if missing := [column for column in needed if column not in {*where, *columns}]:
        wrong.append(f"has no column {', '.join(missing)}: name it under columns {shown}")
    lengths = {said.get(axis) or units or "" for axis in LENGTH_COLUMNS if axis in {*needed, *where}}
    if lengths == {""}:
        wrong.append(f"does not say whether x, y and z are in mm or m: add units: m, or units: mm {shown}")
    if wrong:
        raise UserError(wrong)
    if len(lengths) > 1 or (units and lengths != {units}):
        raise UserError(
            f"x, y and z must be in one unit (header: {','.join(header)}; units: {units or 'not given'}):"
            " leave units out, or name the columns alike"
        )
    return where, MM_PER_UNIT[lengths.pop()], SECONDS_PER_UNIT[said["time"] or "s"]


def _row(line: int, cells: list[str], where: dict[str, int], scale: float, before: Row | None) -> Row:
    """The numbers of one row. Raises ValueError with a message for people."""
    value = {column: csv_table.number(cells[i]) for column, i in where.items()}
    for column, number in value.items():
        if math.isnan(number) and column not in OPTIONAL_CELLS:
            raise ValueError(f"{column} must be a number (got {cells[where[column]]!r})")
    if before is not None and value["time"] <= before[1]:
        raise ValueError(f"time must increase (got {value['time']:.15g} after {before[1]:.15g}): sort the rows")
    groups = (BODY_COLUMNS, SENSOR_COLUMNS, FORCE_COLUMNS, OBJECT_COLUMNS)
    body, sensor, force, held = (tuple(value[c] for c in group if c in value) for group in groups)
    if any(map(math.isnan, held)):
        held = ()

    def placed(pose: tuple[float, ...]) -> Placed:
        x, y, z, *turn = pose
        return (scale * x, scale * y, scale * z), unit((turn[0], turn[1], turn[2], turn[3]))

    pushed = (force[0], force[1], force[2]) if len(force) == len(FORCE_COLUMNS) else None
    places = placed(body), placed(sensor) if sensor else None, pushed, placed(held) if held else None
    return line, value["time"], *places, value.get("grip", math.nan), scale * value.get("width", math.nan)
