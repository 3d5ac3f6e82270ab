"""What players share: packages that are asked for, paths in steps, and sums of forces at points."""

import importlib.util
from importlib import metadata
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.referee.case import Array, Case, Pose, spread
from benchmarks.referee.player import Answer

FRAME_S = 0.1  # a player with inertia takes this long from one frame to the next: at most 4 mm/s [s]


def missing(*packages: str) -> str | None:
    """Which packages are not installed, in a few words; None if all are."""
    absent = [name for name in packages if importlib.util.find_spec(name) is None]
    return f"not installed: {', '.join(absent)}" if absent else None


def versions(*packages: str) -> str:
    """Names and versions of installed packages."""
    return ", ".join(f"{name} {metadata.version(name)}" for name in packages)


def quaternion(pose: Pose) -> Array:
    """Turn of a pose as w, x, y, z (4,)."""
    return Rotation.from_matrix(pose.matrix[:3, :3]).as_quat(scalar_first=True)


def xyzw(pose: Pose) -> Array:
    """Turn of a pose as x, y, z, w (4,)."""
    return Rotation.from_matrix(pose.matrix[:3, :3]).as_quat()


def speed(before: Pose, now: Pose, seconds: float) -> tuple[Array, Array]:
    """Velocity [mm/s] in the sensor's frame and turning rate [rad/s] in the shape's own, both (3,), from a pose to
    another."""
    before_turn, now_turn = (Rotation.from_matrix(pose.matrix[:3, :3]) for pose in (before, now))
    return np.subtract(now[:3], before[:3]) / seconds, (before_turn.inv() * now_turn).as_rotvec() / seconds


def along(before: Pose, now: Pose) -> bool:
    """Whether a step moves along the face, or turns: friction that creeps is then read before it comes to rest."""
    return before[:2] != now[:2] or before[3:] != now[3:]


def wrench(points: Array, forces: Array) -> tuple[Array, Array]:
    """Force (3,) and torque (3,) about the origin of forces (n, 3) at points (n, 3)."""
    return forces.sum(0), np.cross(points, forces).sum(0)


def answer(found: list[tuple[Array, Array]], seconds: float, settings: dict[str, Any], on_gpu: bool = False) -> Answer:
    """The answer of forces (n, 3) [N] at points (n, 3) [mm] on the gel, in each judged frame."""
    force, torque = (np.array(part) for part in zip(*(wrench(*one) for one in found), strict=True))
    pressure, traction = (np.array(part) for part in zip(*(spread(*one) for one in found), strict=True))
    return Answer(force, torque, seconds, settings, pressure, traction, on_gpu=on_gpu)


def between(start: Pose, end: Pose, steps: int) -> list[Pose]:
    """`steps` equal steps from one pose to another, the last of them `end`."""
    low, high = np.array(start), np.array(end)
    return [Pose(*(low + (high - low) * (i + 1) / steps)) for i in range(steps)]
