"""Marker motion from the indenter's pose by three exponential functions of the distance to the contact, no mechanics.

The model of FOTS (Zhao et al., FOTS: A Fast Optical Tactile Simulator for Sim2Real Learning of Tactile-motor Robot
Manipulation Skills, RA-L 2024): indented points push the markers apart, and the contact drags and rotates them until it
slips. The constants are in the sensor file, `markers.motion`.
"""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tacgen.geometry.pose import Pose
from tacgen.optics.surface_grid import Sheet, Untouched

if TYPE_CHECKING:
    from tacgen.geometry.analytic_sdf import Shape
    from tacgen.optics.camera import PinholeCamera
    from tacgen.sensor.markers import Motion
    from tacgen.sensor.model import Gel

Array = np.ndarray
DEPTH_SPACING_MM = 0.3  # spacing of the points of the face at which the depth is evaluated [mm]


class FotsMarkers:
    """Markers with given rest positions, moved by one indenter along its path."""

    def __init__(self, motion: "Motion", rest: Array, gel: "Gel", shape: "Shape", camera: "PinholeCamera") -> None:
        """`rest` (n, 2) [mm]."""
        untouched, sheet = Untouched.of(gel), Sheet.over(gel, DEPTH_SPACING_MM)
        self.motion, self.shape, self.camera = motion, shape, camera
        self._face = sheet.at(replace(untouched, skin=0.0))  # the touched surface, not the printed one below the skin
        self._cell = float(np.prod(sheet.size)) / len(self._face)
        self._dots = untouched.at(rest)
        self.undisturbed = camera.project(self._dots)
        self._touched: Pose | None = None

    def at(self, pose: Array) -> tuple[Array, Array]:
        """Pixels (n, 2) of the markers at the next pose (4, 4), and whether they are in the image (n,)."""
        now = self._dots + np.column_stack([self.moved(Pose.of(pose)), np.zeros(len(self._dots))])
        pixels, (h, w) = self.camera.project(now), self.camera.shape
        return pixels, np.asarray((pixels >= 0).all(1) & (pixels <= (w, h)).all(1))

    def moved(self, pose: Pose) -> Array:
        """Sideways displacement of the markers (n, 2) [mm]."""
        depth = -self.shape.value(pose.local(self._face))
        inside = depth > 0
        if not inside.any():
            self._touched = None
            return np.zeros((len(self._dots), 2))
        self._touched = self._touched or pose
        depth, at = depth[inside], self._face[inside]
        middle = depth @ at / depth.sum()
        dots = self._dots[:, :2]
        pushed = self._pushed_apart(dots, at[:, :2], depth)
        return np.asarray(pushed + self._dragged_and_turned(dots, middle, self._touched, pose))

    def _pushed_apart(self, dots: Array, at: Array, depth: Array) -> Array:
        gain, decay = self.motion.press
        away = dots[:, None] - at
        weight = depth * np.exp(-decay * (away**2).sum(axis=-1))
        return np.asarray(gain * self._cell * np.einsum("np,npi->ni", weight, away))

    def _dragged_and_turned(self, dots: Array, middle: Array, before: Pose, now: Pose) -> Array:
        """Displacement by drag and rotation of the contact since first touch."""
        drag = (now.world(before.local(middle)) - middle)[:2]
        limit, decay = self.motion.shear
        drag *= min(1.0, limit / max(float(np.linalg.norm(drag)), 1e-12))
        spin = now.rotation @ before.rotation.T
        angle = math.atan2(spin[1, 0] - spin[0, 1], spin[0, 0] + spin[1, 1])
        most, fade = math.radians(self.motion.twist[0]), self.motion.twist[1]
        angle = max(-most, min(angle, most))
        out = dots - middle[:2]
        r2 = (out**2).sum(axis=1)[:, None]
        turned = angle * np.column_stack([-out[:, 1], out[:, 0]])
        return np.asarray(np.exp(-decay * r2) * drag + np.exp(-fade * r2) * turned)
