"""The grasp of one row of a plan: two gels, one rigid object, the gripper's path, and the object's weight.

See mechanics/grasp.py for the frames.
"""

import numpy as np

from tacgen.base.errors import UserError
from tacgen.geometry.pose import about
from tacgen.mechanics.grasp import FINGER_ROTATIONS, GraspScene, centred, first_touch, seen_from
from tacgen.mechanics.scene import Match, Scene, Wanted
from tacgen.recipe.grasp_checks import TOO_CLOSE_MESSAGE
from tacgen.recipe.matching import MIN_MATCHED_FORCE_N
from tacgen.recipe.pose_table import TimedPose
from tacgen.recipe.row import Row
from tacgen.recipe.scene_of_row import gel_of, shape_of
from tacgen.recipe.trajectory import Close, Lift, Replay, Tilt

Array = np.ndarray
GRAVITY_M_S2 = 9.80665  # [m/s^2], standard
COARSE_SOLVE_DEPTH_RATIO = 0.5  # depth that the mesh of the coarse first solve allows for, over the gel's thickness [-]


def build(row: Row) -> GraspScene:
    """The grasp of one row of a plan.

    Raises:
        UserError: the fingers would close farther than the gels are thick.
    """
    recipe, asked, quality = row.recipe, row.recipe.grasp, row.recipe.resolved()
    assert asked is not None
    assert row.other is not None
    shape, gels = shape_of(row), (gel_of(row.sensor), gel_of(row.other))
    height = asked.height_mm or shape.support(np.array([0.0, 0.0, 1.0])) / 2
    rows = row.replayed(0) if recipe.match else ()
    begin = rows[0].pose if rows else np.eye(4)
    placed = np.linalg.inv(begin) @ rows[0].held if rows and rows[0].held is not None else None
    if placed is not None:
        start, opening = centred(shape, gels, placed)
        where = "the poses of gripper and object in the table's first row"
    else:
        start, opening = first_touch(shape, gels, height, asked.y_mm, float(np.radians(asked.yaw_deg)))
        where = "height_mm and y_mm"
    if not np.isfinite(opening):
        raise UserError(f"grasp: nothing of the object is between the fingers: check {where}")
    if placed is not None and (off := abs(start[0, 3] - placed[0, 3])) > opening / 2:
        raise UserError(f"grasp: the object is {off:.3g} mm from the middle of the fingers: check {where}")
    down = np.array(asked.gravity) / np.linalg.norm(asked.gravity)
    thin = min(gel.thickness for gel in gels)
    gripper, width, force, part, wanted = _path(row, down, begin, opening, opening - 2 * thin)
    for number, step in enumerate(recipe.trajectory):
        if isinstance(step.move, Close) and (step.move.width_mm or opening) <= opening - 2 * thin:
            told = TOO_CLOSE_MESSAGE.format(opening - 2 * thin, opening)
            raise UserError(f"trajectory[{number}].close.width_mm: {told}")
    segment = np.repeat(np.arange(len(recipe.trajectory)), [step.frames for step in recipe.trajectory])
    closed = opening - COARSE_SOLVE_DEPTH_RATIO * thin if np.isfinite(force).any() else np.nanmin([*width, opening])
    sunk = max(float(((gripper[0, :3, 3] - gripper[:, :3, 3]) @ down).max()), 0.0)  # if the object stays on the table
    match, inward = Match.of(wanted), begin[:3, :3].T @ down
    fingers = []
    for side, gel in enumerate(gels):
        standing = seen_from(side, opening, start)
        poses = np.tile(seen_from(side, closed, start), (2, 1, 1))
        poses[1, :3, 3] += sunk * FINGER_ROTATIONS[side].T @ inward
        known = (recipe.contact.friction, quality.edge_mm, quality.dhat_mm)
        fingers.append(Scene(gel, shape, poses, standing, segment, *known, element=recipe.mesh or "hex", match=match))
    weight, centre = asked.mass_kg * GRAVITY_M_S2 * down, np.array(asked.centre_mm or (0.0, 0.0, height))
    path = (gripper, width, force, part, segment)
    return GraspScene((fingers[0], fingers[1]), start, opening, weight, centre, *path, asked.fall_mm, begin)


def _path(
    row: Row, down: Array, begin: Array, opening: float, least: float
) -> tuple[Array, Array, Array, Array, tuple[Wanted | None, ...]]:
    """The gripper's pose (N, 4, 4), width, force and the fraction of its change reached (N,), at each frame, and what a
    table wants there. begin: its first pose; opening, least: width at first touch, and the least one [mm]."""
    pose, frames = begin, []
    for number, step in enumerate(row.recipe.trajectory):
        first, rows = pose, row.replayed(number) if step.replay else ()
        for k in range(1, step.frames + 1):
            part, width, force, wanted = k / step.frames, np.nan, np.nan, None
            pose = first.copy()
            match step.move:
                case Close(width_mm=wide, force_n=strong):
                    width, force = wide or np.nan, strong or np.nan
                case Replay():  # the table's motion relative to its first row
                    pose = first @ np.linalg.inv(rows[0].pose) @ rows[k - 1].pose
                    if step.move.matched:
                        width, force, wanted = _gripped(rows[k - 1], opening, least)
                        part = 1.0
                case Lift(height_mm=height):
                    pose[:3, 3] -= part * height * down
                case Tilt(angle_deg=angle, axis_deg=axis):
                    level = np.array([np.cos(np.radians(axis)), np.sin(np.radians(axis)), 0.0])
                    pose[:3, :3] = about(level, part * np.radians(angle)) @ first[:3, :3]
            frames.append((pose, width, force, part, wanted))
    poses, *rest, asked_for = zip(*frames, strict=True)
    return np.array(poses), *(np.array(column) for column in rest), asked_for


def _gripped(row: TimedPose, opening: float, least: float) -> tuple[float, float, Wanted]:
    """Width [mm] and force [N] of a table's row, nan where they follow; without force the fingers open, to first touch
    at least. A width that the gels are too thick for is left out."""
    wanted = Wanted(row.held, row.normal)
    if row.normal >= MIN_MATCHED_FORCE_N:
        return np.nan, row.normal, wanted
    if not np.isnan(row.normal):
        return max(opening, row.width), np.nan, wanted  # also if the width is nan
    if row.width <= least:
        text = f"a width of {row.width:.4g} mm is less than the gels' thickness leaves, {least:.4g} mm: not closed"
        return np.nan, np.nan, wanted._replace(note=text)
    return row.width, np.nan, wanted
