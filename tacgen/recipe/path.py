"""The path of an indenter: its pose at every frame, and the frames whose height is solved for from a force."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tacgen.errors import UserError
from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.pose import Pose, shortest_turn
from tacgen.mechanics.scene import Forced
from tacgen.recipe import pose_table
from tacgen.recipe.model import Recipe
from tacgen.recipe.trajectory_poses import PathFrame, TrajectoryError, Walk
from tacgen.sensor.yaml_source import format_path

if TYPE_CHECKING:
    from tacgen.geometry.gel import GelBody

Array = np.ndarray


@dataclass(frozen=True)
class Path:
    """Poses (N, 4, 4) at every frame; rotation vectors (N, 3) [rad] from each pose to the next, which may exceed half a
    turn; segment (N,) of each frame; `forced` frames; and the pose (4, 4) before the first frame, clear of the gel."""

    start: Array
    poses: Array
    turns: Array
    segment: Array
    forced: Forced | None


def _sink_depth(shape: Shape, pose: Array, gel: "GelBody") -> float:
    """Distance along z from a shape that stands on z = 0 to first touch of the untouched face [mm].

    Each iteration lowers it by its distance from the face, which cannot overshoot; the search is repeated around the
    point found, on a grid 20 times as fine.
    """
    if gel.flat:
        return 0.0
    most = -float(gel.top(np.array(gel.width / 2), np.array(gel.height / 2)))  # depth of the face at the corner
    sunk, step, middle, half = 0.0, 0.2, np.zeros(2), np.array([gel.width, gel.height]) / 2
    for _ in range(2):
        ends = zip(middle - half, middle + half, half, strict=True)
        x, y = np.meshgrid(*(np.linspace(low, high, 2 * round(h / step) + 1) for low, high, h in ends))
        here = gel.contains(x, y)
        face = np.column_stack([x[here], y[here], gel.top(x[here], y[here])])
        lowered = pose.copy()
        for _ in range(200):
            lowered[2, 3] = pose[2, 3] - sunk
            gap = shape.value(Pose.of(lowered).local(face))
            nearest = int(np.argmin(gap))
            sunk += gap[nearest]  # on the finer grid this may be slightly negative
            if abs(gap[nearest]) < 1e-6 or sunk > most:
                break
        middle, half, step = face[nearest, :2], np.array([step, step]), step / 20
    return min(float(sunk), most)


def contact_height(shape: Shape, gel: "GelBody", pose: Array) -> float:
    """Height of the indenter's origin at first touch of the untouched face, for this rotation and position [mm]."""
    standing = pose.copy()
    standing[2, 3] = drop = shape.support(-pose[2, :3])  # extent below its own origin
    return drop - _sink_depth(shape, standing, gel)


def indenter_path(
    recipe: Recipe, shape: Shape, gel: "GelBody", replayed: Callable[[int], tuple[pose_table.TimedPose, ...]]
) -> Path:
    """The path of an indenter over a gel; `replayed` gives the rows of a segment's table.

    Raises:
        UserError: a tilted mesh, or an indenter on a dome, would reach the base of the gel.
    """
    rows = [replayed(number) if segment.replay else () for number, segment in enumerate(recipe.trajectory)]
    frames: list[PathFrame] = []
    segments: list[int] = []
    try:
        contact = partial(contact_height, shape, gel)
        walk = Walk.at_start(recipe.start, rows[0], shape.support, contact, gel.thickness)
        start = walk.pose
        for number, segment in enumerate(recipe.trajectory):
            frames += walk.frames(segment, rows[number], ("trajectory", number, segment.kind))
            segments += [number] * (len(frames) - len(segments))
    except TrajectoryError as refused:
        raise UserError(f"{format_path(refused.where)}: {line}" for line in refused.lines) from None
    before = [start, *(frame.pose for frame in frames[:-1])]
    ways = [shortest_turn(a, f.pose) if f.turn is None else f.turn for a, f in zip(before, frames, strict=True)]
    poses, _, *asked_for = zip(*frames, strict=True)
    asked, part, carry, floor, below = (np.array(column) for column in asked_for)
    forced = Forced(asked, part, carry, floor, np.nan_to_num(below)) if np.isfinite(asked).any() else None
    return Path(start, np.array(poses), np.array(ways), np.array(segments), forced)
