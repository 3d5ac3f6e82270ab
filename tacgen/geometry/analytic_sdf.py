"""Signed distances of analytic indenters: each is a core set, offset outward by a rounding radius.

In its own frame an indenter touches z = 0 from above at the origin; its body extends along +z (box, cone, wedge
and a punch without length to infinity). A core gives its closest point c(p) to a point p; distance, normal and
curvature follow alike:

    d = |p - c(p)| - r,    n = (p - c)/|p - c|,    H = (I - n n^T - dc/dp) / |p - c|

Inside a core d decreases linearly, so that a gel that overlaps it at the start is pushed out.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, cast

import numpy as np

if TYPE_CHECKING:
    from tacgen.geometry.convex_edges import Convex

Array = np.ndarray
MAX_ROUNDED_SLOPE = 1e-12  # component of a unit vector up to which it is a rounding error [-]
MAX_SDF_SLOPE = 1.1  # largest slope of a signed distance: 1, and slightly more where it is interpolated [-]


class Shape(Protocol):
    """A rigid indenter in its own frame."""

    @property
    def smallest_radius(self) -> float:
        """Smallest radius of curvature that can touch the gel [mm]."""

    @property
    def convex(self) -> "Convex | None":
        """The convex edges and tips; None: all have the `smallest_radius`."""

    @property
    def record(self) -> "Record":
        """Its numbers for kernels."""

    @property
    def reach(self) -> float:
        """Largest depth of a gel point inside that is pushed out on the side where it entered [mm]."""

    def distance(self, p: Array) -> tuple[Array, Array, Array]:
        """Signed distance [mm] (n,), its gradient (n, 3) and Hessian [1/mm] (n, 3, 3) at points p (n, 3) [mm]."""

    def value(self, p: Array) -> Array:
        """Signed distance [mm] (n,) alone."""

    def gradient(self, p: Array) -> tuple[Array, Array]:
        """Signed distance [mm] (n,) and its gradient (n, 3), without the Hessian."""

    def support(self, direction: Array) -> float:
        """Support function: extent along a unit vector (3,) [mm]; inf where the shape is infinite."""


class Record(NamedTuple):
    """An indenter as kernels take it: numbers (1, k), values and lists; see physics.distances."""

    numbers: Array
    values: Array = np.zeros(0)
    lists: Array = np.zeros(0, np.int32)


class Recorded(ABC):
    """A Shape whose distances are a kernel's."""

    @property
    @abstractmethod
    def record(self) -> Record: ...

    def value(self, p: Array) -> Array:
        return self._at(p, False, False)[0]

    def gradient(self, p: Array) -> tuple[Array, Array]:
        return self._at(p, True, False)[:2]

    def distance(self, p: Array) -> tuple[Array, Array, Array]:
        return self._at(p, True, True)

    def _at(self, p: Array, sloped: bool, bent: bool) -> tuple[Array, Array, Array]:
        """Signed distance (n,) at points p (n, 3), its gradient (n, 3) and Hessian (n, 3, 3) if wanted."""
        from tacgen.physics.distances import distances  # recipes are checked without it
        from tacgen.physics.runtime import call

        count = len(p)
        n, H = np.empty((int(sloped), count, 3)), np.empty((int(bent), count, 3, 3))
        d = np.empty((1, count))
        call(distances, d.shape, np.asarray(p, float)[None], *self.record, d, n, H)
        return d[0], n.reshape(-1, 3), H.reshape(-1, 3, 3)


def lowest(support: Callable[[Array], float], rotation: Array) -> Array:
    """The lowest point (3,) of a rotated shape relative to its origin [mm]; of a lowest edge or face its centre.

    It is the gradient of the support function, by central differences.
    """
    down, step = -rotation[2], 1e-5
    ends = [[e / np.linalg.norm(e) for e in (down + s, down - s)] for s in step * np.eye(3)]
    slope = np.array([support(ahead) - support(behind) for ahead, behind in ends]) / (2 * step)
    flat = rotation @ slope  # unit vectors alone are compared, so the component along `down` is not found
    return np.array([flat[0], flat[1], -support(down)])


