"""Where a trajectory takes the indenter, a pose a frame: what a recipe is checked by, and what is then computed."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tacgen.geometry.analytic_sdf import lowest
from tacgen.geometry.pose import about
from tacgen.recipe.pose_table import Pose
from tacgen.recipe.trajectory import Press, Release, Replay, Segment, Slide, Start, Tilt, Twist
from tacgen.recipe.yaml_source import KeyPath

Array = np.ndarray
FORCE_DEPTH = 0.8  # deepest press in the search for a force, over the gel's thickness [-]
GUESSED_DEPTH = 0.1  # first press in the search for a force, over the gel's thickness [-]
FLANK = "the indenter's flank would meet the gel before its tip"
BASE = "the indenter's lowest point, at z = {:.4g} mm, would be at the base of the gel, or below"
EDGE = "would turn the indenter's edge to the base of the gel, or below"
Z = np.array([0.0, 0.0, 1.0])


class TrajectoryError(Exception):
    """A trajectory that cannot be followed: where the recipe asks for that, and why, a line each."""

    def __init__(self, where: KeyPath, *lines: str) -> None:
        super().__init__(*lines)
        self.where, self.lines = where, lines


class Frame(NamedTuple):
    """One frame: its pose (4, 4), the rotation vector (3,) from the pose before it [rad], None for the shorter way, and
    how its height follows from a force: see Forced in scene.path."""

    pose: Array
    turn: Array | None = None
    asked: float = np.nan
    part: float = 1.0
    carry: float = 0.0
    floor: float = np.nan
    below: float = np.nan


def _level(angle_deg: float) -> Array:
    """Unit vector (3,) in the plane of the gel, from x towards y."""
    return np.array([np.cos(a := np.radians(angle_deg)), np.sin(a), 0.0])


@dataclass
class Walk:
    """The state of a trajectory between two frames.

    support: how far the indenter extends along a unit vector (3,) of its own frame [mm]; contact: height of its origin
    at which it first touches the untouched face, turned and placed as a pose (4, 4) says [mm]; thickness: of the gel
    [mm]; home: the height that a release goes back to [mm]; carry: see Forced in scene.path.
    """

    support: Callable[[Array], float]
    contact: Callable[[Array], float]
    thickness: float
    pose: Array
    home: float
    carry: float = 0.0

    @classmethod
    def at_start(
        cls,
        start: Start,
        rows: Sequence[Pose],
        support: Callable[[Array], float],
        contact: Callable[[Array], float],
        thickness: float,
    ) -> "Walk":
        """At the start, or, where a replay comes first, over its first row if that is in the gel and at it otherwise.

        Raises:
            TrajectoryError: the start leans too far.
        """
        if rows:
            pose = rows[0].pose.copy()
            pose[2, 3] = max(pose[2, 3], contact(pose))
            return cls(support, contact, thickness, pose, float(pose[2, 3]))
        pose = np.eye(4)
        tilt = about(_level(start.tilt_axis_deg), float(np.radians(start.tilt_deg)))
        pose[:3, :3] = tilt @ about(Z, float(np.radians(start.yaw_deg)))
        pose[:2, 3] = start.x_mm, start.y_mm
        if math.isinf(support(-pose[2, :3])):
            raise TrajectoryError(("start", "tilt_deg"), FLANK)
        pose[2, 3] = start.clearance_mm + contact(pose)
        return cls(support, contact, thickness, pose, float(pose[2, 3]))

    def frames(
        self, segment: Segment, rows: Sequence[Pose], where: KeyPath, *, checking: bool = False
    ) -> Iterator[Frame]:
        """The frames of one segment, at `where` in the recipe; `rows` are those of a replay.

        `checking` leaves out those on a straight way that cannot be wrong if the last is not.

        Raises:
            TrajectoryError: the indenter would lean too far, or reach the base of the gel.
        """
        move = segment.move
        if isinstance(move, Replay):
            yield from self._replayed(rows, (*where, "file"), move.file)
            return
        first, first_carry, angle, turn = self.pose, self.carry, 0.0, np.zeros(3)
        pivot = np.zeros(3)  # that a turn leaves where it is, from the indenter's origin
        if isinstance(move, Twist | Tilt):
            angle = float(np.radians(move.angle_deg))
            axis = first[:3, 2] if isinstance(move, Twist) else _level(move.axis_deg)
            turn = axis * angle / move.frames
            if isinstance(move, Tilt):
                pivot = lowest(self.support, first[:3, :3])
        force = getattr(move, "force_n", None)
        contact = self.contact(first) if isinstance(move, Press) or force else np.nan
        floor = contact - FORCE_DEPTH * self.thickness
        straight = checking and not isinstance(move, Twist | Tilt)
        for k in range(move.frames if straight else 1, move.frames + 1):
            part, asked, below, new = k / move.frames, np.nan, np.nan, first.copy()
            match move:
                case Press() if force:
                    new[2, 3] = contact - GUESSED_DEPTH * part * self.thickness
                case Press(depth_mm=float(depth)):
                    new[2, 3] += part * (contact - depth - first[2, 3])
                    self.carry = (1 - part) * first_carry
                case Release():
                    new[2, 3] += part * (self.home - first[2, 3])
                    self.carry = (1 - part) * first_carry
                case Slide(x_mm=x, y_mm=y):
                    new[:2, 3] += part * x, part * y
                case Twist() | Tilt():
                    turned = about(axis, part * angle)
                    new[:3, :3] = turned @ first[:3, :3]
                    new[:3, 3] = first[:3, 3] + pivot - turned @ pivot
            if force:
                asked, self.carry, below = force, 1.0, new[2, 3] - floor
            self.pose = new
            if isinstance(move, Twist | Tilt) and (wrong := self._why_impossible(EDGE)):
                raise TrajectoryError((*where, "angle_deg"), wrong)
            yield Frame(new, turn, asked, part, self.carry, floor, below)

    def _replayed(self, rows: Sequence[Pose], where: KeyPath, name: str) -> Iterator[Frame]:
        """Frames at the rows of a table; no height found before is carried into them."""
        self.carry = 0.0
        for row in rows:
            self.pose = row.pose
            if wrong := self._why_impossible(BASE):
                raise TrajectoryError(where, f"{name}: line {row.line}: {wrong}")
            yield Frame(row.pose)
        self.home = max(self.home, self.contact(self.pose))

    @property
    def low(self) -> float:
        """z of the indenter's lowest point [mm]; -inf where it leans so far that it has none."""
        return float(self.pose[2, 3] - self.support(-self.pose[2, :3]))

    def _why_impossible(self, at_base: str) -> str | None:
        """Why the indenter cannot be where it is, if so: `at_base` where its lowest point would be at the base."""
        if math.isinf(low := self.low):
            return FLANK
        return at_base.format(low) if low <= -self.thickness else None
