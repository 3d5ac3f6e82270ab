"""The sum over strips for whole images: the light of each column of a strip is tabulated over positions in the gel.

A column is a piece of a strip with the strip's full height. Its light at a position, direct and reflected, is an
irradiance vector and a range of slopes, summed over enough points to be exact and smooth in position. The samples of an
image interpolate the table; then the normal and the shadows of the deformed face are applied.
"""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacgen.geometry.rasterize import Hits
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.shadows import Terrain
from tacgen.optics.strip_light import Panels, Slab, StripPoints, points, shadowing
from tacgen.physics import runtime, strip_columns
from tacgen.physics.strip_columns import HEIGHT_STEP_MM, LATERAL_STEP_MM, LIGHT_FIELDS

if TYPE_CHECKING:
    from tacgen.sensor.model import Led, LitSensor

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# smallest and largest spacing of positions [mm]; spacing over the strips' distance [-]
POSITION_SPACINGS_MM, POSITION_SPACING_RATIO = (0.2, 0.4), 0.15
LONG_STRIP_RAD = 0.85  # angle at which a strip is seen from the pad's middle that has all pieces [rad]
MAX_BULGE_MM = 1.0  # largest height of a bulging face above the untouched one [mm]
POINTS_OF_COLUMN = strip_columns.POINTS_ALONG_COLUMN, strip_columns.POINTS_ACROSS_COLUMN


class Columns(NamedTuple):
    """Columns of a sensor's strips, and the table of their light."""

    middle: Floats  # [mm], (columns, 3)
    strip: NDArray[np.int32]  # which LED, (columns,)
    lowest: Floats  # corner of the table [mm], (3,): x, y, z
    step: Floats  # between its entries [mm], (3,)
    # the irradiance vector times distance^2 [mm^2]: x of each column's direct light per unit radiance and then of its
    # reflected, likewise y and z, and half the range of slopes [-]; then of each column the slope up to which the
    # untouched face lets light pass
    light: Singles  # (heights, rows, columns of places, (2 LIGHT_FIELDS + 1) x columns)
    mirror: float  # height of the plate's air face [mm]

    @property
    def grid(self) -> Floats:
        """The table's corner and steps (2, 3)."""
        return np.stack([self.lowest, self.step])

    @classmethod
    def of(cls, sensor: "LitSensor", pieces: int, untouched: Terrain) -> "Columns":
        """Each strip in up to so many `pieces`, for faces anywhere in the outermost layer before the camera."""
        from scipy.ndimage import map_coordinates

        field, slab, lights = (
            seen(sensor),
            Slab.of(sensor),
            points(sensor.leds, *POINTS_OF_COLUMN, [_pieces(led, pieces) for led in sensor.leds]),
        )
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
        middle = lights.at.reshape(-1, math.prod(POINTS_OF_COLUMN), 3).mean(axis=1)
        light = tabulated(lights, middle, places, z, aside, slab, Panels.of(sensor.leds), untouched)
        lowest, step = np.array([x[0], y[0], z[0]]), np.array([x[1] - x[0], y[1] - y[0], z[1] - z[0]])
        return cls(
            middle,
            lights.strip[:: math.prod(POINTS_OF_COLUMN)].astype(np.int32),
            lowest,
            step,
            light.reshape(len(z), len(y), len(x), -1),
            float(slab.bottoms[0]),
        )


def _pieces(led: "Led", most: int) -> int:
    """Pieces of a strip: as many as a long one has, per angle at which it is seen from the pad's middle."""
    angle = 2 * math.atan(led.size_mm[0] / 2 / math.hypot(*led.center_mm))
    return min(most, math.ceil(most * angle / LONG_STRIP_RAD))


def tabulated(
    lights: StripPoints,
    middle: Floats,
    places: Floats,
    z: Floats,
    aside: Floats,
    slab: Slab,
    panels: Panels,
    untouched: Terrain,
) -> Singles:
    """Light of columns about middles (columns, 3) at heights z (m,) over places (n, 3) of the untouched face:
    (m, n, (2 LIGHT_FIELDS + 1) x columns), by connections at ways `aside` [mm] in equal steps."""
    heights, level = np.unique(lights.at[:, 2].round(6), return_inverse=True)
    home, rows = np.searchsorted(slab.tops[:-1], heights, side="right").astype(np.int32), slab.rows
    table = np.empty((len(heights) * len(aside), 2, 4, len(z)), np.float32)
    runtime.call(strip_columns.connections, (len(table),), z, aside, heights, home, rows, table)
    out = np.empty((len(z), len(places), (2 * LIGHT_FIELDS + 1) * len(middle)), np.float32)
    sources = *lights.rows, middle, level.astype(np.int32), home
    ways = table.reshape(-1), len(aside), panels.rows, rows
    room = np.empty(14 * len(middle) * len(z), np.float32)
    runtime.call(strip_columns.column_light, (len(middle),), places, z, *sources, *ways, room, out.reshape(-1))
    seen = *shadowing(untouched), out
    runtime.call(strip_columns.untouched_horizons, (len(places),), places, z, middle, *seen)
    return out


def seen(sensor: "LitSensor") -> Floats:
    """The part of the gel that the camera sees, (2, 2): least and greatest x and y [mm], on the pad."""
    camera, half = PinholeCamera.from_sensor(sensor), np.array([sensor.gel.width_mm, sensor.gel.height_mm]) / 2
    (h, w) = camera.shape
    near, way = camera.rays([[0, 0], [w, 0], [0, h], [w, h]])
    ends = np.concatenate([near, near + way * ((MAX_BULGE_MM - near[:, 2:]) / way[:, 2:])])[:, :2]
    return np.asarray(
        np.clip([ends.min(axis=0) - POSITION_SPACINGS_MM[1], ends.max(axis=0) + POSITION_SPACINGS_MM[1]], -half, half)
    )


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
    out, room = np.empty((len(index), matt.shape[1])), np.empty(columns.light.shape[3], np.float32)
    sheet = *hits, nodes, normals, views, passed
    table = columns.middle, columns.strip, columns.grid, columns.light.reshape(-1), columns.light.shape, columns.mirror
    shares = np.stack([matt, gloss], axis=-1).reshape(-1, 2)
    lit = shares, matt.shape[1], alpha, *shadowing(terrain)
    runtime.call(strip_columns.toward_camera, (1,), index, 1, *sheet, *table, *lit, room, out.reshape(-1))
    return out
