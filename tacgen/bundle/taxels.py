"""Forces of an array of taxels: a bundle's force map, summed over the cells of a layout.

    layout = grid(4, 4, 4.0)                 # 4 rows, 4 columns, 4 mm apart; or read(Path("taxels.csv"))
    forces(bundle, 7, layout)                # (16, 3) [N] on the gel, whose sum is that of the force map

A taxel's cell is the part of the untouched face that is nearest to its centre (Voronoi).
"""

from pathlib import Path

import numpy as np

from tacgen.base import csv_table
from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle

Array = np.ndarray


def grid(rows: int, columns: int, pitch_mm: float, center_mm: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Centres (rows x columns, 2) [mm] of a square grid, row after row, x right and y down in the image."""
    x, y = ((np.arange(n) - (n - 1) / 2) * pitch_mm for n in (columns, rows))
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2) + center_mm


def read(path: Path) -> Array:
    """Centres (n, 2) [mm] of a CSV file with columns x_mm and y_mm. Raises UserError: not readable as such a table."""
    wrong: list[str] = []
    rows = csv_table.rows(path, ("x_mm", "y_mm"), (), wrong)
    layout = np.array([[csv_table.number(row[name]) for name in ("x_mm", "y_mm")] for _, row in rows]).reshape(-1, 2)
    wrong += [f"{path}:{rows[k][0]}: x_mm and y_mm must be numbers" for k in np.flatnonzero(np.isnan(layout).any(1))]
    if not rows and not wrong:
        wrong.append(f"{path}: must hold x_mm and y_mm of at least one taxel")
    if wrong:
        raise UserError(wrong)
    return layout


def forces(bundle: Bundle, frame: int, layout: Array) -> Array:
    """Force (n, 3) [N] on the gel in the cell of each of the centres (n, 2) [mm]. Raises Missing: no force map."""
    force = bundle.frame("/frames/force_map", frame).astype(float)
    cell = cells(bundle, layout)
    return np.stack([np.bincount(cell, part, len(layout)) for part in force.reshape(-1, 3).T], -1)


def cells(bundle: Bundle, layout: Array) -> Array:
    """The index (h x w,) of the taxel to which each sample of a map belongs."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(layout).query(_places(bundle))[1])


def _places(bundle: Bundle) -> Array:
    """Positions (h x w, 2) [mm] on the untouched face behind the samples of a map; beside the gel on the plane z = 0.

    In a bundle of an earlier version, without /reference/x_mm, a dome needs the output `height`.
    """
    from tacgen.optics.camera import PinholeCamera

    camera, (h, w) = PinholeCamera.from_sensor(bundle.sensor), bundle.shapes["/frames/force_map"][1:3]
    row, column = np.indices((h, w)).reshape(2, -1) + 0.5
    origins, rays = camera.rays(np.column_stack([column * camera.shape[1] / w, row * camera.shape[0] / h]))
    z = np.nan_to_num(bundle["/reference/height"].ravel()) if "/reference/height" in bundle else 0.0
    places = np.asarray((origins - rays * ((origins[:, 2] - z) / rays[:, 2])[:, None])[:, :2])
    if "/reference/x_mm" in bundle:
        known = np.stack([bundle[f"/reference/{axis}_mm"].ravel() for axis in "xy"], -1)
        places = np.where(np.isnan(known), places, known)
    return places
