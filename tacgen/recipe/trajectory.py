"""The model of a trajectory: its start, and the movements of the indenter. Lengths in mm, angles in degrees."""

import math
from functools import cached_property
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from tacgen.sensor.base_model import ONE_KEY, FilePath, Part, Positive, Sha256, exactly_one

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # w, x, y, z
QUATERNION_TOL = 1e-3  # largest error of a quaternion's length, which tables write with few digits [-]
QUATERNION_ROUNDING = 1e-12  # error of the length up to which a quaternion is not normalised again [-]
Column = Literal[
    "time", "x", "y", "z", "qw", "qx", "qy", "qz",
    "sensor_x", "sensor_y", "sensor_z", "sensor_qw", "sensor_qx", "sensor_qy", "sensor_qz",
    "force_x", "force_y", "force_z",
    "object_x", "object_y", "object_z", "object_qw", "object_qx", "object_qy", "object_qz",
    "grip", "width",
]  # fmt: skip
Frames = Annotated[int, Field(ge=1, le=10_000)]


class Start(Part):
    """Pose of the indenter before it moves: its lowest point is `clearance_mm` above the untouched face."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    clearance_mm: float = 0.0
    yaw_deg: float = 0.0
    tilt_deg: Annotated[float, Field(ge=0, lt=90)] = 0.0
    tilt_axis_deg: float = 0.0

    @field_validator("clearance_mm")
    @classmethod
    def _outside(cls, value: float) -> float:
        if value < 0:
            raise ValueError(f"must be at least 0 (got {value:g}): the indenter would start inside the gel")
        return value


class Timed(Part):
    """A movement of `frames` frames, which together take `duration_s`."""

    frames: Frames
    duration_s: Positive | None = None

    def seconds(self, way_mm: float) -> float | None:
        """Duration of a movement over a distance `way_mm`; None if none is given."""
        return self.duration_s


class Paced(Timed):
    """A movement whose duration may be given as a speed."""

    speed_mm_s: Positive | None = None

    @model_validator(mode="after")
    def _either(self) -> Self:
        if self.duration_s is not None and self.speed_mm_s is not None:
            raise ValueError("must hold at most one of duration_s, speed_mm_s")
        return self

    def seconds(self, way_mm: float) -> float | None:
        return self.duration_s if self.speed_mm_s is None else way_mm / self.speed_mm_s


class Press(Paced):
    """Move along z to `depth_mm` below first touch of the untouched face, or until the normal force is `force_n`.

    First touch is found for the actual shapes, also on a dome. With a force, the frames are equal steps of the normal
    force, from the force before to `force_n`.
    """

    depth_mm: Positive | None = None
    force_n: Positive | None = None

    _one = exactly_one("one aim", "depth_mm", "force_n")


class Slide(Paced):
    """Move sideways by this distance at constant height or, with `force_n`, at this normal force, which is reached in
    equal steps from the force before."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    force_n: Positive | None = None


class Twist(Timed):
    """Rotate about the indenter's own axis by this angle, at constant height or, with `force_n`, as in a slide."""

    angle_deg: float
    force_n: Positive | None = None


class Tilt(Timed):
    """Rotate about a horizontal axis through the point of the indenter that is lowest at the start; the axis is
    `axis_deg` from x towards y."""

    angle_deg: Annotated[float, Field(gt=-90, lt=90)]
    axis_deg: float = 0.0


def unit(q: Quaternion) -> Quaternion:
    """The quaternion normalised to length 1. Raises ValueError: its length differs from 1 by more than rounding."""
    length = math.hypot(*q)
    if abs(length - 1) > QUATERNION_TOL:
        raise ValueError(f"a quaternion must be of length 1 (got {length:.4g})")
    if abs(length - 1) < QUATERNION_ROUNDING:
        return q  # so that reading what was written changes no digit
    w, x, y, z = q
    return w / length, x / length, y / length, z / length


