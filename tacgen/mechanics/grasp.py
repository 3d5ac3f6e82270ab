"""A grasp as the numerics need it: two gels, one rigid object, the gripper's path, and the object's weight.

Frames: the gripper's x is the closing axis, from the left finger to the right one, its origin midway between their
faces; both fingers point along its -z. The left sensor looks along +x and the right one along -x, the top of their
images (the sensor's -y) at the fingertip. At the start the gripper's frame is the world's, unless `begin` says where it
is.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.first_touch import contact_height
from tacgen.geometry.outline import Pad
from tacgen.geometry.pose import about
from tacgen.mechanics.scene import Match, Scene

Array = np.ndarray
# Sensor frame to gripper frame, left and right: columns are the sensor's x, y, z.
FINGER_ROTATIONS = np.array([[[0, 0, 1], [1, 0, 0], [0, 1, 0]], [[0, 0, -1], [-1, 0, 0], [0, 1, 0]]], dtype=float)
FINGER_SIDES = np.array([-1.0, 1.0])  # side of the left and the right finger along the gripper's x
GRASP_DEPTH_MARGIN = 1.25  # depth that the final mesh allows for, over the depth of the coarse first solve [-]


@dataclass(frozen=True)
class GraspScene:
    """All that the numerics need of one grasp, without the recipe.

    fingers: the left and the right gel, whose shape is the object and whose poses are guesses; start (4, 4): the object
    in the gripper's frame at first touch, `opening` [mm] being the distance of the faces then; weight (3,) in the world
    [N], acting at `centre` (3,) of the object's frame [mm]; gripper (N, 4, 4): its pose in the world at each frame;
    width (N,) [mm] and force (N,) [N] that a segment asks for, nan where it does not (with neither the width stays);
    part (N,): of the change since the segment before that a frame makes [-]; segment (N,); fall: how far the object
    sinks in a frame once friction does not bear it [mm]; begin (4, 4): the gripper in the world at the start.
    """

    fingers: tuple[Scene, Scene]
    start: Array
    opening: float
    weight: Array
    centre: Array
    gripper: Array
    width: Array
    force: Array
    part: Array
    segment: Array
    fall: float
    begin: Array = field(default_factory=lambda: np.eye(4))

    @property
    def match(self) -> Match | None:
        """What a table wants of the frames, which both fingers have."""
        return self.fingers[0].match

    @property
    def apart(self) -> float:
        """How far each finger stays from the object, if it never comes nearer than first touch; otherwise 0 [mm]."""
        if np.isfinite(self.force).any():
            return 0.0
        return max(float(np.nanmin(self.width)) - self.opening, 0.0) / 2


def first_touch(shape: Shape, gels: tuple[Pad, Pad], height: float, y: float, yaw: float) -> tuple[Array, float]:
    """The object's pose (4, 4) in the gripper's frame and the width [mm] at which both gels just touch it; -inf if one
    of them has nothing of it in front.

    Args:
        height, y [mm], yaw [rad]: of the fingers' middle above the object's lowest point, and of the object.
    """
    pose = np.eye(4)
    pose[:3, :3] = about(np.array([0.0, 0.0, 1.0]), yaw)
    pose[:3, 3] = 0.0, y, -height
    return centred(shape, gels, pose)


def centred(shape: Shape, gels: tuple[Pad, Pad], pose: Array) -> tuple[Array, float]:
    """As `first_touch`, of an object at a pose (4, 4) in the gripper's frame, moved along the closing axis alone."""
    pose = pose.copy()
    pose[0, 3] = 0.0
    left, right = (contact_height(shape, gel, seen_from(side, 0.0, pose)) for side, gel in enumerate(gels))
    if np.isfinite(left + right):
        pose[0, 3] = (left - right) / 2
    return pose, left + right


def finger(side: int, width: float) -> Array:
    """Pose (4, 4) of a sensor in the gripper's frame, the faces `width` [mm] apart; side 0 is left, 1 right."""
    out = np.eye(4)
    out[:3, :3] = FINGER_ROTATIONS[side]
    out[0, 3] = FINGER_SIDES[side] * width / 2
    return out


def seen_from(side: int, width: float, pose: Array) -> Array:
    """A pose (4, 4) given in the gripper's frame, in a sensor's frame."""
    mount = finger(side, width)
    out = np.eye(4)
    out[:3, :3] = mount[:3, :3].T @ pose[:3, :3]
    out[:3, 3] = mount[:3, :3].T @ (pose[:3, 3] - mount[:3, 3])
    return out


def refined(grasp: GraspScene, poses: tuple[list[Array], list[Array]]) -> GraspScene:
    """The grasp with finger meshes that are fine where `poses` (4, 4) of the object in each sensor's frame touch."""
    fingers = []
    for scene, path in zip(grasp.fingers, poses, strict=True):
        deeper = np.array(path)
        deeper[:, 2, 3] -= (GRASP_DEPTH_MARGIN - 1) * np.maximum(
            scene.start[2, 3] - deeper[:, 2, 3], 0.0
        ) + scene.edge / 4
        fingers.append(replace(scene, poses=deeper))
    return replace(grasp, fingers=(fingers[0], fingers[1]))
