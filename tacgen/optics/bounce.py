"""Light that coat and walls throw on the coat again, straight and by way of the plate: radiosity of the untouched gel.

Both are cut into patches that radiate evenly; each lights every other as a small strip would (optics/transport), and
the sum of all bounces is one linear system. It is smooth, so patches may be coarse, and changes little under a press.
"""

from typing import TYPE_CHECKING

import numpy as np

from tacgen.optics import coating, lights, transport
from tacgen.optics.horizon import Terrain
from tacgen.optics.sheet import Sheet, Untouched

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.optics.sheet import Surface
    from tacgen.optics.view import View
    from tacgen.spec.sensor import LitSensor

    Floats = NDArray[np.float64]

COAT = 1.0  # [mm] between the middles of patches of the coat
WALL = 1.6  # the same of the walls


class Bounce:
    """Patches of one sensor, and how they light each other."""

    def __init__(self, sensor: "LitSensor", untouched: "Surface | None" = None) -> None:
        """The LEDs do not matter yet; `untouched` is the face at rest, what the gel's numbers say of it if None."""
        self.sheet = Sheet.over(sensor.gel, COAT)
        self._face = untouched or Untouched.of(sensor.gel)
        nodes = self.sheet.at(self._face)
        level = np.ascontiguousarray(nodes[:, 2].reshape(self.sheet.shape))
        self._terrain = Terrain.of(level, self.sheet.size).parts
        self._coat = len(nodes)
        facing, (rows, columns) = self.sheet.normals(nodes), self.sheet.shape
        share = np.outer(*(np.where(np.isin(np.arange(n), (0, n - 1)), 0.5, 1.0) for n in (rows, columns)))
        top = lights.WALL_RISE if sensor.walls.margin_mm else float(level.min())  # the coat hides what is behind
        walls, inward, pieces = self._walls(sensor, top)
        self._at, self._normals = np.concatenate([nodes, walls]), np.concatenate([facing, inward])
        area = np.concatenate([share.ravel() * self.sheet.areas(nodes), pieces])
        patches = transport.Points(self._at, self._normals, area, np.sqrt(area) / 2, np.arange(len(area)))
        self._onto = self._gather(sensor, patches, len(area))

    def added(self, sensor: "LitSensor", points: transport.Points) -> "Floats":
        """Radiance (coat patches, leds, 3) in the gel that bounces add, per unit radiance of each LED."""
        coat, first, out = sensor.coating, self._gather(sensor, points, len(sensor.leds)), []
        for albedo in coat.albedo:
            rho = np.full((len(first), 1), sensor.walls.albedo)
            rho[: self._coat] = (1 - coat.specular) * albedo + coat.specular * coating.METAL
            all_ = np.linalg.solve(np.eye(len(first)) - rho * self._onto, rho * first)
            out.append((all_ - rho * first)[: self._coat])
        return np.stack(out, axis=-1)

    def picture(self, values: "Floats", view: "View") -> "Floats":
        """Values (coat patches, c) as the camera sees them untouched (H, W, c); off the pad its edge."""
        from scipy.ndimage import map_coordinates

        rest = view.look(self._face).rest
        rows, columns = self.sheet.shape
        at = np.nan_to_num(((rest / self.sheet.size + 0.5) * [columns - 1, rows - 1]).T[::-1])
        grid = values.reshape(rows, columns, -1)
        made = [map_coordinates(grid[..., c], at, order=3, mode="nearest") for c in range(grid.shape[2])]
        return view.picture(np.column_stack(made) * view.transmission()[:, None])

    def _gather(self, sensor: "LitSensor", points: transport.Points, strips: int) -> "Floats":
        """Radiance (patches, strips) of a white matt patch per unit radiance of each strip."""
        slab = transport.Slab.of(sensor)
        return transport.gather(
            self._at, self._normals, self._normals, points.at, points.normal, points.area, points.half, points.strip,
            strips, *slab.parts, 1.0, self._terrain,
        )[..., 0]  # fmt: skip

    def _walls(self, sensor: "LitSensor", top: float) -> tuple["Floats", "Floats", "Floats"]:
        """Middles (n, 3) [mm], inward normals (n, 3) and areas (n,) [mm^2] of the walls' patches up to height `top`."""
        corners, bottom = lights.outline(sensor.gel, sensor.walls.margin_mm), -lights.bottom_depth(sensor)
        at, normals, area = [], [], []
        tall = max(1, round((top - bottom) / WALL))
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            length = float(np.linalg.norm(b - a))
            wide = max(1, round(length / WALL))
            for i in range(wide):
                for j in range(tall):
                    at.append([*(a + (b - a) * (i + 0.5) / wide), bottom + (top - bottom) * (j + 0.5) / tall])
                    normals.append([(a[1] - b[1]) / length, (b[0] - a[0]) / length, 0.0])
                    area.append(length / wide * (top - bottom) / tall)
        return np.array(at), np.array(normals), np.array(area)