class Grown(Recorded):
    """A core offset outward by `smallest_radius`; the core is `core` in physics.cores, its numbers the fields here."""

    convex: ClassVar[None] = None
    core: ClassVar[str]
    rounding: ClassVar[str] = "radius"  # the field that is the smallest radius

    @property
    def smallest_radius(self) -> float:
        return float(getattr(self, self.rounding))

    @property
    def reach(self) -> float:
        return self.smallest_radius

    @cached_property
    def record(self) -> Record:
        from tacgen.physics.cores import FIRST_NUMBER, ShapeNumber
        from tacgen.physics.edges import ROW_NUMBERS

        numbers = np.zeros((1, ROW_NUMBERS))
        own = [getattr(self, field.name) for field in fields(cast(Any, self))]
        numbers[0, 0], numbers[0, FIRST_NUMBER : FIRST_NUMBER + len(own)] = ShapeNumber[self.core], own
        return Record(numbers)


@dataclass(frozen=True)
class SphereSdf(Grown):
    """A ball."""

    core: ClassVar[str] = "sphere"
    radius: float  # [mm]

    def support(self, direction: Array) -> float:
        return self.radius * (1 + float(direction[2]))


@dataclass(frozen=True)
class CapsuleSdf(Grown):
    """A capsule along x; `length` is between the centres of its two hemispheres."""

    core: ClassVar[str] = "capsule"
    radius: float  # [mm]
    length: float  # [mm]

    def support(self, direction: Array) -> float:
        return self.radius * (1 + float(direction[2])) + self.length / 2 * abs(float(direction[0]))


@dataclass(frozen=True)
class TorusSdf(Grown):
    """A flat ring; `radius` is that of its centre line."""

    core: ClassVar[str] = "torus"
    rounding: ClassVar[str] = "tube_radius"
    radius: float  # [mm]
    tube_radius: float  # [mm]

    def support(self, direction: Array) -> float:
        return self.tube_radius * (1 + float(direction[2])) + self.radius * float(np.hypot(*direction[:2]))


@dataclass(frozen=True)
class CylinderSdf(Grown):
    """A flat cylindrical punch along z, `length` high; its edges have the radius `fillet`."""

    core: ClassVar[str] = "cylinder"
    rounding: ClassVar[str] = "fillet"
    radius: float  # [mm]
    fillet: float  # [mm]
    length: float = np.inf  # [mm]

    @property
    def reach(self) -> float:
        return min(self.radius, self.length / 2)

    def support(self, direction: Array) -> float:
        up = float(direction[2])
        along = (self.length - self.fillet if up > MAX_ROUNDED_SLOPE else self.fillet) * up
        return self.fillet + along + (self.radius - self.fillet) * float(np.hypot(*direction[:2]))


@dataclass(frozen=True)
class BoxSdf(Grown):
    """A rectangular punch with sides along x and y; all edges have the radius `fillet`."""

    core: ClassVar[str] = "box"
    rounding: ClassVar[str] = "fillet"
    size_x: float  # [mm]
    size_y: float  # [mm]
    fillet: float  # [mm]

    @property
    def reach(self) -> float:
        return min(self.size_x, self.size_y) / 2

    def support(self, direction: Array) -> float:
        if direction[2] > MAX_ROUNDED_SLOPE:
            return np.inf
        half = np.array([self.size_x, self.size_y]) / 2 - self.fillet
        return self.fillet * (1 + float(direction[2])) + float(half @ np.abs(direction[:2]))


@dataclass(frozen=True)
class ConeSdf(Grown):
    """Tip down, rounded by `tip_radius`; `half_angle` [rad] is from the axis."""

    core: ClassVar[str] = "cone"
    rounding: ClassVar[str] = "tip_radius"
    half_angle: float
    tip_radius: float  # [mm]

    @property
    def reach(self) -> float:
        return np.inf

    def support(self, direction: Array) -> float:
        flank = np.hypot(*direction[:2]) * np.sin(self.half_angle) + direction[2] * np.cos(self.half_angle)
        return np.inf if flank > MAX_ROUNDED_SLOPE else self.tip_radius * (1 + float(direction[2]))


@dataclass(frozen=True)
class WedgeSdf(Grown):
    """An edge along y, rounded by `tip_radius`; `half_angle` [rad] is from the z axis; `length` includes the ends."""

    core: ClassVar[str] = "wedge"
    rounding: ClassVar[str] = "tip_radius"
    half_angle: float
    tip_radius: float  # [mm]
    length: float  # [mm]

    @property
    def reach(self) -> float:
        return self.length / 2

    def support(self, direction: Array) -> float:
        flank = abs(direction[0]) * np.sin(self.half_angle) + direction[2] * np.cos(self.half_angle)
        along = (self.length / 2 - self.tip_radius) * abs(float(direction[1]))
        return np.inf if flank > MAX_ROUNDED_SLOPE else self.tip_radius * (1 + float(direction[2])) + along
