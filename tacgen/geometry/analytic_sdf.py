"""Signed distances of analytic indenters: each is a core set, offset outward by a rounding radius.

In its own frame an indenter touches z = 0 from above at the origin; its body extends along +z (punch, cone, box and
wedge to infinity). A core gives its closest point c(p) to a point p; distance, normal and curvature follow alike:

    d = |p - c(p)| - r,    n = (p - c)/|p - c|,    H = (I - n n^T - dc/dp) / |p - c|

Inside a core d decreases linearly, so that a gel that overlaps it at the start is pushed out.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol

import numpy as np

if TYPE_CHECKING:
    from tacgen.geometry.convex_edges import Convex

Array = np.ndarray
DOWNWARD = np.array([0.0, 0.0, -1.0])
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
    def reach(self) -> float:
        """Largest depth of a gel point inside that is pushed out on the side where it entered [mm]."""

    def distance(self, p: Array) -> tuple[Array, Array, Array]:
        """Signed distance [mm] (n,), its gradient (n, 3) and Hessian [1/mm] (n, 3, 3) at points p (n, 3) [mm]."""

    def value(self, p: Array) -> Array:
        """Signed distance [mm] (n,) alone, in an eighth of the time."""

    def gradient(self, p: Array) -> tuple[Array, Array]:
        """Signed distance [mm] (n,) and its gradient (n, 3), without the Hessian."""

    def support(self, direction: Array) -> float:
        """Support function: extent along a unit vector (3,) [mm]; inf where the shape is infinite."""


class Core(NamedTuple):
    """Closest core points c (n, 3), dc/dp (n, 3, 3), depth inside the core (n,) >= 0 and direction out of it (n, 3);
    functions give what the distance alone does not need.

    A core that is a point or a line has no interior: on it the direction out is down."""

    closest: Array
    jacobian: Callable[[], Array]
    depth: Array | float = 0.0
    out: Callable[[], Array] = lambda: DOWNWARD


def lowest(support: Callable[[Array], float], rotation: Array) -> Array:
    """The lowest point (3,) of a rotated shape relative to its origin [mm]; of a lowest edge or face its centre.

    It is the gradient of the support function, by central differences.
    """
    down, step = -rotation[2], 1e-5
    ends = [[e / np.linalg.norm(e) for e in (down + s, down - s)] for s in step * np.eye(3)]
    slope = np.array([support(ahead) - support(behind) for ahead, behind in ends]) / (2 * step)
    flat = rotation @ slope  # unit vectors alone are compared, so the component along `down` is not found
    return np.array([flat[0], flat[1], -support(down)])


class Grown(ABC):
    """A core offset outward by `smallest_radius`; see Shape."""

    convex: ClassVar[None] = None

    @property
    @abstractmethod
    def smallest_radius(self) -> float: ...

    @abstractmethod
    def core(self, p: Array) -> Core:
        """The core as seen from points p (n, 3)."""

    def value(self, p: Array) -> Array:
        return self._seen(p)[0]

    def gradient(self, p: Array) -> tuple[Array, Array]:
        d, core, v, length, inside = self._seen(p)
        return d, _outward(core, v, length, inside)

    def distance(self, p: Array) -> tuple[Array, Array, Array]:
        d, core, v, length, inside = self._seen(p)
        n, safe = _outward(core, v, length, inside), np.where(inside, 1.0, length)
        H = np.einsum("ni,nj->nij", -n, n)  # in place from here on: twice as fast as with an array for each operation
        H += np.eye(3) - core.jacobian()
        H /= safe[:, None, None]
        H[inside] = 0.0
        return d, n, H

    def _seen(self, p: Array) -> tuple[Array, Core, Array, Array, Array]:
        """Signed distance (n,) and core; way from the core (n, 3), its length (n,), and whether a point is inside."""
        core = self.core(p)
        v = p - core.closest
        x, y, z = v.T
        length = np.sqrt(x * x + y * y + z * z)  # the norm, in a third of its time
        inside = (core.depth > 0) | (length < 1e-12)
        return np.where(inside, -core.depth, length) - self.smallest_radius, core, v, length, inside


def _outward(core: Core, v: Array, length: Array, inside: Array) -> Array:
    """Unit vectors (n, 3) along v (n, 3), of such length (n,), where points are not inside a core, else out of it."""
    if not inside.any():
        return np.asarray(v / length[:, None])
    return np.where(inside[:, None], core.out(), v / np.where(inside, 1.0, length)[:, None])


def _polar(p: Array) -> tuple[Array, Array, Array]:
    """Distance from the z axis (n,), radial (n, 3) and azimuthal (n, 3) unit vectors; on the axis those of x and y."""
    rho = np.hypot(p[:, 0], p[:, 1])
    on_axis = rho < 1e-12
    c = np.where(on_axis, 1.0, p[:, 0] / np.where(on_axis, 1.0, rho))
    s = np.where(on_axis, 0.0, p[:, 1] / np.where(on_axis, 1.0, rho))
    zero = np.zeros_like(c)
    return rho, np.stack([c, s, zero], 1), np.stack([-s, c, zero], 1)


def _outer(a: Array) -> Array:
    return np.asarray(a[:, :, None] * a[:, None, :])


def _diagonal(entries: Array) -> Array:
    return np.asarray(entries[:, :, None] * np.eye(3))


def _nearest(inside_by: list[Array], normals: list[Array]) -> Array:
    """Direction out (n, 3) from distances (n,) inside each face and the faces' normals (n, 3)."""
    face = np.argmin(inside_by, axis=0)
    return np.asarray(np.stack(normals)[face, np.arange(len(face))])


