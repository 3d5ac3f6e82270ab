"""The sum over strips for whole images: the light of each column of a strip is tabulated over positions in the gel.

A column is a piece of a strip with the strip's full height. Its light at a position, direct and reflected, is an
irradiance vector and a range of slopes, summed over enough points to be exact and smooth in position. The samples of an
image interpolate the table; then the normal and the shadows of the deformed face are applied.
"""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacgen.base.compiled import njit
from tacgen.geometry.rasterize import Hits
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.shadows import FAST_SUM_FLAGS, Terrain, horizon
from tacgen.optics.strip_light import (
    ASIDE_FIELD,
    LEAVING_FIELD,
    TOWARD_FIELD,
    WEIGHT_FIELD,
    Panels,
    Slab,
    StripPoints,
    arrive,
    ggx,
    points,
    shaded,
)

if TYPE_CHECKING:
    from tacgen.sensor.model import LitSensor

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Single = np.float32

LATERAL_STEP_MM = 0.1  # spacing of the lateral distances for which connections are tabulated [mm]
# smallest and largest spacing of positions [mm]; spacing over the strips' distance [-]
POSITION_SPACINGS_MM, POSITION_SPACING_RATIO = (0.2, 0.4), 0.15
HEIGHT_STEP_MM = 0.5  # spacing of the heights [mm]
MAX_BULGE_MM = 1.0  # largest height of a bulging face above the untouched one [mm]
POINTS_ALONG_COLUMN, POINTS_ACROSS_COLUMN = 2, 16  # quadrature points along and across a column
SLOPE_RANGE = (-9.0, 9.0)  # range that contains all slopes [-]
MAX_NORMAL_Z = -1e-3  # largest z component of a normal [-]


# Fields of a column's light: its irradiance vector times distance^2 [mm^2], and half its range of slopes [-].
IRRADIANCE_X, IRRADIANCE_Y, IRRADIANCE_Z, HALF_SLOPE_RANGE = range(FIELDS := 4)

# A column's light on a point of the face: lateral part of the irradiance vector times distance^2, over its range of
# slopes [mm^2]; its least slope (rise over sideways way); the greatest that does not come from behind the face; and the
# slope of the face, from which on it does [-].
LATERAL_LIGHT, LOWEST_SLOPE, HIGHEST_SLOPE, TURNING_SLOPE = range(4)


class Columns(NamedTuple):
    """Columns of a sensor's strips, and the table of their light."""

    middle: Floats  # [mm], (columns, 3)
    strip: NDArray[np.int64]  # which LED, (columns,)
    lowest: Floats  # corner of the table [mm], (3,): x, y, z
    step: Floats  # between its entries [mm], (3,)
    # X of each column's direct light per unit radiance and then of its reflected; likewise Y, Z and HALF_SLOPE_RANGE;
    # then of each column the slope up to which the untouched face lets light pass.
    light: Singles  # (heights, rows, columns of places, (2 FIELDS + 1) x columns)
    mirror: float  # height of the plate's air face [mm]

    @classmethod
    def of(cls, sensor: "LitSensor", pieces: int, untouched: Terrain) -> "Columns":
        """Each strip in so many `pieces`, for faces anywhere in the outermost layer before the camera."""
        from scipy.ndimage import map_coordinates

        field, slab, lights = (
            seen(sensor),
            Slab.of(sensor),
            points(sensor.leds, POINTS_ALONG_COLUMN, POINTS_ACROSS_COLUMN, pieces),
        )
        heights, level = np.unique(lights.at[:, 2].round(6), return_inverse=True)
        home = np.searchsorted(slab.tops[:-1], heights, side="right")
        z = np.linspace(
            slab.bottoms[-1] + 0.1 * HEIGHT_STEP_MM,
            MAX_BULGE_MM,
            round((MAX_BULGE_MM - slab.bottoms[-1]) / HEIGHT_STEP_MM) + 1,
        )
        reach = np.linalg.norm(np.abs(lights.at[:, :2]).max(axis=0) + np.abs(field).max(axis=0))
        aside = np.arange(0.0, reach + 2 * LATERAL_STEP_MM, LATERAL_STEP_MM)
        aside[0] = 1e-3 * LATERAL_STEP_MM
        off = lights.at - np.column_stack([np.clip(lights.at[:, :2], *field), np.zeros(len(lights.at))])
        place = np.clip(POSITION_SPACING_RATIO * np.linalg.norm(off, axis=1).min(), *POSITION_SPACINGS_MM)
        x, y = (np.linspace(low, high, math.ceil((high - low) / place) + 1) for low, high in field.T)
        places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        count = np.array(untouched.heights.shape[::-1]) - 1
        face = map_coordinates(untouched.heights, ((places / untouched.size + 0.5) * count).T[::-1], order=1)
        places = np.column_stack([places, face])
        middle = lights.at.reshape(-1, POINTS_ALONG_COLUMN * POINTS_ACROSS_COLUMN, 3).mean(axis=1)
        table = tabulate(z, aside, heights, home, slab)
        light = column_light(places, z, lights, middle, level, home, table, Panels.of(sensor.leds), slab)
        lowest, step = np.array([x[0], y[0], z[0]]), np.array([x[1] - x[0], y[1] - y[0], z[1] - z[0]])
        horizons = untouched_horizons(places, z, middle, untouched)
        light = np.concatenate([np.moveaxis(light, 3, 2).reshape(len(z), len(places), -1), horizons], axis=2)
        light = light.reshape(len(z), len(y), len(x), -1)
        return cls(
            middle,
            lights.strip[:: POINTS_ALONG_COLUMN * POINTS_ACROSS_COLUMN].copy(),
            lowest,
            step,
            light,
            float(slab.bottoms[0]),
        )


