"""The grasp of one row of a plan: two gels, one rigid object, the gripper's path, and the object's weight.

See mechanics/grasp.py for the frames.
"""

import numpy as np

from tacgen.base.errors import UserError
from tacgen.geometry.pose import about
from tacgen.mechanics.grasp import FINGER_ROTATIONS, GraspScene, first_touch, seen_from
from tacgen.mechanics.scene import Scene
from tacgen.recipe.grasp_checks import TOO_CLOSE_MESSAGE
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
    start, opening = first_touch(shape, gels, height, asked.y_mm, float(np.radians(asked.yaw_deg)))
    if not np.isfinite(opening):
        raise UserError("grasp: nothing of the object is between the fingers: check height_mm and y_mm")
    down = np.array(asked.gravity) / np.linalg.norm(asked.gravity)
    gripper, width, force, part = _path(row, down)
    thin = min(gel.thickness for gel in gels)
    for number, step in enumerate(recipe.trajectory):
        if isinstance(step.move, Close) and (step.move.width_mm or opening) <= opening - 2 * thin:
            raise UserError(
                f"trajectory[{number}].close.width_mm: {TOO_CLOSE_MESSAGE.format(opening - 2 * thin, opening)}"
            )
    segment = np.repeat(np.arange(len(recipe.trajectory)), [step.frames for step in recipe.trajectory])
    closed = opening - COARSE_SOLVE_DEPTH_RATIO * thin if np.isfinite(force).any() else min(np.nanmin(width), opening)
    sunk = max(float(((gripper[0, :3, 3] - gripper[:, :3, 3]) @ down).max()), 0.0)  # if the object stays on the table
    fingers = []
    for side, gel in enumerate(gels):
        standing = seen_from(side, opening, start)
        poses = np.tile(seen_from(side, closed, start), (2, 1, 1))
        poses[1, :3, 3] += sunk * FINGER_ROTATIONS[side].T @ down
        known = (recipe.contact.friction, quality.edge_mm, quality.dhat_mm)
        fingers.append(Scene(gel, shape, poses, standing, segment, *known, element=recipe.mesh or "hex"))
    weight, centre = asked.mass_kg * GRAVITY_M_S2 * down, np.array(asked.centre_mm or (0.0, 0.0, height))
    path = (gripper, width, force, part, segment)
    return GraspScene((fingers[0], fingers[1]), start, opening, weight, centre, *path, asked.fall_mm)


def _path(row: Row, down: Array) -> tuple[Array, Array, Array, Array]:
    """The gripper's pose (N, 4, 4), width, force and the fraction of its change reached (N,), at each frame."""
    pose, frames = np.eye(4), []
    for number, step in enumerate(row.recipe.trajectory):
        first, rows = pose, row.replayed(number) if step.replay else ()
        for k in range(1, step.frames + 1):
            part, width, force = k / step.frames, np.nan, np.nan
            pose = first.copy()
            match step.move:
                case Close(width_mm=wide, force_n=strong):
                    width, force = wide or np.nan, strong or np.nan
                case Replay():  # the table's motion relative to its first row
                    pose = first @ np.linalg.inv(rows[0].pose) @ rows[k - 1].pose
                case Lift(height_mm=height):
                    pose[:3, 3] -= part * height * down
                case Tilt(angle_deg=angle, axis_deg=axis):
                    level = np.array([np.cos(np.radians(axis)), np.sin(np.radians(axis)), 0.0])
                    pose[:3, :3] = about(level, part * np.radians(angle)) @ first[:3, :3]
            frames.append((pose, width, force, part))
    poses, *rest = zip(*frames, strict=True)
    return np.array(poses), *(np.array(column) for column in rest)  # type: ignore[return-value]
