"""Checks of a trajectory: impossible movements are found before anything is computed."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tacgen.base.errors import UserError
from tacgen.recipe import assets, matching, pose_table
from tacgen.recipe.indenters import analytic
from tacgen.recipe.model import Recipe
from tacgen.recipe.pose_table import TimedPose
from tacgen.recipe.trajectory import Press, Replay, Slide, Start
from tacgen.sensor.model import Gel
from tacgen.sensor.validation_messages import Issue
from tacgen.sensor.yaml_source import KeyPath

if TYPE_CHECKING:
    from numpy import ndarray as Array

MAX_SEGMENT_FRAMES = 10_000  # of a segment
Folders = Mapping[KeyPath, Path]  # place in the recipe that names a file -> folder to which its path is relative


def replayed(move: Replay, folder: Path | None) -> tuple[TimedPose, ...]:
    """The poses of a replay, one a frame: the indenter in the sensor's frame; with the forces to match, if any are.

    Raises:
        UserError: the table cannot be used, or its hash is not the expected one; lines start with its name.
    """
    path = assets.beside(move.file, folder)
    try:
        table = pose_table.read(path, move.units, move.columns)
    except UserError as error:
        raise UserError(f"{move.file}: {line}" for line in error.lines) from None
    if move.sha256 not in (None, table.sha256):
        raise UserError(f"{move.file}: {assets.changed(table.sha256)}")
    rows = table.poses
    if move.matched:
        forces = matching.asked(rows, move).tolist()
        rows = tuple(row._replace(normal=force) for row, force in zip(rows, forces, strict=True))
    rows = rows[:: move.every][: move.frames]
    given = f"{move.file}: gives {len(rows)} frames"
    if len(rows) > MAX_SEGMENT_FRAMES:
        raise UserError(f"{given}, at most {MAX_SEGMENT_FRAMES} can be: thin it out by `every`")
    if len(rows) < (move.frames or 0):
        raise UserError(f"{given}, and {move.frames} are asked for: leave frames out, or as many")
    poses = pose_table.relative(rows, move.sensor_pose, move.indenter_pose)
    held = [row._replace(pose=row.held) for row in rows if row.held is not None]
    each = iter(pose_table.relative(held, move.sensor_pose) if held else ())
    return tuple(
        row._replace(pose=pose, sensor=None, held=None if row.held is None else next(each))
        for row, pose in zip(rows, poses, strict=True)
    )


def on_pad(gel: Gel, x_mm: float, y_mm: float) -> bool:
    """Whether a point of the plane lies inside the pad's outline, or on it."""
    return bool(gel.pad.contains(x_mm, y_mm, slack=1e-9 * gel.width_mm))


def problems(recipe: Recipe, gel: Gel, folders: Folders) -> list[Issue]:
    """The first movement that is impossible on this gel.

    Heights that follow from a force, domed faces and tilted meshes are checked later, by scene.path.
    """
    from tacgen.recipe.trajectory_poses import TrajectoryError

    if recipe.trajectory[0].replay and recipe.start != Start():
        text = "has no effect before a replay, which begins over its first row: leave it out"
        return [Issue(("start",), text, at_key=True)]
    try:
        _walk(recipe, gel, folders)
    except TrajectoryError as refused:
        return [Issue(refused.where, line) for line in refused.lines]
    return []


def _walk(recipe: Recipe, gel: Gel, folders: Folders) -> None:
    """Follow the trajectory over a flat face. Raises TrajectoryError."""
    import numpy as np

    from tacgen.geometry.analytic_sdf import lowest
    from tacgen.geometry.first_touch import contact_height
    from tacgen.recipe.trajectory_poses import TrajectoryError, Walk

    def rows(i: int) -> tuple[TimedPose, ...]:
        replay = recipe.trajectory[i].replay
        if replay is None:
            return ()
        where: KeyPath = ("trajectory", i, "replay", "file")
        try:
            found = replayed(replay, folders.get(where))
        except UserError as error:
            raise TrajectoryError(where, *error.lines) from None
        if replay.match == "force" and (why := matching.lacks(found, replay)):
            raise TrajectoryError(("trajectory", i, "replay", "match"), why)
        return found

    def beside(point: "Array") -> bool:
        x, y = point[:2].tolist()  # nan for a tilted mesh: its file is not read here
        return math.isfinite(x) and not on_pad(gel, x, y)

    def lowest_point(pose: "Array") -> "Array":
        """The lowest point of an indenter that may be turned any way: a ball that rolls touches below its centre."""
        return np.asarray(pose[:3, 3] + lowest(support, pose[:3, :3]))

    pad = f"the pad of {gel.width_mm:g} x {gel.height_mm:g} mm"
    start, shape, thickness = recipe.start, analytic(recipe.indenter), gel.thickness_mm
    if not on_pad(gel, start.x_mm, start.y_mm):
        path: KeyPath = ("start", "x_mm" if abs(start.x_mm) > gel.width_mm / 2 else "y_mm")
        if abs(start.x_mm) <= gel.width_mm / 2 and abs(start.y_mm) <= gel.height_mm / 2:
            path = ("start",)  # in a rounded corner: neither coordinate alone is wrong
        raise TrajectoryError(path, f"the indenter would start beside {pad}, at ({start.x_mm:g}, {start.y_mm:g})")
    support = shape.support if shape else _unknown_support
    table, level = rows(0), replace(gel.pad, radii=(np.inf, np.inf))

    def contact(pose: "Array") -> float:
        return contact_height(shape, level, pose) if shape else support(-pose[2, :3])

    walk = Walk.at_start(start, table, support, contact, lambda pose: float(pose[2, 3]) - contact(pose), thickness)
    for i, segment in enumerate(recipe.trajectory):
        move, where = segment.move, ("trajectory", i, segment.kind)
        if isinstance(move, Press) and (move.depth_mm or 0.0) >= thickness:
            return  # recipe_problems says so
        table = rows(i) if i else table
        for k, frame in enumerate(walk.frames(segment, table, where, checking=True)):
            # a mesh may be longer than the pad: its middle says nothing of where it touches
            followed = isinstance(move, Replay) and move.match != "force"
            if followed and shape and walk.low < 0 and beside(point := lowest_point(frame.pose)):
                place = ", ".join(f"{c:.4g}" for c in point + 0.0)
                text = f"at ({place}) the indenter would be beside {pad} and below its face: move it in, or up"
                assert isinstance(move, Replay)
                raise TrajectoryError((*where, "file"), f"{move.file}: line {table[k].line}: {text}")
        if isinstance(move, Slide) and beside(walk.pose[:, 3]):
            x, y = walk.pose[:2, 3]
            raise TrajectoryError(where, f"would carry the indenter's axis off {pad}, to ({x:g}, {y:g})")


def _unknown_support(direction: "Array") -> float:
    """Support function [mm] of a mesh whose file is not read yet: known for an upright mesh alone."""
    return 0.0 if direction[2] + 1 < 1e-9 else math.nan