def seen(sensor: "LitSensor") -> Floats:
    """The part of the gel that the camera sees, (2, 2): least and greatest x and y [mm], on the pad."""
    camera, half = PinholeCamera.from_sensor(sensor), np.array([sensor.gel.width_mm, sensor.gel.height_mm]) / 2
    (h, w) = camera.shape
    near, way = camera.rays([[0, 0], [w, 0], [0, h], [w, h]])
    ends = np.concatenate([near, near + way * ((MAX_BULGE_MM - near[:, 2:]) / way[:, 2:])])[:, :2]
    return np.asarray(
        np.clip([ends.min(axis=0) - POSITION_SPACINGS_MM[1], ends.max(axis=0) + POSITION_SPACINGS_MM[1]], -half, half)
    )


@njit(cache=True)
def tabulate(z: Floats, aside: Floats, sources: Floats, home: NDArray[np.int64], slab: Slab) -> Singles:
    """strip_light.arrive for every source, way aside, image and height: (sources, ways, 2, 4, heights)."""
    out = np.empty((len(sources), len(aside), 2, 4, len(z)), np.float32)
    for s in range(len(sources)):
        for r in range(len(aside)):
            for image in range(2):
                for i in range(len(z)):
                    arrived = arrive(aside[r], z[i], sources[s], home[s], image, slab)
                    for part in range(4):  # a slice assignment takes three seconds longer to compile
                        out[s, r, image, part, i] = arrived[part]
    return out


