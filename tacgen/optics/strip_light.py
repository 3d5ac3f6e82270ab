"""Light from LED strips and their reflections in the plate to the coated face, through flat clear layers.

A deterministic sum over points of each strip. Each connection is refracted at the layers (a 1-D Newton method on the
ray's k = n sin(theta)), has Fresnel losses, and is tested for shadows of the deformed face and of the strips. Light
that was reflected before by coating or walls is in interreflection.py.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tacgen.base.compiled import njit, vectorize
from tacgen.optics.housing import bottom_depth, frame
from tacgen.optics.shadows import FAST_SUM_FLAGS, Terrain, horizon

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tacgen.sensor.model import Led, LitSensor

from numpy.typing import NDArray

Floats = NDArray[np.float64]

# distance of a ray's end from a strip's plane, below which the strip does not block it [mm]
MIN_BLOCKING_DISTANCE_MM = 0.01


class StripPoints(NamedTuple):
    """Quadrature points of the strips."""

    at: Floats  # positions [mm], (p, 3)
    normal: Floats  # unit, (p, 3)
    area: Floats  # that each stands for [mm^2], (p,)
    half: Floats  # half the piece's extent [mm], (p,): how soft its shadow is
    strip: NDArray[np.int64]  # which LED, (p,)
    lobe: NDArray[np.int64]  # power of the cosine by which radiance falls off the normal, (p,)


def points(leds: "Sequence[Led]", along: int, up: int, pieces: int = 1) -> StripPoints:
    """`along` x `up` Gauss-Legendre points on each of the `pieces` of equal length of every strip, with their areas:
    strip by strip, piece by piece, position by position along it, and from bottom to top."""
    at, normal, area, half, strip, lobe = [], [], [], [], [], []
    (a, share_a), (b, share_b) = (np.polynomial.legendre.leggauss(n) for n in (along, up))
    a, share_a = ((2 * np.arange(pieces)[:, None] + 1 + a) / pieces - 1).ravel(), np.tile(share_a / pieces, pieces)
    for k, led in enumerate(leds):
        axes, (w, h) = frame(led.normal, led.up), led.size_mm
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


@vectorize(cache=True)
def fresnel_transmission(k: float, n1: float, n2: float) -> float:
    """Share of unpolarised light that passes from n1 to n2 at k = n sin(theta); 0 beyond the critical angle."""
    if k >= n1 or k >= n2:
        return 0.0
    c1, c2 = np.sqrt(1 - (k / n1) ** 2), np.sqrt(1 - (k / n2) ** 2)
    s, p = (n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2), (n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2)
    return float(1.0 - 0.5 * (s * s + p * p))


@njit(cache=False)
def connect(rho: float, lengths: Floats, indices: Floats) -> tuple[float, float]:
    """k of the ray that travels sideways by rho [mm] through layers of given lengths, and d rho/dk: docs/OPTICS.md."""
    low = np.inf
    paraxial = 0.0
    for i in range(len(lengths)):
        if lengths[i] > 0.0:
            low = min(low, indices[i])
    for i in range(len(lengths)):
        paraxial += lengths[i] * low / indices[i]
    x = rho / paraxial
    for _ in range(20):
        value, slope = 0.0, 0.0
        for i in range(len(lengths)):
            if lengths[i] > 0.0:
                n2 = indices[i] * indices[i]
                root = np.sqrt(n2 + (n2 - low * low) * x * x)
                value += lengths[i] * low * x / root
                slope += lengths[i] * low * n2 / (root * root * root)
        step = (rho - value) / slope
        x += step
        if abs(step) <= 1e-4 * (1.0 + x):  # the remaining error is of the order of its square
            break
    root = np.sqrt(1.0 + x * x)
    k = low * x / root
    derivative = 0.0
    for i in range(len(lengths)):
        if lengths[i] > 0.0:
            n2 = indices[i] * indices[i]
            c2 = max(n2 - k * k, 1e-12)  # rounds to 0 for two points at the same height
            derivative += lengths[i] * n2 / (c2 * np.sqrt(c2))
    return k, derivative


class Arrival(NamedTuple):
    """Light of a point source where it arrives in the outermost layer; docs/OPTICS.md has the formulas."""

    aside: float  # lateral component of the unit vector toward the light
    up: float  # z component of the unit vector toward the light
    leaving: float  # z component of the unit vector along which the light leaves the source
    weight: float  # radiance carried over times solid angle, per area [1/mm^2] normal to the leaving direction


ASIDE_FIELD, TOWARD_FIELD, LEAVING_FIELD, WEIGHT_FIELD = range(4)  # places of these fields in a table


@njit(cache=False)
def arrive(rho: float, z: float, source: float, home: int, image: int, slab: Slab) -> Arrival:
    """Path of light from a point at lateral distance `rho` [mm] and height `source` to height z: direct (image 0), or
    reflected (1).

    Args:
        rho, z, source: see above; z lies in the outermost layer.
        home: the layer of the source.
        image: 1 for light that is first reflected at the slab's bottom.
        slab: light mirrors at its first bottom, against air.
    """
    bottoms, tops, indices = slab
    last = len(indices) - 1
    lengths = np.empty(last + 1)
    sign = 1.0 if image == 0 and source > z else -1.0
    for i in range(last + 1):
        if image == 0:
            lengths[i] = max(min(max(source, z), tops[i]) - max(min(source, z), bottoms[i]), 0.0)
        else:
            lengths[i] = max(min(z, tops[i]) - bottoms[i], 0.0) + max(min(source, tops[i]) - bottoms[i], 0.0)
    lengths[last] = max(lengths[last], 1e-5)  # a strip point level with the sample
    k, derivative = connect(rho, lengths, indices)
    ng, nl = indices[last], indices[home]
    sg, sl = k / ng, k / nl
    cg, cl = np.sqrt(max(1 - sg * sg, 1e-12)), np.sqrt(max(1 - sl * sl, 1e-12))
    passed = 1.0
    for i in range(last):
        if indices[i] != indices[i + 1]:
            if image == 1 or i >= home:
                passed *= fresnel_transmission(k, indices[i + 1], indices[i])
            if image == 1 and i < home:
                passed *= fresnel_transmission(k, indices[i], indices[i + 1])
    if image == 1:
        passed *= 1.0 - fresnel_transmission(k, indices[0], 1.0)
    # solid angle in the gel per area of strip, and radiance carried over as L/n^2
    weight = sg / (ng * cg * derivative * rho) / cl * (ng / nl) ** 2 * passed
    return Arrival(sg, sign * cg, -sign * cl if image == 0 else sign * cl, weight)


@njit(cache=False)
def layer(z: float, tops: Floats) -> int:
    """Index of the layer at height z."""
    home = 0
    while home < len(tops) - 1 and z >= tops[home]:
        home += 1
    return home


@njit(cache=False, error_model="numpy", fastmath=FAST_SUM_FLAGS)
def ggx(turn: float, ci: float, co: float, alpha: float) -> float:
    """GGX reflection times cos(wo), of microfacets with reflectance 1: D G1 G1 / (4 cos wi).

    `turn`: cosine between the directions wi and wo; ci, co: their cosines to the normal, > 0.
    """
    ch2 = (ci + co) ** 2 / (2.0 + 2.0 * turn)
    a2 = alpha * alpha
    q = ch2 * (a2 - 1.0) + 1.0
    g = 4 * ci * co / ((ci + np.sqrt(a2 + (1 - a2) * ci * ci)) * (co + np.sqrt(a2 + (1 - a2) * co * co)))
    return float(a2 / (np.pi * q * q) * g / (4 * ci))


@njit(cache=False)
def crosses(panels: Panels, a: tuple[float, float, float], b: tuple[float, float, float]) -> bool:
    """Whether a strip blocks the straight line from a to b [mm], which may start or end on one."""
    for m in range(len(panels.middle)):
        ta, tb = 0.0, 0.0
        for c in range(3):
            ta += panels.normal[m, c] * (a[c] - panels.middle[m, c])
            tb += panels.normal[m, c] * (b[c] - panels.middle[m, c])
        if not (
            (ta > MIN_BLOCKING_DISTANCE_MM and tb < -MIN_BLOCKING_DISTANCE_MM)
            or (ta < -MIN_BLOCKING_DISTANCE_MM and tb > MIN_BLOCKING_DISTANCE_MM)
        ):
            continue
        share, u, v, u2, v2 = ta / (ta - tb), 0.0, 0.0, 0.0, 0.0
        for c in range(3):
            off = a[c] + share * (b[c] - a[c]) - panels.middle[m, c]
            u, v = u + off * panels.along[m, c], v + off * panels.up[m, c]
            u2, v2 = u2 + panels.along[m, c] ** 2, v2 + panels.up[m, c] ** 2
        if abs(u) < u2 and abs(v) < v2:
            return True
    return False


@njit(cache=False)
def shaded(panels: Panels, p: Floats, source: Floats, home: int, image: int, k: float, slab: Slab) -> bool:
    """Whether a strip blocks the refracted path between a point of the face and a source, direct or reflected.

    Args:
        p, source: the two points [mm], (3,).
        k: n sin(theta) of the way, see connect.
        home, image, slab: see arrive.
    """
    dx, dy = source[0] - p[0], source[1] - p[1]
    rho = max(np.sqrt(dx * dx + dy * dy), 1e-9)
    dx, dy = dx / rho, dy / rho
    r, z, i, down = 0.0, p[2], layer(p[2], slab.tops), image == 1 or source[2] < p[2]
    while True:
        if down:
            end = slab.bottoms[i] if image == 1 or i > home else source[2]
        else:
            end = slab.tops[i] if i < home else source[2]
        ahead = r + abs(end - z) * k / np.sqrt(max(slab.indices[i] ** 2 - k * k, 1e-12))
        if crosses(panels, (p[0] + r * dx, p[1] + r * dy, z), (p[0] + ahead * dx, p[1] + ahead * dy, end)):
            return True
        if i == home and (image == 0 or not down):
            return False
        r, z = ahead, end
        if down and i == 0:
            down = False
        else:
            i += -1 if down else 1


@njit(cache=True)
def gather(
    p: Floats,
    n: Floats,
    view: Floats,
    points: StripPoints,
    strips: int,
    slab: Slab,
    panels: Panels,
    alpha: float,
    terrain: Terrain,
) -> Floats:
    """Radiance toward the camera per unit LED radiance: (samples, strips, 2), for a white Lambertian coat and a
    rough mirror.

    Args:
        p, n, view: samples of the face: positions [mm], unit normals into the gel, unit directions to the camera in
            the gel, each (samples, 3).
        points: quadrature points of that many `strips`.
        slab: light mirrors at its first bottom, against air.
        panels: strips that block light, as the face does.
        alpha: GGX roughness.
        terrain: the face for shadows.
    """
    out = np.zeros((len(p), strips, 2))
    for s in range(len(p)):
        if np.isnan(p[s, 0]):
            continue
        ci = max(n[s, 0] * view[s, 0] + n[s, 1] * view[s, 1] + n[s, 2] * view[s, 2], 0.05)
        for q in range(len(points.at)):
            at, light_normal = points.at[q], points.normal[q]
            dx, dy = at[0] - p[s, 0], at[1] - p[s, 1]
            rho = max(np.sqrt(dx * dx + dy * dy), 1e-9)
            dx, dy = dx / rho, dy / rho
            home = layer(at[2], slab.tops)
            for image in range(2):
                sg, cg, cl, weight = arrive(rho, p[s, 2], at[2], home, image, slab)
                sl = sg * slab.indices[-1] / slab.indices[home]
                co = (n[s, 0] * dx + n[s, 1] * dy) * sg + n[s, 2] * cg
                facing = cl * light_normal[2] - sl * (light_normal[0] * dx + light_normal[1] * dy)
                if co <= 0.0 or facing <= 0.0 or weight <= 0.0:
                    continue
                slope, soft = cg / sg, points.half[q] / rho
                near = (slope - soft, slope + soft)
                edge = horizon(terrain, p[s, 0], p[s, 1], p[s, 2], dx, dy, rho, near, near)
                weight *= (
                    facing ** (1 + points.lobe[q])
                    * points.area[q]
                    * min(max(0.5 + 0.5 * (edge - slope) / soft, 0.0), 1.0)
                )
                if weight <= 0.0 or shaded(panels, p[s], at, home, image, sg * slab.indices[-1], slab):
                    continue
                out[s, points.strip[q], 0] += weight * co / np.pi
                turn = (view[s, 0] * dx + view[s, 1] * dy) * sg + view[s, 2] * cg
                out[s, points.strip[q], 1] += weight * ggx(turn, ci, co, alpha)
    return out
