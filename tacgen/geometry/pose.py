"""Poses as matrices: rotations about an axis, and interpolation between poses."""

import math
from dataclasses import dataclass

import numpy as np

Array = np.ndarray


def about(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit axis (3,) by `angle` [rad]; also of a fraction `angle` of a rotation vector (3,).

    Equals `Rotation.from_rotvec(angle * axis).as_matrix()` (on x86-64 bit by bit). Written out, since importing
    scipy.spatial.transform would take 0.16 s of the 0.3 s of `tacgen validate`.
    """
    x, y, z = (float(a) * angle for a in axis)
    length = math.sqrt(x * x + y * y + z * z)
    s = math.sin(length / 2) / length if length > 1e-3 else 0.5 - length**2 / 48 + length**4 / 3840
    x, y, z, w = s * x, s * y, s * z, math.cos(length / 2)
    return np.array(
        [
            [x * x - y * y - z * z + w * w, 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), -x * x + y * y - z * z + w * w, 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), -x * x - y * y + z * z + w * w],
        ]
    )


def shortest_turn(a: Array, b: Array) -> Array:
    """The shortest rotation vector (3,) [rad] from a to b, which are poses (4, 4) or rotations (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec())


def between(a: Array, b: Array, turn: Array, part: float) -> Array:
    """The pose (4, 4) at a fraction `part` from a to b: linear in position, uniform about `turn` (3,) [rad]."""
    out = b.copy()
    if part < 1:
        angle = float(np.linalg.norm(turn))
        out[:3, :3] = (about(turn / angle, part * angle) if angle else np.eye(3)) @ a[:3, :3]
        out[:3, 3] = (1 - part) * a[:3, 3] + part * b[:3, 3]
    return out


def along(a: Array, b: Array, turn: Array, n: int) -> list[Array]:
    """The n poses (4, 4) after each of n equal steps from a to b; the last is b itself."""
    return [between(a, b, turn, k / n) for k in range(1, n + 1)]


@dataclass(frozen=True)
class Pose:
    """Pose of the indenter: x = rotation @ X + position maps its own frame to the sensor frame.

    Not scipy's RigidTransform, whose `apply` takes six times as long: 980 instead of 150 us for 20 000 points, in
    every Newton iteration.
    """

    rotation: Array
    position: Array

    @classmethod
    def of(cls, matrix: Array) -> "Pose":
        """From a homogeneous (4, 4) matrix."""
        return cls(matrix[:3, :3], matrix[:3, 3])

    def local(self, x: Array) -> Array:
        """Points (..., 3) in the indenter's frame."""
        return np.asarray((x - self.position) @ self.rotation)

    def world(self, X: Array) -> Array:
        """Points (..., 3) of the indenter's frame in the sensor's."""
        return np.asarray(X @ self.rotation.T + self.position)