def _depth(inside_by: list[Array]) -> Array:
    """Depth (n,) from distances (n,) inside each face."""
    return np.asarray(np.maximum(np.min(inside_by, axis=0), 0.0))


@dataclass(frozen=True)
class SphereSdf(Grown):
    """A ball."""

    radius: float  # [mm]

    @property
    def smallest_radius(self) -> float:
        return self.radius

    @property
    def reach(self) -> float:
        return self.radius

    def support(self, direction: Array) -> float:
        return self.radius * (1 + float(direction[2]))

    def core(self, p: Array) -> Core:
        centre = np.array([0.0, 0.0, self.radius])
        return Core(centre, lambda: np.zeros((3, 3)))


@dataclass(frozen=True)
class CapsuleSdf(Grown):
    """A capsule along x; `length` is between the centres of its two hemispheres."""

    radius: float  # [mm]
    length: float  # [mm]

    @property
    def smallest_radius(self) -> float:
        return self.radius

    @property
    def reach(self) -> float:
        return self.radius

    def support(self, direction: Array) -> float:
        return self.radius * (1 + float(direction[2])) + self.length / 2 * abs(float(direction[0]))

    def core(self, p: Array) -> Core:
        half = self.length / 2
        along = np.clip(p[:, 0], -half, half)
        c = np.stack([along, np.zeros_like(along), np.full_like(along, self.radius)], 1)
        return Core(c, lambda: _diagonal((np.abs(p[:, :1]) < half) * [1.0, 0.0, 0.0]))


@dataclass(frozen=True)
class TorusSdf(Grown):
    """A flat ring; `radius` is that of its centre line."""

    radius: float  # [mm]
    tube_radius: float  # [mm]

    @property
    def smallest_radius(self) -> float:
        return self.tube_radius

    @property
    def reach(self) -> float:
        return self.tube_radius

    def support(self, direction: Array) -> float:
        return self.tube_radius * (1 + float(direction[2])) + self.radius * float(np.hypot(*direction[:2]))

    def core(self, p: Array) -> Core:
        rho, radial, azimuth = _polar(p)
        c = self.radius * radial
        c[:, 2] = self.tube_radius
        return Core(c, lambda: _outer(azimuth) * (self.radius / np.maximum(rho, 1e-12))[:, None, None])


@dataclass(frozen=True)
class CylinderSdf(Grown):
    """A flat cylindrical punch along z; its lower edge has the radius `fillet`."""

    radius: float  # [mm]
    fillet: float  # [mm]

    @property
    def smallest_radius(self) -> float:
        return self.fillet

    @property
    def reach(self) -> float:
        return self.radius

    def support(self, direction: Array) -> float:
        if direction[2] > 1e-12:
            return np.inf
        return self.fillet * (1 + float(direction[2])) + (self.radius - self.fillet) * float(np.hypot(*direction[:2]))

    def core(self, p: Array) -> Core:
        rho, radial, azimuth = _polar(p)
        rim, low = self.radius - self.fillet, self.fillet
        c_rho, c_z = np.minimum(rho, rim), np.maximum(p[:, 2], low)
        c = c_rho[:, None] * radial
        c[:, 2] = c_z

        def jacobian() -> Array:
            jac = _outer(azimuth) * np.where(rho > rim, rim / np.maximum(rho, 1e-12), 1.0)[:, None, None]
            jac += _outer(radial) * (rho < rim)[:, None, None]
            jac[:, 2, 2] += p[:, 2] > low
            return jac

        by = [p[:, 2] - low, rim - rho]
        return Core(c, jacobian, _depth(by), lambda: _nearest(by, [np.broadcast_to(DOWNWARD, p.shape), radial]))