@njit(cache=True, error_model="numpy", fastmath=FAST_SUM_FLAGS)
def column_light(
    places: Floats,
    z: Floats,
    points: StripPoints,
    middle: Floats,
    level: NDArray[np.int64],
    home: NDArray[np.int64],
    table: Singles,
    panels: Panels,
    slab: Slab,
) -> Singles:
    """Columns.light at heights z (m,) over places (n, 3) of the untouched face: (m, n, columns, 2 FIELDS).

    Light that strips block at a place of the untouched face counts as blocked at all heights there.

    Args:
        points: those of the columns, one column after the other, their middles being `middle` (columns, 3).
        level, home: index (p,) of each point's height in the table, and the layer of each height.
        table: see tabulate.
    """
    out = np.zeros((len(z), len(places), len(middle), 2 * FIELDS), np.float32)
    none, one = np.float32(0.0), np.float32(1.0)
    each, opaque = len(points.at) // len(middle), np.abs(panels.along).sum() > 0.0
    half = np.float32(0.5 * POINTS_ACROSS_COLUMN / each)
    light, least, most = (
        np.empty((2, FIELDS, len(z)), np.float32),
        np.empty((2, len(z)), np.float32),
        np.empty((2, len(z)), np.float32),
    )
    weight, facing = np.empty(len(z), np.float32), np.empty(len(z), np.float32)
    for s in range(len(places)):
        p = places[s]
        untouched = min(max((p[2] - z[0]) / (z[1] - z[0]), 0.0), len(z) - 1.001)
        below = int(untouched)
        share = untouched - below
        for c in range(len(middle)):
            light[:] = 0.0
            for q in range(c * each, (c + 1) * each):
                if q % POINTS_ACROSS_COLUMN == 0:
                    least[:], most[:] = np.inf, -np.inf
                dx, dy = points.at[q, 0] - p[0], points.at[q, 1] - p[1]
                rho = max(np.sqrt(dx * dx + dy * dy), 1e-9)
                dx, dy, r = dx / rho, dy / rho, int(rho / LATERAL_STEP_MM)
                far = np.float32(rho / LATERAL_STEP_MM - r)
                near, x, y, soft = one - far, np.float32(dx), np.float32(dy), np.float32(points.half[q] / rho)
                index, normal = slab.indices[-1] / slab.indices[home[level[q]]], points.normal[q]
                aside = np.float32(index * (normal[0] * dx + normal[1] * dy))
                up, area = np.float32(normal[2]), np.float32(points.area[q])
                for image in range(2):
                    low, high = table[level[q], r, image], table[level[q], r + 1, image]
                    if opaque:
                        k = (1 - share) * (near * low[ASIDE_FIELD, below] + far * high[ASIDE_FIELD, below])
                        k += share * (near * low[ASIDE_FIELD, below + 1] + far * high[ASIDE_FIELD, below + 1])
                        k *= slab.indices[-1]
                        if shaded(panels, p, points.at[q], home[level[q]], image, k, slab):
                            continue
                    for i in range(len(z)):
                        sine = near * low[ASIDE_FIELD, i] + far * high[ASIDE_FIELD, i]
                        facing[i] = (near * low[LEAVING_FIELD, i] + far * high[LEAVING_FIELD, i]) * up - sine * aside
                        facing[i] = max(facing[i], np.float32(0.0))
                        weight[i] = area * facing[i] * (near * low[WEIGHT_FIELD, i] + far * high[WEIGHT_FIELD, i])
                    for _ in range(points.lobe[q]):
                        for i in range(len(z)):
                            weight[i] *= facing[i]
                    for i in range(len(z)):
                        sine = near * low[ASIDE_FIELD, i] + far * high[ASIDE_FIELD, i]
                        rise = near * low[TOWARD_FIELD, i] + far * high[TOWARD_FIELD, i]
                        light[image, IRRADIANCE_X, i] += weight[i] * sine * x
                        light[image, IRRADIANCE_Y, i] += weight[i] * sine * y
                        light[image, IRRADIANCE_Z, i] += weight[i] * rise
                        least[image, i] = min(least[image, i], rise / sine - soft)
                        most[image, i] = max(most[image, i], rise / sine + soft)
                if (q + 1) % POINTS_ACROSS_COLUMN == 0:
                    for image in range(2):
                        for i in range(len(z)):
                            light[image, HALF_SLOPE_RANGE, i] += max(most[image, i] - least[image, i], none) * half
            away2 = (middle[c, 0] - p[0]) ** 2 + (middle[c, 1] - p[1]) ** 2
            for image in range(2):
                for i in range(len(z)):
                    height = (2 * slab.bottoms[0] if image == 1 else 2 * z[i]) - middle[c, 2] - z[i]
                    for m in (IRRADIANCE_X, IRRADIANCE_Y, IRRADIANCE_Z):
                        out[i, s, c, 2 * m + image] = light[image, m, i] * (away2 + height * height)
                    out[i, s, c, 2 * HALF_SLOPE_RANGE + image] = light[image, HALF_SLOPE_RANGE, i]
    return out


