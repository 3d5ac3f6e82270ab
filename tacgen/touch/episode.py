"""Records of an episode: where bodies were, whose surfaces may touch a finger, and what each finger then felt."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tacgen.recipe.trajectory import Placement

Array = np.ndarray


@dataclass(frozen=True)
class BodySurface:
    """The surface of a rigid body: an `indenter` as a recipe has it (files absolute), and the pose (4, 4) [mm] of the
    indenter's frame in the body's."""

    indenter: Mapping[str, Any]
    pose: Array


@dataclass(frozen=True)
class Thing:
    """An object that a finger may touch. body: its name in episodes; mass [kg] and centre of mass (3,) [mm] in the
    body's frame, where known."""

    body: str
    surface: BodySurface
    mass: float | None = None
    centre: Array | None = None


@dataclass(frozen=True)
class Finger:
    """A sensor on a body of the robot. name: such as left; sensor: a name or file as in a recipe; mount: pose of the
    sensor's frame in the body's."""

    name: str
    sensor: str
    body: str
    mount: Placement = field(default_factory=Placement)


@dataclass(frozen=True)
class EpisodeLog:
    """The n rows of an episode.

    time (n,) [s], increasing; bodies: poses (n, 4, 4) [mm] in the world by name, nan where a row has none; forces:
    (n, 3) [N] in the world, on the first body of a pair by the second, as the engine reported them; grip (n,) [N]: the
    force that the gripper was told to close with, nan where unknown; gravity (3,) [m/s^2] in the world.
    """

    index: int
    name: str
    time: Array
    bodies: Mapping[str, Array]
    forces: Mapping[tuple[str, str], Array] = field(default_factory=dict)
    grip: Array | None = None
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True)
class Touch:
    """The touch of a finger in the n rows of an episode; forces on the gel in the sensor's frame.

    touched: name of the object, "" without contact; force (n, 3) [N]; torque (n, 3) [N mm] about the sensor's origin;
    markers (n, m, 2) [px], None without markers; error (n,): expected error of the force over the force [-]; correction
    (n,) [mm]: by how much matching moved the object along the sensor's z; engine (n,) [N]: the normal force that was
    asked for or that the engine reported, nan where unknown; moved: whether friction does not hold (n,), a slip; lifted
    (n,): whether the fingers bear the object; note: why a row is not as asked, "" where it is.
    image: picture (h, w, 3) uint8 of a row, the untouched sensor's without contact.
    """

    finger: str
    touched: list[str]
    force: Array
    torque: Array
    markers: Array | None
    error: Array
    correction: Array
    engine: Array
    moved: Array
    lifted: Array
    note: list[str]
    image: Callable[[int], Array]

    @property
    def contact(self) -> Array:
        """(n,) booleans."""
        return np.array([bool(name) for name in self.touched])
