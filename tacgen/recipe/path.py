"""The path of an indenter: its pose at every frame, and the frames whose height is solved for from a force."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tacgen.base.errors import UserError
from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.first_touch import MAX_GRID_ERROR_MM, contact_height, least_over, lowest_over
from tacgen.geometry.pose import shortest_turn
from tacgen.mechanics.scene import Forced, Match
from tacgen.recipe import pose_table
from tacgen.recipe.model import Recipe
from tacgen.recipe.trajectory_poses import PathFrame, TrajectoryError, Walk
from tacgen.sensor.yaml_source import format_path

if TYPE_CHECKING:
    from tacgen.geometry.gel import GelBody
    from tacgen.geometry.mesh_file import SolidMesh
    from tacgen.geometry.outline import Pad

Array = np.ndarray


@dataclass(frozen=True)
class Path:
    """Poses (N, 4, 4) at every frame; rotation vectors (N, 3) [rad] from each pose to the next, which may exceed half a
    turn; segment (N,) of each frame; `forced` frames; those that `match` a table; and the pose (4, 4) before the first
    frame, clear of the gel."""

    start: Array
    poses: Array
    turns: Array
    segment: Array
    forced: Forced | None
    match: Match | None


def sunk_beside(
    recipe: Recipe, solid: "SolidMesh", pad: "Pad", replayed: Callable[[int], tuple[pose_table.TimedPose, ...]]
) -> float:
    """Largest height of an upright solid's lowest point over the pad above its lowest point, along a path [mm]."""
    rows = [replayed(number) if segment.replay else () for number, segment in enumerate(recipe.trajectory)]
    walk = Walk.at_start(recipe.start, rows[0], *(lambda _: 0.0,) * 3, thickness=1.0)  # heights do not matter
    poses = [walk.pose]
    for number, segment in enumerate(recipe.trajectory):
        poses += [frame.pose for frame in walk.frames(segment, rows[number], ("trajectory", number))]
    foot, deepest = solid.vertices[solid.vertices[:, 2] < MAX_GRID_ERROR_MM], 0.0
    for pose in poses:
        if not pad.contains(*(foot @ pose[:3, :3].T + pose[:3, 3])[:, :2].T).any():
            least = least_over(solid.vertices, solid.triangles, pad, pose) - pose[2, 3]
            deepest = max(deepest, least if np.isfinite(least) else 0.0)
    return float(deepest)


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
        contact, over = (partial(height, shape, gel) for height in (contact_height, lowest_over))
        walk = Walk.at_start(recipe.start, rows[0], shape.support, contact, over, gel.thickness)
        start = walk.pose
        for number, segment in enumerate(recipe.trajectory):
            frames += walk.frames(segment, rows[number], ("trajectory", number, segment.kind))
            segments += [number] * (len(frames) - len(segments))
    except TrajectoryError as refused:
        raise UserError(f"{format_path(refused.where)}: {line}" for line in refused.lines) from None
    before = [start, *(frame.pose for frame in frames[:-1])]
    ways = [shortest_turn(a, f.pose) if f.turn is None else f.turn for a, f in zip(before, frames, strict=True)]
    poses, _, *asked_for, wanted = zip(*frames, strict=True)
    asked, part, carry, floor, below = (np.array(column) for column in asked_for)
    forced = Forced(asked, part, carry, floor, np.nan_to_num(below)) if np.isfinite(asked).any() else None
    return Path(start, np.array(poses), np.array(ways), np.array(segments), forced, Match.of(wanted))