class Placement(Part):
    """Pose of one frame in another: position of its origin, and rotation as a unit quaternion w, x, y, z."""

    position_mm: Vector = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)

    @field_validator("quaternion")
    @classmethod
    def _unit(cls, value: Quaternion) -> Quaternion:
        return unit(value)


class Replay(Part):
    """Follow the poses of a table, one frame a row: the pose of the indenter's frame in the sensor's frame.

    The table is CSV with a header: time_s, x_mm, y_mm, z_mm (or x_m, ...), qw, qx, qy, qz. If the rows are in another
    frame than the sensor's, give `sensor_pose`; if they are poses of another body than the indenter, `indenter_pose`.
    If the sensor moves, the table has its pose as well: sensor_x_mm, ..., sensor_qw, ...

    With `match: force` the object is moved along the sensor's z until the normal force is that of the row (force_x_n,
    ...: on the gel, in the table's frame). With `match: grip` the rows are the poses of a grasp's gripper, and each
    finger presses with grip_n or, where that is empty, the faces are width_mm apart; object_x_mm, ..., object_qw, ...
    are the object's pose.
    """

    file: FilePath
    units: Literal["mm", "m"] | None = None  # of x, y, z, where the header does not say
    columns: dict[Column, str] | None = None  # titles of the table's columns, where they are not the usual ones
    # pose of the sensor in the frame of the rows; where these have the pose of the sensor's body, in the body's frame
    sensor_pose: Placement = Placement()
    indenter_pose: Placement = Placement()  # pose of the indenter in the frame of the body that was recorded
    every: Annotated[int, Field(ge=1)] = 1  # take every n-th row, from the first
    frames: Frames | None = None  # number of frames; None: up to the table's end
    match: Literal["pose", "force", "grip"] | None = None  # what of the table is met exactly; None: pose
    filter_rows: Annotated[int, Field(ge=1)] | None = None  # forces are medians over so many rows; None: of 3
    sha256: Sha256 | None = None

    @model_validator(mode="after")
    def _filtered(self) -> Self:
        if self.filter_rows is not None and not self.matched:
            raise ValueError("filter_rows has no effect without match: force or grip: leave it out")
        if (self.filter_rows or 1) % 2 == 0:
            raise ValueError(f"filter_rows must be odd, so that a row is in the middle (got {self.filter_rows})")
        return self

    @property
    def matched(self) -> bool:
        """Whether forces of the table are met, not its poses."""
        return self.match in ("force", "grip")


class Hold(Timed):
    """Stay at the same pose."""


class Close(Timed):
    """In a grasp: close or open the fingers until their untouched faces are `width_mm` apart, or until each presses
    with `force_n`."""

    width_mm: Positive | None = None
    force_n: Positive | None = None

    _one = exactly_one("one aim", "width_mm", "force_n")


class Lift(Timed):
    """In a grasp: lift the gripper against gravity, or lower it."""

    height_mm: float


class Release(Paced):
    """Lift the indenter back to the height of the start."""


Move = Press | Slide | Twist | Tilt | Replay | Hold | Release | Close | Lift


class Segment(Part, json_schema_extra=ONE_KEY):
    """One step of the trajectory: `press: {depth_mm: 1, frames: 5}` and the like."""

    press: Press | None = None
    slide: Slide | None = None
    twist: Twist | None = None
    tilt: Tilt | None = None
    replay: Replay | None = None
    hold: Hold | None = None
    release: Release | None = None
    close: Close | None = None
    lift: Lift | None = None

    _one = exactly_one("one movement")

    @cached_property
    def kind(self) -> str:
        """press, slide, twist, tilt, replay, hold or release; in a grasp also close or lift."""
        return next(name for name in type(self).model_fields if getattr(self, name) is not None)

    @property
    def move(self) -> Move:
        """The movement that is given."""
        movement: Move = getattr(self, self.kind)
        return movement

    @property
    def frames(self) -> int:
        """Number of frames."""
        assert self.move.frames is not None, "only a plan knows how many rows a table has"
        return self.move.frames
