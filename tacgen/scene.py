"""Resolved scene -> Scene: gel, laws, indenter, path and camera as plain arrays and numbers."""

from dataclasses import dataclass

import numpy as np

from tacgen.sensor import Sensor


@dataclass(frozen=True)
class Scene:
    """All that the numerics need of one scene; nothing in it is a recipe."""

    sensor: Sensor
    poses: np.ndarray
