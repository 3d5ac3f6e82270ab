"""Rotations and placements in plain Python, for what is checked before NumPy is loaded.

A quaternion is (w, x, y, z); a placement takes a frame into another, x = turned(quaternion, X) + position.
"""

import math
from typing import NamedTuple

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (1.0, 0.0, 0.0, 0.0)
NEARLY = 1e-3  # a quaternion this far from length 1 is one that was written with few digits
ROUNDING = 1e-12


class Placement(NamedTuple):
    """Where a frame stands in another."""

    position: Vector = (0.0, 0.0, 0.0)
    quaternion: Quaternion = UPRIGHT


def unit(q: Quaternion) -> Quaternion:
    """The quaternion made exactly of length 1. Raises ValueError: it is not nearly so."""
    length = math.hypot(*q)
    if abs(length - 1) > NEARLY:
        raise ValueError(f"a quaternion must be of length 1 (got {length:.4g})")
    if abs(length - 1) < ROUNDING:
        return q  # again and again the same numbers
    w, x, y, z = q
    return w / length, x / length, y / length, z / length


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """First b, then a."""
    (p, x, y, z), (q, u, v, w) = a, b
    return (
        p * q - x * u - y * v - z * w,
        p * u + x * q + y * w - z * v,
        p * v - x * w + y * q + z * u,
        p * w + x * v - y * u + z * q,
    )


def inverse(q: Quaternion) -> Quaternion:
    w, x, y, z = q
    return w, -x, -y, -z


def turned(q: Quaternion, v: Vector) -> Vector:
    """A vector turned by q."""
    _, x, y, z = product(product(q, (0.0, *v)), inverse(q))
    return x, y, z


def about(axis: Vector, angle: float) -> Quaternion:
    """The turn about a unit axis by `angle` [rad]."""
    s = math.sin(angle / 2)
    return math.cos(angle / 2), s * axis[0], s * axis[1], s * axis[2]


def on(outer: Placement, inner: Placement) -> Placement:
    """A placement in a frame that is itself placed."""
    x, y, z = turned(outer.quaternion, inner.position)
    a, b, c = outer.position
    return Placement((a + x, b + y, c + z), product(outer.quaternion, inner.quaternion))


def seen_from(place: Placement) -> Placement:
    """Where the outer frame stands in the placed one."""
    back = inverse(place.quaternion)
    x, y, z = turned(back, place.position)
    return Placement((-x, -y, -z), back)