@njit(cache=True)
def untouched_horizons(places: Floats, z: Floats, middle: Floats, untouched: Terrain) -> Singles:
    """Greatest slope that passes the untouched face from heights z (m,) over places (n, 3) of it toward each column:
    (m, n, columns). Above the face it is extrapolated linearly, which is exact if the occluder is far away."""
    out = np.empty((len(z), len(places), len(middle)), np.float32)
    for s in range(len(places)):
        x, y, face = places[s]
        for c in range(len(middle)):
            dx, dy = middle[c, 0] - x, middle[c, 1] - y
            rho = max(np.sqrt(dx * dx + dy * dy), 1e-9)
            dx, dy = dx / rho, dy / rho
            lower, level = 0.0, 0.0
            for i in range(-2, len(z)):  # first below the face and on it
                height = z[i] if i >= 0 else face + (i + 1) * HEIGHT_STEP_MM
                if i >= 0 and height >= face:
                    out[i, s, c] = level + (level - lower) / HEIGHT_STEP_MM * (height - face)
                    continue
                found = horizon(untouched, x, y, height, dx, dy, rho, SLOPE_RANGE, SLOPE_RANGE)
                if i >= 0:
                    out[i, s, c] = found
                lower, level = (found, level) if i == -2 else (lower, found if i == -1 else level)
    return out


@njit(cache=False)
def point(hits: Hits, values: Floats, i: int) -> tuple[float, float, float]:
    """The three values (nodes, 3) at sample `i`, as in `blend`."""
    t, v, w = hits.triangle[i], hits.place[i, 0], hits.place[i, 1]
    if t < 0:
        return np.nan, np.nan, np.nan
    a, b, c, u = hits.faces[t, 0], hits.faces[t, 1], hits.faces[t, 2], 1.0 - v - w
    x = u * values[a, 0] + v * values[b, 0] + w * values[c, 0]
    y = u * values[a, 1] + v * values[b, 1] + w * values[c, 1]
    return x, y, u * values[a, 2] + v * values[b, 2] + w * values[c, 2]


@njit(cache=True, error_model="numpy", fastmath=FAST_SUM_FLAGS)
def toward_camera(
    index: NDArray[np.int64],
    hits: Hits,
    nodes: Floats,
    normals: Floats,
    views: Floats,
    passed: Floats,
    columns: Columns,
    matt: Floats,
    gloss: Floats,
    alpha: float,
    terrain: Terrain,
) -> Floats:
    """Radiance at the camera of some samples (n,) of a picture, given by their `index`: (n, c), 0 where there is no
    gel.

    Args:
        index: see above.
        hits: the triangles of a sheet behind all samples; nodes: the sheet's positions [mm], (nodes, 3).
        normals, views: of all samples, into the gel and toward the camera there, unit vectors (samples, 3).
        passed: share of the radiance in the gel that reaches the camera (samples,).
        columns: the light.
        matt, gloss: what each strip (strips, c) adds by a white Lambertian coat and by a rough mirror.
        alpha: the mirror's roughness; 0 leaves it out.
        terrain: what has receded since the face was untouched.
    """
    middle, strip, lowest, step, light, mirror = columns
    out, count = np.zeros((len(index), matt.shape[1])), len(middle)
    got, bundle = np.empty(light.shape[3], np.float32), np.empty((4, 2 * count), np.float32)
    for s in range(len(index)):
        at = index[s]
        x, y, z = point(hits, nodes, at)
        if np.isnan(x):
            continue
        nx, ny, nz = normals[at, 0], normals[at, 1], min(normals[at, 2], MAX_NORMAL_Z)
        vx, vy, vz = views[at, 0], views[at, 1], views[at, 2]
        ci = max(nx * vx + ny * vy + normals[at, 2] * vz, 0.05)
        trilinear(light, (x - lowest[0]) / step[0], (y - lowest[1]) / step[1], (z - lowest[2]) / step[2], got)
        incident(got, np.float32(nx), np.float32(ny), np.float32(nz), bundle)
        for c in range(count):
            dx, dy = middle[c, 0] - x, middle[c, 1] - y
            rho = max(np.sqrt(dx * dx + dy * dy), 1e-9)
            free = np.float64(got[2 * FIELDS * count + c])
            above = np.float64(bundle[LOWEST_SLOPE, c]), min(np.float64(bundle[HIGHEST_SLOPE, c]), free)
            below = np.float64(bundle[LOWEST_SLOPE, count + c]), min(np.float64(bundle[HIGHEST_SLOPE, count + c]), free)
            lit = (
                bundle[LATERAL_LIGHT, c] > 0.0 and above[0] < above[1],
                bundle[LATERAL_LIGHT, count + c] > 0.0 and below[0] < below[1],
            )
            if not (lit[0] or lit[1]):
                continue
            above = above if lit[0] else below
            below = below if lit[1] else above
            edge = min(horizon(terrain, x, y, z, dx / rho, dy / rho, rho, above, below), free)
            white, bright = 0.0, 0.0
            for image in range(2):
                k = image * count + c
                low, top = np.float64(bundle[LOWEST_SLOPE, k]), min(edge, np.float64(bundle[HIGHEST_SLOPE, k]))
                if not lit[image] or top <= low:
                    continue
                rise = 2 * mirror - middle[c, 2] - z if image else middle[c, 2] - z
                side = bundle[LATERAL_LIGHT, k] * (top - low) / (rho * rho + rise * rise)
                seen = 0.5 * (top + low)  # mean slope of what is seen of the column
                turn = np.float64(bundle[TURNING_SLOPE, k])
                white -= side * nz * (turn - seen)
                if alpha > 0.0:
                    spread = (top - low) / np.sqrt(12.0)
                    for steep in (seen - spread, seen + spread):  # Gauss's points
                        long = np.sqrt(1.0 + steep * steep)
                        toward = ((vx * dx + vy * dy) / rho + vz * steep) / long
                        bright += 0.5 * side * long * ggx(toward, ci, -nz * (turn - steep) / long, alpha)
            for m in range(matt.shape[1]):
                out[s, m] += passed[at] * (white / np.pi * matt[strip[c], m] + bright * gloss[strip[c], m])
    return out


