"""The poses of the indenter along a trajectory, one a frame: used to check a recipe and to compute its scenes."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tacgen.geometry.analytic_sdf import lowest
from tacgen.geometry.first_touch import MAX_GRID_ERROR_MM
from tacgen.geometry.pose import about
from tacgen.mechanics.scene import MAX_FORCE_SEARCH_DEPTH, Wanted
from tacgen.recipe.matching import MIN_MATCHED_FORCE_N
from tacgen.recipe.pose_table import TimedPose
from tacgen.recipe.trajectory import Press, Release, Replay, Segment, Slide, Start, Tilt, Twist
from tacgen.sensor.yaml_source import KeyPath

Array = np.ndarray
FIRST_DEPTH_RATIO = 0.1  # first guess of the depth in the search for a force, over the gel's thickness [-]
FLANK_MESSAGE = "the indenter's flank would meet the gel before its tip"
BASE_MESSAGE = "the indenter's lowest point, at z = {:.4g} mm, would be at the base of the gel, or below"
BESIDE_MESSAGE = "nothing of the indenter is over the gel, so that it would never touch it"
NO_FORCE_MESSAGE = "the table has no force here: the object is where it says, moved as in the row before"
EDGE_MESSAGE = "would turn the indenter's edge to the base of the gel, or below"
Z_AXIS = np.array([0.0, 0.0, 1.0])


class TrajectoryError(Exception):
    """A trajectory that cannot be followed: the place in the recipe, and the reasons, one a line."""

    def __init__(self, where: KeyPath, *lines: str) -> None:
        super().__init__(*lines)
        self.where, self.lines = where, lines


class PathFrame(NamedTuple):
    """One frame: its pose (4, 4); the rotation vector (3,) [rad] from the pose before it, None for the shortest
    rotation; how its height follows from a force, see Forced in scene.path; and what a matched table wants there."""

    pose: Array
    turn: Array | None = None
    asked: float = np.nan
    part: float = 1.0
    carry: float = 0.0
    floor: float = np.nan
    below: float = np.nan
    wanted: Wanted | None = None


def _level(angle_deg: float) -> Array:
    """Unit vector (3,) in the plane of the gel, from x towards y."""
    return np.array([np.cos(a := np.radians(angle_deg)), np.sin(a), 0.0])


@dataclass
class Walk:
    """The state of a trajectory between two frames.

    support: the indenter's support function of a unit vector (3,) in its own frame [mm]; contact: height of its origin
    at first touch of the untouched face, for the rotation and place of a pose (4, 4) [mm], -inf if it is beside it;
    over: z of its lowest point over the gel's outline at a pose [mm]; thickness of the gel [mm]; start: pose before the
    first movement; home: height to which a release returns [mm]; carry: see Forced in scene.path.
    """

    support: Callable[[Array], float]
    contact: Callable[[Array], float]
    over: Callable[[Array], float]
    thickness: float
    start: Array
    pose: Array
    home: float
    carry: float = 0.0

    @classmethod
    def at_start(
        cls,
        start: Start,
        rows: Sequence[TimedPose],
        support: Callable[[Array], float],
        contact: Callable[[Array], float],
        over: Callable[[Array], float],
        thickness: float,
    ) -> "Walk":
        """The start; if a replay comes first, the pose of its first row, lifted to first touch if it is in the gel.

        Raises:
            TrajectoryError: the indenter is tilted too far at the start.
        """
        if rows:
            pose = rows[0].pose.copy()
            pose[2, 3] = max(pose[2, 3], contact(pose))
            return cls(support, contact, over, thickness, pose, pose, float(pose[2, 3]))
        pose = np.eye(4)
        tilt = about(_level(start.tilt_axis_deg), float(np.radians(start.tilt_deg)))
        pose[:3, :3] = tilt @ about(Z_AXIS, float(np.radians(start.yaw_deg)))
        pose[:2, 3] = start.x_mm, start.y_mm
        if math.isinf(stands := support(-pose[2, :3])):
            raise TrajectoryError(("start", "tilt_deg"), FLANK_MESSAGE)
        pose[2, 3] = start.clearance_mm + (touches if math.isfinite(touches := contact(pose)) else stands)
        return cls(support, contact, over, thickness, pose, pose, float(pose[2, 3]))

    def frames(
        self, segment: Segment, rows: Sequence[TimedPose], where: KeyPath, *, checking: bool = False
    ) -> Iterator[PathFrame]:
        """The frames of one segment, which stands at `where` in the recipe; `rows` are those of a replay.

        With `checking`, a straight movement gives its last frame alone: if that is possible, all before it are.

        Raises:
            TrajectoryError: the indenter would tilt too far, or reach the base of the gel.
        """
        move = segment.move
        if isinstance(move, Replay):
            yield from self._replayed(rows, (*where, "file"), move)
            return
        first, first_carry, angle, turn = self.pose, self.carry, 0.0, np.zeros(3)
        pivot = np.zeros(3)  # fixed point of a rotation, relative to the indenter's origin
        if isinstance(move, Twist | Tilt):
            angle = float(np.radians(move.angle_deg))
            axis = first[:3, 2] if isinstance(move, Twist) else _level(move.axis_deg)
            turn = axis * angle / move.frames
            if isinstance(move, Tilt):
                pivot = first[:3, :3] @ self.pivot
        force = getattr(move, "force_n", None)
        contact = self.contact(first) if isinstance(move, Press) or force else np.nan
        if math.isinf(contact):
            raise TrajectoryError(where, BESIDE_MESSAGE)
        floor = contact - MAX_FORCE_SEARCH_DEPTH * self.thickness
        straight = checking and not isinstance(move, Twist | Tilt)
        for k in range(move.frames if straight else 1, move.frames + 1):
            part, asked, below, new = k / move.frames, np.nan, np.nan, first.copy()
            match move:
                case Press() if force:
                    new[2, 3] = contact - FIRST_DEPTH_RATIO * part * self.thickness
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
            if isinstance(move, Twist | Tilt) and (wrong := self._why_impossible(EDGE_MESSAGE)):
                raise TrajectoryError((*where, "angle_deg"), wrong)
            yield PathFrame(new, turn, asked, part, self.carry, floor, below)

    def _replayed(self, rows: Sequence[TimedPose], where: KeyPath, move: Replay) -> Iterator[PathFrame]:
        """Frames at the rows of a table; heights that were found from a force before do not change them."""
        self.carry = 0.0
        for row in rows:
            self.pose = row.pose
            matched = move.match == "force" and not math.isnan(row.normal)
            wrong = self._why_impossible(BASE_MESSAGE)
            if wrong and not (matched and math.isfinite(self.low)):
                raise TrajectoryError(where, f"{move.file}: line {row.line}: {wrong}")
            if matched:
                yield self._matched(row)
            elif move.match == "force":
                self.carry = 1.0
                yield PathFrame(row.pose, carry=1.0, wanted=Wanted(row.pose, note=NO_FORCE_MESSAGE))
            else:
                yield PathFrame(row.pose)
        self.home = max(self.home, self.contact(self.pose))

    def _matched(self, row: TimedPose) -> PathFrame:
        """The frame of a row with a force, at the row's pose as a first guess. Without a force there is no contact: the
        object is lifted to first touch of the untouched face, or left where it is if it does not touch."""
        contact, wanted, self.carry = self.contact(row.pose), Wanted(row.pose, row.normal), 0.0
        none, beside = row.normal < MIN_MATCHED_FORCE_N, math.isinf(contact)
        if not (none or beside):
            floor, self.carry = contact - MAX_FORCE_SEARCH_DEPTH * self.thickness, 1.0
            below = max(row.pose[2, 3], contact) - floor
            return PathFrame(row.pose, None, row.normal, 1.0, 1.0, floor, below, wanted)
        self.pose = row.pose.copy()
        self.pose[2, 3] = max(row.pose[2, 3], self.support(-row.pose[2, :3]) if beside else contact)
        return PathFrame(self.pose, wanted=wanted if none else wanted._replace(note=BESIDE_MESSAGE))

    @cached_property
    def pivot(self) -> Array:
        """The point (3,) of the indenter, in its own frame, that is lowest at the start [mm].

        Tilts turn about it wherever it has moved since: about the point that is lowest before each of them, a tilt and
        its inverse would be turns about two points, and would not return. If it is beside the gel, they turn about the
        point on the axis at the height of the lowest one over the gel.
        """
        rotation, z = self.start[:3, :3], float(self.start[2, 3])
        if math.isfinite(over := self.over(self.start)) and over > z - self.support(-rotation[2]) + MAX_GRID_ERROR_MM:
            return np.asarray(rotation.T @ [0.0, 0.0, over - z])
        return np.asarray(rotation.T @ lowest(self.support, rotation))

    @property
    def low(self) -> float:
        """z of the indenter's lowest point [mm]; -inf if it is tilted so far that it has none."""
        return float(self.pose[2, 3] - self.support(-self.pose[2, :3]))

    def _why_impossible(self, at_base: str) -> str | None:
        """Why the pose is impossible, or None; `at_base` is the message for a lowest point at the base of the gel."""
        if math.isinf(low := self.low):
            return FLANK_MESSAGE
        at_base_there = low <= -self.thickness and self.over(self.pose) <= -self.thickness
        return at_base.format(low) if at_base_there else None
