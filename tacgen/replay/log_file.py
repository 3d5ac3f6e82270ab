"""Reading of contact logs.

A CSV log is a pose table (see tacgen.recipe.pose_table) with columns of the force; an npz or HDF5_SUFFIXES log has
arrays with the names of a Layout. Both become a ContactLog: mm, s and N, poses in the world frame, the force on the
sensor.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tacgen.base.errors import UserError, printable
from tacgen.recipe import pose_table
from tacgen.replay import array_log
from tacgen.replay.contact_log import ContactLog, Conventions
from tacgen.replay.layouts import LOG_LAYOUTS

TABLE_SUFFIXES, ARCHIVE_SUFFIXES, HDF5_SUFFIXES = (".csv", ".txt"), (".npz",), (".h5", ".hdf5")


def read(path: Path, how: Conventions, environments: Sequence[int] = ()) -> list[ContactLog]:
    """Read a log, or one for each of some environments of a simulator that runs many at once.

    Raises:
        UserError: the file cannot be read, lacks an array, or does not say its units or the order of its quaternions.
    """
    suffix = path.suffix.lower()
    if suffix in TABLE_SUFFIXES:
        if how.quaternion or environments:
            raise UserError(
                f"{path}: is a table, whose columns qw, qx, qy, qz are named: leave --quaternion and --env out"
            )
        return [_oriented(_of_table(path, how), how)]
    if suffix not in (*ARCHIVE_SUFFIXES, *HDF5_SUFFIXES):
        raise UserError(
            f"{path}: is no log: it must be {', '.join((*TABLE_SUFFIXES, *ARCHIVE_SUFFIXES, *HDF5_SUFFIXES))}"
        )
    layout = LOG_LAYOUTS[how.layout]
    arrays = array_log.archive(path, layout) if suffix in ARCHIVE_SUFFIXES else array_log.hdf5(path, how.group, layout)
    many: Sequence[int | None] = environments or [None]
    try:
        return [_oriented(array_log.log_of(_name(path), arrays, how, each), how) for each in many]
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None


def _name(path: Path) -> str:
    """The name of a log, in one line of text."""
    return printable(" ".join(path.stem.split()))


def _of_table(path: Path, how: Conventions) -> ContactLog:
    try:
        rows = pose_table.read(path, how.units or None, how.columns).poses
    except UserError as error:
        raise UserError(f"{path}: {line}" for line in error.lines) from None
    time, poses = (np.array([getattr(row, name) for row in rows]) for name in ("time", "pose"))
    sensors, forces = (
        [here for row in rows if (here := getattr(row, name)) is not None] for name in ("sensor", "force")
    )
    sensor, force = (np.array(known) if known else None for known in (sensors, forces))
    if force is not None and not (numbers := np.isfinite(force).all(1)).all():
        raise UserError(f"{path}: line {rows[int(numbers.argmin())].line}: the force must be numbers")
    return ContactLog(_name(path), np.arange(len(rows)), time, poses, sensor, force, True)


def _oriented(log: ContactLog, how: Conventions) -> ContactLog:
    """A log with its force and torque on the sensor, in the world frame."""
    if log.force is None:
        return log
    parts = [part if part is None or how.force_on == "sensor" else -part for part in (log.force, log.torque)]
    if how.force_frame == "sensor":
        if log.sensor is None:
            raise UserError(f"{log.name}: --force-frame sensor: the log has no pose of the sensor to turn forces by")
        turn = log.sensor[:, :3, :3]
        parts = [None if part is None else np.einsum("nij,nj->ni", turn, part) for part in parts]
    return replace(log, force=parts[0], torque=parts[1])
