"""The contact log of another simulator: poses of object and sensor over time, and the force that it reported."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tacgen.base.errors import UserError
from tacgen.recipe import pose_table
from tacgen.recipe.trajectory import Column
from tacgen.replay.layouts import LOG_LAYOUTS

Array = np.ndarray
QUATERNION_ORDERS = {"wxyz": [0, 1, 2, 3], "xyzw": [3, 0, 1, 2]}  # columns of w x y z
FORCE_BODIES, FORCE_FRAMES = ("sensor", "object"), ("world", "sensor")


@dataclass(frozen=True)
class Conventions:
    """How to read a log; empty where the file or its layout says it."""

    layout: str = "tacgen"  # a name of LOG_LAYOUTS
    quaternion: str = ""  # wxyz or xyzw
    units: str = ""  # of lengths: m or mm
    force_on: str = "sensor"  # or object
    force_frame: str = "world"  # or sensor: the axes of the recorded sensor body
    group: str = "/"  # of an HDF5 file
    columns: Mapping[Column, str] | None = None  # titles of a CSV file's columns

    def __post_init__(self) -> None:
        for option, value, known in (
            ("--from", self.layout, tuple(LOG_LAYOUTS)),
            ("--quaternion", self.quaternion, ("", *QUATERNION_ORDERS)),
            ("--units", self.units, ("", *pose_table.MM_PER_UNIT)),
            ("--force-on", self.force_on, FORCE_BODIES),
            ("--force-frame", self.force_frame, FORCE_FRAMES),
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
    # (n, 3) on the sensor about the origin of its body, world frame [N mm]; None: it is not recorded
    torque: Array | None = None

    def __len__(self) -> int:
        return len(self.row)

    def some(self, which: Array) -> "ContactLog":
        """The rows of these places."""
        parts = (self.sensor, self.force, self.torque)
        sensor, force, torque = (None if part is None else part[which] for part in parts)
        row, time, body = (part[which] for part in (self.row, self.time, self.body))
        return replace(self, row=row, time=time, body=body, sensor=sensor, force=force, torque=torque)
