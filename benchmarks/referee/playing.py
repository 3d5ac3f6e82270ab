"""Helpers that players of other simulators share: how they are described, paths in steps, and forces at points."""

import ctypes
import importlib.util
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.referee.case import Array, Case, Pose, spread
from benchmarks.referee.player import Answer, NotPlayed

Settings: TypeAlias = Mapping[str, Any]
FRAME_S = 0.1  # a player with inertia takes this long from a frame to the next: at most 6 mm/s [s]


@dataclass(frozen=True)
class Simulator:
    """A player by one function of a case and settings; the packages it imports, and distributions it is made of."""

    name: str
    packages: tuple[str, ...]
    distributions: tuple[str, ...]
    chosen: Mapping[str, Settings]
    run: Callable[[Case, Settings], Answer]

    @property
    def settings(self) -> tuple[str, ...]:
        return tuple(self.chosen)

    def available(self) -> str | None:
        absent = [name for name in self.packages if importlib.util.find_spec(name) is None]
        return f"not installed: {', '.join(absent)}" if absent else None

    def version(self) -> str:
        return ", ".join(f"{name} {metadata.version(name)}" for name in self.distributions)

    def play(self, case: Case, setting: str) -> Answer:
        return self.run(case, self.chosen[setting])


@dataclass(frozen=True)
class OnCuda(Simulator):
    """A simulator that needs a CUDA GPU."""

    def available(self) -> str | None:
        if (absent := super().available()) is not None:
            return absent
        try:
            found = ctypes.CDLL("libcuda.so.1").cuInit(0) == 0
        except OSError:
            found = False
        return None if found else "needs a CUDA GPU"


def steps(case: Case, moving: int, resting: int, *, creeping: bool = False) -> Iterator[tuple[Pose, Pose, bool]]:
    """Each step of a path: the pose before it, the pose after it, and whether a judged frame is reached. `moving`
    equal steps lead to it, then `resting` steps at rest: none after a slide or turn if friction is `creeping`."""
    last = before = Pose(z=max(case.clearance, 0.05))  # just above the face
    for frame, pose in enumerate(case.poses):
        along = (before.x, before.y, *before[3:]) != (pose.x, pose.y, *pose[3:])
        parts = (np.arange(moving) + 1) / moving
        path = [Pose(*(np.array(before) + part * np.subtract(pose, before))) for part in parts]
        path += [pose] * (0 if along and creeping else resting)
        for number, one in enumerate(path):
            yield last, one, number == len(path) - 1 and frame in case.judged
            last = one
        before = pose


def place(pose: Pose, metres: float = 0.001) -> Array:
    """A pose as x, y, z, and its turn as w, x, y, z (7,), with so many metres a millimetre."""
    turn = Rotation.from_matrix(pose.matrix[:3, :3])
    return np.array([*np.multiply(pose[:3], metres), *turn.as_quat(scalar_first=True)])


def speed(before: Pose, now: Pose, seconds: float) -> Array:
    """Velocity [m/s] in the sensor's frame and turning rate [rad/s] in the shape's own (6,), from a pose to another."""
    old, new = (Rotation.from_matrix(pose.matrix[:3, :3]) for pose in (before, now))
    return np.array([*np.subtract(now[:3], before[:3]) / 1000, *(old.inv() * new).as_rotvec()]) / seconds


def answer(found: list[tuple[Array, Array]], seconds: float, how: Settings) -> Answer:
    """The answer of points (n, 3) [mm] and the forces (n, 3) [N] there on the gel, in each judged frame."""
    force = np.array([forces.sum(0) for _, forces in found])
    if not np.isfinite(force).all():
        raise NotPlayed("its forces are not finite")
    torque = np.array([np.cross(points, forces).sum(0) for points, forces in found])
    pressure, traction = (np.array(part) for part in zip(*(spread(*one) for one in found), strict=True))
    return Answer(force, torque, seconds, dict(how), pressure, traction)
