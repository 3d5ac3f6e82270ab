"""A source made by hand: a ball over the gel of one finger, whose body moves through the world."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tacgen.base.errors import UserError
from tacgen.recipe.trajectory import Placement
from tacgen.touch.episode import BodySurface, EpisodeLog, Finger, Thing

Array = np.ndarray
RADIUS = 4.0
MOUNT = Placement(position_mm=(1.0, 2.0, 3.0), quaternion=(0.5, 0.5, 0.5, 0.5))
FINGER = Finger("left", "gelsight_mini", "hand", MOUNT)
COARSE = ("quality={edge_mm: 1.0, dhat_mm: 0.1}", "sensor.camera.width_px=64", "sensor.camera.height_px=48",
          "sensor.camera.mm_per_px=0.317")  # fmt: skip


def ball(name: str, mass: float | None = None) -> Thing:
    """A ball whose body's frame is at its centre."""
    centre = np.eye(4)
    centre[2, 3] = -RADIUS
    return Thing(name, BodySurface({"shape": "sphere", "radius_mm": RADIUS}, centre), mass)


def mount() -> Array:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(MOUNT.quaternion, scalar_first=True).as_matrix()
    pose[:3, 3] = MOUNT.position_mm
    return pose


def hand(n: int) -> Array:
    """Poses (n, 4, 4) of the finger's body, which turns as it moves."""
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :3, 3] = np.outer(np.linspace(0, 1, n), [30.0, -20.0, 50.0])
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(np.linspace(0, 1, n), [0.3, 0.2, 0.1])).as_matrix()
    return poses


def over(gaps: Sequence[float], x: float | Sequence[float] = 0.0) -> Array:
    """Poses of a ball that is so far [mm] over the gel, or beside its middle, in the world."""
    local = np.tile(np.eye(4), (len(gaps), 1, 1))
    local[:, 2, 3], local[:, 0, 3] = np.array(gaps) + RADIUS, x
    return hand(len(gaps)) @ mount() @ local


def episode(balls: Mapping[str, Array], index: int = 0, fps: float = 10.0, forces: Array | None = None) -> EpisodeLog:
    """Of balls by their poses; forces: on the finger by the first one, in the sensor's frame."""
    n = len(next(iter(balls.values())))
    pair = {}
    if forces is not None:
        turned = np.einsum("nij,nj->ni", (hand(n) @ mount())[:, :3, :3], forces)
        pair[("hand", next(iter(balls)))] = turned
    return EpisodeLog(index, f"episode {index}", np.arange(n) / fps, {"hand": hand(n), **balls}, pair)


class Made:
    """A source of such episodes, or of messages in the place of those that cannot be read."""

    kind: str = "log"
    fps: float = 10.0

    def __init__(self, each: Sequence[EpisodeLog | str], things: Sequence[Thing], path: Path = Path("made")) -> None:
        self.each, self.path = each, path
        self.things: Mapping[str, Thing] = {thing.body: thing for thing in things}

    def __len__(self) -> int:
        return len(self.each)

    def episode(self, number: int) -> EpisodeLog:
        one = self.each[number]
        if isinstance(one, str):
            raise UserError(one)
        return one
