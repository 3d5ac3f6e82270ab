"""Interreflection of coating and walls, directly and by the plate: radiosity of the untouched gel.

Both are divided into patches of uniform radiosity; each illuminates every other as a small strip would (see
strip_light), and the sum of all reflections is one linear system. This light is smooth, so patches may be coarse, and
it changes little under a press: in a dent it is that of the untouched gel as a function of the normal (Glow).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacgen.optics import coating, housing, strip_light
from tacgen.optics.shadows import Terrain
from tacgen.optics.surface_grid import Sheet, Untouched
from tacgen.physics import coat
from tacgen.physics.coat import NORMAL_TERMS
from tacgen.physics.runtime import call

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from tacgen.optics.camera_view import CameraView
    from tacgen.optics.surface_grid import Surface
    from tacgen.sensor.model import Led, LitSensor

    Floats = NDArray[np.float64]

COAT_PATCH_SPACING_MM = 1.4  # distance between the centres of the coating's patches [mm]
WALL_PATCH_SPACING_MM = 2.2  # the same for the walls [mm]
NORMAL_DIFFERENCE = 0.6  # change of a normal's x or y in the difference quotients of the polynomial [-]
PATCH_REFINEMENT = 4  # refinement of the patches by cubic splines, before linear interpolation to pixels


@dataclass(frozen=True)
class Glow:
    """Interreflected radiance at each of the camera's samples, as a function of the normal there."""

    terms: "NDArray[np.float32]"  # radiance (samples, NORMAL_TERMS, 3)
    untouched: "Floats"  # sideways parts of the untouched normal, (samples, 2)

    def at(self, normal: "Floats", index: "NDArray[np.int64] | None" = None) -> "Floats":
        """Radiance (n, 3) of a coat without markers with `normal` (samples, 3), at the samples `index` (n,), or at all;
        0 where there is no gel, so that the normal is nan."""
        index = np.arange(len(normal)) if index is None else index
        out = np.empty((len(index), 3))
        call(coat.glow, (len(index),), self.terms, self.untouched, normal, index, out)
        return out


