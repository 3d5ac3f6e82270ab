"""Light from LED strips and their reflections in the plate to the coated face, through flat clear layers.

A deterministic sum over points of each strip. Each connection is refracted at the layers (a 1-D Newton method on the
ray's k = n sin(theta)), has Fresnel losses, and is tested for shadows of the deformed face and of the strips. Light
that was reflected before by coating or walls is in interreflection.py.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tacgen.optics.housing import bottom_depth, frame
from tacgen.optics.shadows import Terrain
from tacgen.physics import runtime, strips

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tacgen.sensor.model import Led, LitSensor

from numpy.typing import NDArray

Floats = NDArray[np.float64]


class StripPoints(NamedTuple):
    """Quadrature points of the strips."""

    at: Floats  # positions [mm], (p, 3)
    normal: Floats  # unit, (p, 3)
    area: Floats  # that each stands for [mm^2], (p,)
    half: Floats  # half the piece's extent [mm], (p,): how soft its shadow is
    strip: NDArray[np.int64]  # which LED, (p,)
    lobe: NDArray[np.int64]  # power of the cosine by which radiance falls off the normal, (p,)

    @property
    def rows(self) -> tuple[Floats, Floats, Floats, NDArray[np.int32]]:
        """Positions, normals, area and half, and strip and lobe, as kernels take them."""
        kinds = np.column_stack([self.strip, self.lobe]).astype(np.int32)
        return self.at, self.normal, np.column_stack([self.area, self.half]), kinds


def points(leds: "Sequence[Led]", along: int, up: int, pieces: "Sequence[int]" = ()) -> StripPoints:
    """`along` x `up` Gauss-Legendre points on each of the `pieces` of equal length of every strip, by default one, with
    their areas: strip by strip, piece by piece, position by position along it, and from bottom to top."""
    at, normal, area, half, strip, lobe = [], [], [], [], [], []
    (ends, shares), (b, share_b) = (np.polynomial.legendre.leggauss(n) for n in (along, up))
    for k, led in enumerate(leds):
        n, axes, (w, h) = pieces[k] if pieces else 1, frame(led.normal, led.up), led.size_mm
        a, share_a = ((2 * np.arange(n)[:, None] + 1 + ends) / n - 1).ravel(), np.tile(shares / n, n)
        for i in range(len(a)):
            for j in range(up):
                at.append(np.array(led.center_mm) + a[i] * w / 2 * axes[:, 0] + b[j] * h / 2 * axes[:, 1])
                normal.append(axes[:, 2])
                area.append(w * h * share_a[i] * share_b[j] / 4)
                half.append(h * share_b[j] / 4)
                strip.append(k)
                lobe.append(led.lobe)
    return StripPoints(np.array(at), np.array(normal), np.array(area), np.array(half), np.array(strip), np.array(lobe))


class Panels(NamedTuple):
    """The strips as rectangles that block light; a strip that blocks none has size 0."""

    middle: Floats  # [mm], (m, 3)
    along: Floats  # half of each side [mm], (m, 3)
    up: Floats
    normal: Floats  # unit, (m, 3)

    @classmethod
    def of(cls, leds: "Sequence[Led]") -> "Panels":
        """The panels of a sensor's LEDs."""
        axes = np.array([frame(led.normal, led.up) for led in leds]).reshape(-1, 3, 3)
        half = np.array([(0.0, 0.0) if led.see_through else led.size_mm for led in leds]).reshape(-1, 2, 1) / 2
        middle = np.array([led.center_mm for led in leds], dtype=float).reshape(-1, 3)
        return cls(middle, axes[:, :, 0] * half[:, 0], axes[:, :, 1] * half[:, 1], axes[:, :, 2].copy())

    @property
    def rows(self) -> Floats:
        """The four of each strip that blocks light (4m, 3), as kernels take them."""
        rows = np.stack([self.middle, self.along, self.up, self.normal], axis=1)
        return rows[self.along.any(axis=1)].reshape(-1, 3)


class Slab(NamedTuple):
    """Flat layers outside the air: bottoms and tops [mm] and indices, from the plate outward, each (layers,)."""

    bottoms: Floats
    tops: Floats
    indices: Floats

    @classmethod
    def of(cls, sensor: "LitSensor") -> "Slab":
        """The plate and the gel's layers; the outermost has no top."""
        t = np.array([sensor.plate.thickness_mm, *(layer.thickness_mm for layer in sensor.gel.clear_layers)])
        n = np.array([sensor.plate.refractive_index, *(layer.refractive_index for layer in sensor.gel.clear_layers)])
        bottoms = np.concatenate([[0.0], np.cumsum(t)[:-1]]) - bottom_depth(sensor)
        tops = bottoms + t
        tops[-1] = np.inf
        return cls(bottoms, tops, n)

    @property
    def rows(self) -> Floats:
        """Bottom, top and index of each layer (layers, 3), as kernels take them."""
        return np.column_stack(self)


def transmission(k: Floats, indices: "Sequence[float]") -> Floats:
    """Share (n,) of unpolarised light that passes from layer to layer of these indices at k = n sin(theta) (n,)."""
    out = np.empty(len(k))
    runtime.call(strips.transmitted, out.shape, k, np.array(indices, dtype=float), out)
    return out


def shadowing(terrain: Terrain) -> tuple[object, ...]:
    """A face as kernels take it: its heights and the least of blocks in a row, where it casts shadows, and its shape
    and size."""
    grids = (grid.reshape(-1) for grid in (terrain.heights, terrain.small, terrain.large))
    return *grids, terrain.extent, *terrain.heights.shape, *terrain.size


def gather(
    p: Floats,
    n: Floats,
    view: Floats,
    points: StripPoints,
    count: int,
    slab: Slab,
    panels: Panels,
    alpha: float,
    terrain: Terrain,
) -> Floats:
    """Radiance toward the camera per unit LED radiance: (samples, count, 2), for a white Lambertian coat and a
    rough mirror.

    Args:
        p, n, view: samples of the face: positions [mm], unit normals into the gel, unit directions to the camera in
            the gel, each (samples, 3).
        points: quadrature points of strips; count: of the strips.
        slab: light mirrors at its first bottom, against air.
        panels: strips that block light, as the face does.
        alpha: GGX roughness.
        terrain: the face for shadows.
    """
    out = np.zeros((len(p), count, 2))
    light = *points.rows, slab.rows, panels.rows, alpha, *shadowing(terrain)
    runtime.call(strips.gathered, (len(p),), p, n, view, *light, out)
    return out
