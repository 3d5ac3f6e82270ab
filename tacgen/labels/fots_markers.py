"""Pose of the indenter -> how the dots move, by three exponentials of the distance from the contact: no mechanics.

As FOTS has it (Zhao et al., FOTS: A Fast Optical Tactile Simulator for Sim2Real Learning of Tactile-motor Robot
Manipulation Skills, RA-L 2024): each point that is pressed in drives the dots apart, and the contact drags and turns
them along with it, up to where it slips. The numbers are the sensor file's, `markers.motion`.
"""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tacgen.contact.barrier import Pose
from tacgen.optics.surface_grid import Sheet, Untouched

if TYPE_CHECKING:
    from tacgen.geometry.analytic_sdf import Shape
    from tacgen.optics.camera import Camera
    from tacgen.recipe.sensor import Gel, Motion

Array = np.ndarray
FACE_SPACING = 0.3  # between the points of the face at which the press depth is taken [mm]


class Drift:
    """Dots that rest at given places, and one indenter that comes, drags them and goes."""

    def __init__(self, motion: "Motion", rest: Array, gel: "Gel", shape: "Shape", camera: "Camera") -> None:
        """`rest` (n, 2) [mm]."""
        untouched, sheet = Untouched.of(gel), Sheet.over(gel, FACE_SPACING)
        self.motion, self.shape, self.camera = motion, shape, camera
        self._face = sheet.at(replace(untouched, skin=0.0))  # what is touched, not what is printed
        self._cell = float(np.prod(sheet.size)) / len(self._face)
        self._dots = untouched.at(rest)
        self.undisturbed = camera.project(self._dots)
        self._touched: Pose | None = None

    def at(self, pose: Array) -> tuple[Array, Array]:
        """Pixels (n, 2) of the dots at a pose (4, 4), which follows the one asked for before, and whether they are in
        the picture (n,)."""
        now = self._dots + np.column_stack([self.moved(Pose.of(pose)), np.zeros(len(self._dots))])
        pixels, (h, w) = self.camera.project(now), self.camera.shape
        return pixels, np.asarray((pixels >= 0).all(1) & (pixels <= (w, h)).all(1))

    def moved(self, pose: Pose) -> Array:
        """How far the dots have moved sideways (n, 2) [mm]."""
        depth = -self.shape.distance(pose.local(self._face))[0]
        inside = depth > 0
        if not inside.any():
            self._touched = None
            return np.zeros((len(self._dots), 2))
        self._touched = self._touched or pose
        depth, at = depth[inside], self._face[inside]
        middle = depth @ at / depth.sum()
        dots = self._dots[:, :2]
        return np.asarray(self._apart(dots, at[:, :2], depth) + self._along(dots, middle, self._touched, pose))

    def _apart(self, dots: Array, at: Array, depth: Array) -> Array:
        gain, decay = self.motion.press
        away = dots[:, None] - at
        weight = depth * np.exp(-decay * (away**2).sum(axis=-1))
        return np.asarray(gain * self._cell * np.einsum("np,npi->ni", weight, away))

    def _along(self, dots: Array, middle: Array, before: Pose, now: Pose) -> Array:
        """What was at the contact's middle at first touch has moved and turned since."""
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
