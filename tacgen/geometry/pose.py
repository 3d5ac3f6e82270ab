"""Poses as matrices: turns about an axis, and the way from one pose to another."""

import math

import numpy as np

Array = np.ndarray


def about(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit axis (3,) by `angle` [rad], or by a part of a rotation vector.

    Written out, since `tacgen validate` needs it: importing scipy.spatial.transform would take 0.16 s of its 0.3 s.
    What `Rotation.from_rotvec(angle * axis).as_matrix()` gives (on x86-64 bit by bit), in 2 instead of 9 us.
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
    """Rotation vector (3,) [rad] from a to b, poses (4, 4) or rotations (3, 3), by the shorter way."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec())


def between(a: Array, b: Array, turn: Array, part: float) -> Array:
    """The pose (4, 4) a part of the way from a to b: straight in position, steady about `turn` (3,) [rad]."""
    out = b.copy()
    if part < 1:
        angle = float(np.linalg.norm(turn))
        out[:3, :3] = (about(turn / angle, part * angle) if angle else np.eye(3)) @ a[:3, :3]
        out[:3, 3] = (1 - part) * a[:3, 3] + part * b[:3, 3]
    return out


def along(a: Array, b: Array, turn: Array, n: int) -> list[Array]:
    """The ends (4, 4) of n equal steps from a to b, the last of them b itself."""
    return [between(a, b, turn, k / n) for k in range(1, n + 1)]
