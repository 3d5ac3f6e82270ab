"""Smoothed Coulomb friction with lagged normal force: a potential of the slip from anchors on the indenter.

D(u) = friction * lambda * f0(|u|), with f0' rising smoothly from 0 to 1 over `eps` (Li et al. 2020, Eq. 15). Each
quadrature point keeps an anchor on the indenter that moves only when it slips (return mapping), so that a sticking
point does not creep from frame to frame.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacgen.fem.potential import Projection

if TYPE_CHECKING:
    from tacgen.contact.barrier import Faces, Pose

Array = np.ndarray


def smooth(u: Array, eps: float) -> tuple[Array, Array, Array]:
    """f0 [mm], f0'/|u| [1/mm] and (f0'' - f0'/|u|)/|u|^2 [1/mm^3] at slip lengths u >= 0 [mm]."""
    stick = u < eps
    v = np.maximum(u, 1e-12 * eps)
    value = np.where(stick, u**2 / eps - u**3 / (3 * eps**2), u - eps / 3)
    slope = np.where(stick, 2 / eps - u / eps**2, 1 / v)
    return value, slope, np.where(stick, -1 / (eps**2 * v), -1 / v**3)


@dataclass(frozen=True)
class Friction:
    """Friction of quadrature points with lagged normal forces (f, q) [N], normals (f, q, 3) and anchors (f, q, 3).

    All three are given in the sensor frame at the pose being solved for.
    """

    faces: "Faces"
    coefficient: float
    normal_force: Array
    normal: Array
    anchor: Array
    eps: float  # slip over which friction builds up [mm]

    def slip(self, x: Array) -> Array:
        """Tangential displacement (f, q, 3) from the anchors [mm]."""
        u = self.faces.at(x) - self.anchor
        return np.asarray(u - (u * self.normal).sum(-1, keepdims=True) * self.normal)

    def force(self, x: Array) -> Array:
        """Friction on the gel (f, q, 3) [N]."""
        u = self.slip(x)
        _, slope, _ = smooth(np.linalg.norm(u, axis=-1), self.eps)
        return np.asarray(-(self.coefficient * self.normal_force * slope)[..., None] * u)

    def value(self, x: Array) -> float:
        f0, _, _ = smooth(np.linalg.norm(self.slip(x), axis=-1), self.eps)
        return float(self.coefficient * (self.normal_force * f0).sum())

    def gradient(self, x: Array) -> Array:
        return self.faces.scatter(-self.force(x), len(x))

    def add_hessian(self, x: Array, data: Array, projection: Projection) -> None:
        which = np.flatnonzero((self.normal_force > 0).any(1))
        u, n = self.slip(x)[which], self.normal[which]
        _, slope, bend = smooth(np.linalg.norm(u, axis=-1), self.eps)
        across = np.eye(3) - n[..., :, None] * n[..., None, :]
        D = slope[..., None, None] * across
        if projection == Projection.NONE:
            D += bend[..., None, None] * u[..., :, None] * u[..., None, :]
        self.faces.add_blocks(which, (self.coefficient * self.normal_force[which])[..., None, None] * D, data)

    def max_step(self, x: Array, p: Array) -> float:
        return 1.0


def onset(before: Array, ahead: Array, gap_before: Array, gap_ahead: Array) -> Array:
    """Positions (f, q, 3), in the indenter's frame, where points that come into contact during a frame first touch.

    `before` and `ahead` are the positions at the start of the frame and, extrapolated, at its end; the gaps there [mm]
    are to the surface of contact. A point touches where the straight line between them meets that surface.
    """
    closing = gap_before - gap_ahead
    part = np.where(gap_ahead < 0, np.clip(gap_before / np.maximum(closing, 1e-12), 0.0, 1.0), 1.0)
    return np.asarray(before + part[..., None] * (ahead - before))


def dragged(anchor: Array, x: Array, normal: Array, normal_force: Array, eps: float, pose: "Pose") -> Array:
    """Anchors after a frame, in the indenter's frame: moved by the slip beyond eps; free points carry their own.

    anchor and x (f, q, 3) are in the sensor frame.
    """
    u = x - anchor
    u = u - (u * normal).sum(-1, keepdims=True) * normal
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    pulled = x - u * np.minimum(1.0, eps / np.maximum(length, 1e-300))
    return pose.local(np.where(normal_force[..., None] > 0, pulled, x))