@njit(cache=False, error_model="numpy", fastmath=FAST_SUM_FLAGS)
def trilinear(table: Singles, u: float, v: float, w: float, out: Singles) -> None:
    """A table (heights, rows, columns, c) at column u, row v and height w: `out` (c,), linear, constant beyond its
    ends."""
    u = min(max(u, 0.0), table.shape[2] - 1.001)
    v = min(max(v, 0.0), table.shape[1] - 1.001)
    w = min(max(w, 0.0), table.shape[0] - 1.001)
    i, j, k = int(u), int(v), int(w)
    a, b, d = np.float32(u - i), np.float32(v - j), np.float32(w - k)
    one = np.float32(1.0)
    w00, w01, w10, w11 = (one - b) * (one - a), (one - b) * a, b * (one - a), b * a
    for c in range(len(out)):
        near = w00 * table[k, j, i, c] + w01 * table[k, j, i + 1, c]
        near += w10 * table[k, j + 1, i, c] + w11 * table[k, j + 1, i + 1, c]
        far = w00 * table[k + 1, j, i, c] + w01 * table[k + 1, j, i + 1, c]
        far += w10 * table[k + 1, j + 1, i, c] + w11 * table[k + 1, j + 1, i + 1, c]
        out[c] = near + d * (far - near)


@njit(cache=False, error_model="numpy", fastmath=FAST_SUM_FLAGS)
def incident(got: Singles, nx: Single, ny: Single, nz: Single, out: Singles) -> None:
    """Light of the columns on a point of the face with this normal, each in the vertical plane of its irradiance
    vector: `out` (4, 2 columns) of the direct light and then of the reflected, from Columns.light there."""
    both, one, none = out.shape[1], np.float32(1.0), np.float32(1e-30)
    for c in range(both):
        ex, ey, ez, half = (
            got[IRRADIANCE_X * both + c],
            got[IRRADIANCE_Y * both + c],
            got[IRRADIANCE_Z * both + c],
            got[HALF_SLOPE_RANGE * both + c],
        )
        side = np.sqrt(ex * ex + ey * ey)
        each = one / max(side, none)
        slope, turn = ez * each, -(nx * ex + ny * ey) * each / nz
        out[LATERAL_LIGHT, c] = side / (half + half)
        out[LOWEST_SLOPE, c], out[HIGHEST_SLOPE, c] = slope - half, min(slope + half, turn)
        out[TURNING_SLOPE, c] = turn