@dataclass(frozen=True)
class BoxSdf(Grown):
    """A rectangular punch with sides along x and y; all edges have the radius `fillet`."""

    size_x: float  # [mm]
    size_y: float  # [mm]
    fillet: float  # [mm]

    @property
    def smallest_radius(self) -> float:
        return self.fillet

    @property
    def reach(self) -> float:
        return min(self.size_x, self.size_y) / 2

    def support(self, direction: Array) -> float:
        if direction[2] > 1e-12:
            return np.inf
        half = np.array([self.size_x, self.size_y]) / 2 - self.fillet
        return self.fillet * (1 + float(direction[2])) + float(half @ np.abs(direction[:2]))

    def core(self, p: Array) -> Core:
        half = np.array([self.size_x, self.size_y]) / 2 - self.fillet
        c = np.stack([*np.clip(p[:, :2], -half, half).T, np.maximum(p[:, 2], self.fillet)], 1)
        by = [p[:, 2] - self.fillet, *(half - np.abs(p[:, :2])).T]

        def out() -> Array:
            sign = np.where(p[:, :2] >= 0, 1.0, -1.0)
            return _nearest(
                by, [np.broadcast_to(DOWNWARD, p.shape), *(np.outer(sign[:, k], np.eye(3)[k]) for k in (0, 1))]
            )

        return Core(c, lambda: _diagonal((c == p).astype(float)), _depth(by), out)


@dataclass(frozen=True)
class ConeSdf(Grown):
    """Tip down, rounded by `tip_radius`; `half_angle` [rad] is from the axis."""

    half_angle: float
    tip_radius: float  # [mm]

    @property
    def smallest_radius(self) -> float:
        return self.tip_radius

    @property
    def reach(self) -> float:
        return np.inf

    def support(self, direction: Array) -> float:
        flank = np.hypot(*direction[:2]) * np.sin(self.half_angle) + direction[2] * np.cos(self.half_angle)
        return np.inf if flank > 1e-12 else self.tip_radius * (1 + float(direction[2]))

    def core(self, p: Array) -> Core:
        rho, radial, azimuth = _polar(p)
        s, c = np.sin(self.half_angle), np.cos(self.half_angle)
        z = p[:, 2] - self.tip_radius
        along = np.maximum(rho * s + z * c, 0.0)
        outward = rho * c - z * s  # distance outside the core's side, where along > 0
        side = (along > 0)[:, None, None]
        inside = (along > 0) & (outward < 0)
        closest = (along * s)[:, None] * radial
        closest[:, 2] = along * c + self.tip_radius

        def jacobian() -> Array:
            generator = radial * s + np.array([0.0, 0.0, c])
            turning = (along * s / np.maximum(rho, 1e-12))[:, None, None]
            return np.asarray(side * (_outer(generator) + _outer(azimuth) * turning))

        def out() -> Array:
            return np.where(side[:, :, 0], radial * c - np.array([0.0, 0.0, s]), DOWNWARD)

        return Core(closest, jacobian, np.where(inside, -outward, 0.0), out)


@dataclass(frozen=True)
class WedgeSdf(Grown):
    """An edge along y, rounded by `tip_radius`; `half_angle` [rad] is from the z axis; `length` includes the ends."""

    half_angle: float
    tip_radius: float  # [mm]
    length: float  # [mm]

    @property
    def smallest_radius(self) -> float:
        return self.tip_radius

    @property
    def reach(self) -> float:
        return self.length / 2

    def support(self, direction: Array) -> float:
        flank = abs(direction[0]) * np.sin(self.half_angle) + direction[2] * np.cos(self.half_angle)
        along = (self.length / 2 - self.tip_radius) * abs(float(direction[1]))
        return np.inf if flank > 1e-12 else self.tip_radius * (1 + float(direction[2])) + along

    def core(self, p: Array) -> Core:
        s, c = np.sin(self.half_angle), np.cos(self.half_angle)
        sign = np.where(p[:, 0] >= 0, 1.0, -1.0)
        z = p[:, 2] - self.tip_radius
        along = np.maximum(np.abs(p[:, 0]) * s + z * c, 0.0)
        outward = np.abs(p[:, 0]) * c - z * s
        within = (along > 0) & (outward < 0)  # in the cross-section
        half = self.length / 2 - self.tip_radius
        y = np.clip(p[:, 1], -half, half)
        closest = np.stack([sign * along * s, y, along * c + self.tip_radius], 1)
        closest[within, 0], closest[within, 2] = p[within, 0], p[within, 2]
        zero = np.zeros_like(sign)

        def jacobian() -> Array:
            jac = (along > 0)[:, None, None] * _outer(np.stack([sign * s, zero, np.full_like(sign, c)], 1))
            jac[within] = np.diag([1.0, 0.0, 1.0])
            jac[:, 1, 1] += np.abs(p[:, 1]) < half
            return np.asarray(jac)

        by = [np.where(along > 0, -outward, -1.0), half - np.abs(p[:, 1])]

        def out() -> Array:
            end = np.stack([zero, np.where(p[:, 1] >= 0, 1.0, -1.0), zero], 1)
            return _nearest(by, [np.stack([sign * c, zero, np.full_like(sign, -s)], 1), end])

        return Core(closest, jacobian, _depth(by), out)
