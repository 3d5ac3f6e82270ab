"""Smoothed Coulomb friction: f0' rises smoothly from 0 to 1 over the slip `eps` (Li et al. 2020, Eq. 15).

Each quadrature point keeps an anchor on the indenter that moves only when it slips (return mapping), so that a sticking
point does not creep from frame to frame.
"""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from tacgen.geometry.pose import Pose

Array = np.ndarray


def smooth(u: Array, eps: float) -> tuple[Array, Array, Array]:
    """f0 [mm], f0'/|u| [1/mm] and (f0'' - f0'/|u|)/|u|^2 [1/mm^3] at slip lengths u >= 0 [mm]."""
    stick = u < eps
    v = np.maximum(u, 1e-12 * eps)
    value = np.where(stick, u**2 / eps - u**3 / (3 * eps**2), u - eps / 3)
    slope = np.where(stick, 2 / eps - u / eps**2, 1 / v)
    return value, slope, np.where(stick, -1 / (eps**2 * v), -1 / v**3)


def slip(x: Array, anchor: Array, normal: Array) -> Array:
    """Tangential displacement of points x (f, q, 3) from their anchors [mm]."""
    u = x - anchor
    return np.asarray(u - (u * normal).sum(-1, keepdims=True) * normal)


def onset(before: Array, ahead: Array, gap_before: Array, gap_ahead: Array) -> Array:
    """Positions (f, q, 3), in the indenter's frame, where points that come into contact during a load step first touch.

    `before` and `ahead` are the positions at the start of the step and, predicted, at its end; the gaps there [mm] are
    to the surface of contact. A point touches where the straight line between them meets that surface.
    """
    closing = gap_before - gap_ahead
    part = np.where(gap_ahead < 0, np.clip(gap_before / np.maximum(closing, 1e-12), 0.0, 1.0), 1.0)
    return np.asarray(before + part[..., None] * (ahead - before))


def dragged(anchor: Array, x: Array, normal: Array, normal_force: Array, eps: float, pose: "Pose") -> Array:
    """Anchors after a load step, in the indenter's frame: moved by the slip beyond eps; a free point is its own anchor.

    anchor and x (f, q, 3) are in the sensor frame.
    """
    u = slip(x, anchor, normal)
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    pulled = x - u * np.minimum(1.0, eps / np.maximum(length, 1e-300))
    return pose.local(np.where(normal_force[..., None] > 0, pulled, x))