class Radiosity:
    """The patches of a sensor and their form factors."""

    def __init__(self, sensor: "LitSensor", untouched: "Surface | None" = None) -> None:
        """Independent of the LEDs; `untouched` is the face at rest, None: that of the sensor's gel."""
        self.sheet = Sheet.over(sensor.gel, COAT_PATCH_SPACING_MM)
        self._face = untouched or Untouched.of(sensor.gel)
        nodes = self.sheet.at(self._face)
        level = np.ascontiguousarray(nodes[:, 2].reshape(self.sheet.shape))
        self._terrain = Terrain.of(level, self.sheet.size)
        self._coat = len(nodes)
        facing, (rows, columns) = self.sheet.normals(nodes), self.sheet.shape
        share = np.outer(*(np.where(np.isin(np.arange(n), (0, n - 1)), 0.5, 1.0) for n in (rows, columns)))
        top = housing.WALL_RISE_MM if sensor.walls.margin_mm else float(level.min())  # the coating hides the rest
        walls, inward, pieces = housing.wall_patches(sensor, top, WALL_PATCH_SPACING_MM)
        self._at, self._normals = np.concatenate([nodes, walls]), np.concatenate([facing, inward])
        area = np.concatenate([share.ravel() * self.sheet.areas(nodes), pieces])
        every = np.arange(len(area))
        self._patches = strip_light.StripPoints(self._at, self._normals, area, np.sqrt(area) / 2, every, 0 * every)
        self._slab = strip_light.Slab.of(sensor)
        self._form_factors = self._gather(self._patches, len(area))
        self._factors: dict[tuple[float, float], tuple[Floats, tuple[Floats, NDArray[np.int32]]]] = {}
        turned = []
        for by in (
            (NORMAL_DIFFERENCE, 0.0),
            (-NORMAL_DIFFERENCE, 0.0),
            (0.0, NORMAL_DIFFERENCE),
            (0.0, -NORMAL_DIFFERENCE),
        ):
            side = facing[:, :2] + by
            side *= np.minimum(1.0, 0.95 / np.linalg.norm(side, axis=1, keepdims=True))
            normals = np.column_stack([side, -np.sqrt(1 - (side**2).sum(axis=1))])
            turned.append(self._gather(self._patches, len(area), normals=np.ascontiguousarray(normals)))
        level = self._form_factors[: self._coat]
        right, left, down, up = turned
        self._form_factor_terms = np.array(
            [level, (right - left) / (2 * NORMAL_DIFFERENCE), (down - up) / (2 * NORMAL_DIFFERENCE)]
            + [(a + b - 2 * level) / (2 * NORMAL_DIFFERENCE**2) for a, b in ((right, left), (down, up))]
        )  # (NORMAL_TERMS, coat patches, patches)

    def added(self, sensor: "LitSensor", points: strip_light.StripPoints) -> "Floats":
        """Interreflected radiance (coating patches, leds, NORMAL_TERMS, 3) in the gel, per unit radiance of each
        LED.
        """
        coat, first = sensor.coating, self._gather(points, len(sensor.leds), sensor.leds)
        out: dict[float, Floats] = {}
        for albedo in set(coat.albedo):
            reflected = (1 - coat.specular) * albedo + coat.specular * coating.METAL_REFLECTANCE
            total = self._all_reflections(reflected, sensor.walls.albedo)(first)
            out[albedo] = reflected * np.moveaxis(self._form_factor_terms @ total, 0, -1)
        return np.stack([out[albedo] for albedo in coat.albedo], axis=-1)

    def _all_reflections(self, coat: float, walls: float) -> "Callable[[Floats], Floats]":
        """Radiance (patches, n) after all reflections, from the first (patches, n); the system's factor is kept."""
        from scipy.linalg import lu_factor, lu_solve

        if (coat, walls) not in self._factors:
            rho = np.full((len(self._at), 1), walls)
            rho[: self._coat] = coat
            self._factors[coat, walls] = rho, lu_factor(np.eye(len(rho)) - rho * self._form_factors)
        rho, factor = self._factors[coat, walls]
        return lambda first: np.asarray(lu_solve(factor, rho * first))

    def glow(self, values: "Floats", view: "CameraView") -> Glow:
        """Values (coat patches, NORMAL_TERMS, 3) as the camera sees them; off the pad its edge."""
        from scipy.ndimage import map_coordinates

        at = view.look(self._face)
        rest, normal = at.rest, np.nan_to_num(at.normal[:, :2])
        alike = (values[..., :1] == values).all()  # the same in each colour
        grid = finer(values[..., : 1 if alike else None].reshape(*self.sheet.shape, -1))
        rows, columns, count = grid.shape
        grid_at = np.nan_to_num(((rest / self.sheet.size + 0.5) * [columns - 1, rows - 1]).T[::-1])
        terms, passed = np.empty((len(rest), count), np.float32), view.transmission()
        for c in range(count):
            terms[:, c] = passed * map_coordinates(grid[..., c], grid_at, order=1)
        shaped = terms.reshape(len(terms), NORMAL_TERMS, -1)
        return Glow(np.repeat(shaped, 3, axis=2) if alike else shaped, normal)

    def _gather(
        self,
        points: strip_light.StripPoints,
        strips: int,
        shading: "Sequence[Led]" = (),
        normals: "Floats | None" = None,
    ) -> "Floats":
        """Radiance (patches, strips) of a white matt patch per unit radiance of each strip, LEDs `shading` it; with
        normals of the coat's patches that are not their own, (coat patches, strips)."""
        panels = strip_light.Panels.of(shading)
        normals = self._normals if normals is None else normals
        at = self._at[: len(normals)]
        lit = strip_light.gather(at, normals, normals, points, strips, self._slab, panels, 1.0, self._terrain)[..., 0]
        if points is self._patches:  # patches closer than their size would give form factors with a sum above 1
            lit /= np.maximum(lit.sum(axis=1, keepdims=True), 1.0)
        return lit


def finer(coarse: "Floats") -> "Floats":
    """Values (rows, columns, n) on a grid PATCH_REFINEMENT times as dense, by cubic splines limited to the range of the
    patches around: beside a patch very close to an LED they would fall below 0 and show as dark spots."""
    from scipy.ndimage import maximum_filter, minimum_filter, zoom

    def dense(what: "Floats", order: int) -> "Floats":
        return np.asarray(zoom(what, (PATCH_REFINEMENT, PATCH_REFINEMENT, 1), order=order, mode="nearest"))

    least, most = (dense(of(coarse, size=(3, 3, 1), mode="nearest"), 1) for of in (minimum_filter, maximum_filter))
    return np.clip(dense(coarse, 3), least, most)
