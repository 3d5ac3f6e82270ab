"""The camera's distance from the plate, by the rows of dots in untouched pictures of two GelSight Minis.

    python -m benchmarks.dot_grid

The plate refracts light from the edge of the pad more than light from its middle, so even rows of dots look bent, and
the more so the closer the camera is. A regular grid behind the sensor file's layers is fitted to the dots, with a lens
that is taken as free of distortion, and with the optical axis where it suits best.
"""

from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.optimize import least_squares

from benchmarks import photographs, real_dots
from tacgen.optics.camera import PinholeCamera
from tacgen.recipe import assets, loading
from tacgen.recipe.background_photo import read
from tacgen.sensor.model import LitSensor

Array = np.ndarray
PICTURES = ("gelsight_mini_dotted/background.png", "gelsight_mini/markers_no_contact.png")
NEAREST, FARTHEST = 0.05, 60.0  # distances that are tried [mm]
SOFT = 0.5  # scale of the soft-l1 loss, for dots of odd shape [px]


@dataclass(frozen=True)
class SeenGrid:
    """A regular grid behind a sensor's layers that was fitted to dots."""

    distance: float  # from the pinhole to the plate [mm]
    error: float  # its standard error [mm], by the scatter of the dots
    axis: Array  # optical axis in the picture (2,) [px]
    pitch: Array  # of columns and of rows (2,) [mm]
    off: float  # of the dots, rms [px]


def numbered(dots: Array) -> Array:
    """Column and row (n, 2) of dots (n, 2) [px] of a grid that is nearly straight, counted from a dot in its middle."""
    way = dots[None] - dots[:, None]
    far = np.linalg.norm(way, axis=2)
    near = (far > 0) & (far < 1.4 * np.median(np.sort(far, axis=1)[:, 1]))  # less than a diagonal
    right, down = (
        np.median(way[near & (way[..., k] > np.abs(way[..., 1 - k]))], axis=0) for k in (0, 1)
    )  # from a dot to the next one
    middle = dots[np.linalg.norm(dots - dots.mean(axis=0), axis=1).argmin()]
    return np.asarray(np.round(np.linalg.solve(np.column_stack([right, down]), (dots - middle).T).T))


def fitted(sensor: LitSensor, dots: Array, distance: float | None = None) -> SeenGrid:
    """The grid that suits dots (n, 2) [px] best, seen by a sensor's camera at any distance, or at a given one [mm]."""
    table, eye = np.column_stack([np.ones(len(dots)), numbered(dots)]), sensor.camera

    def off(v: Array) -> Array:
        at = {"distance_mm": float(v[8]), "crop_mm": (float(v[6]), float(v[7]))}
        camera = PinholeCamera.from_sensor(sensor.model_copy(update={"camera": eye.model_copy(update=at)}))
        return np.asarray(camera.project(np.column_stack([table @ v[:6].reshape(3, 2), np.zeros(len(dots))])) - dots)

    shape = np.array([eye.width_px, eye.height_px])
    start = np.linalg.lstsq(table, (dots - shape / 2) * eye.mm_per_px)[0].ravel()
    begin = np.array([*start, *eye.crop_mm, distance or eye.distance_mm])
    least, most = np.full(9, -np.inf), np.full(9, np.inf)
    least[8], most[8] = (NEAREST, FARTHEST) if distance is None else (begin[8] - 1e-9, begin[8] + 1e-9)
    best = least_squares(
        lambda v: off(v).ravel(), begin, bounds=(least, most), x_scale="jac", loss="soft_l1", f_scale=SOFT
    )
    v, curved = best.x, np.linalg.pinv(best.jac.T @ best.jac)
    error = np.sqrt(curved[8, 8] * 2 * best.cost / (dots.size - len(v)))
    axis = shape / 2 - v[6:8] / eye.mm_per_px
    return SeenGrid(
        float(v[8]), float(error), axis, np.linalg.norm(v[2:6].reshape(2, 2), axis=1), real_dots.rms(off(v))
    )


def main() -> None:
    """Print a line for each picture."""
    sensor = cast(LitSensor, loading.read_sensor(assets.sensor_path("gelsight_mini"))[0])
    for name in PICTURES:
        if not (path := photographs.reference() / name).is_file():
            print(f"no picture {path} (set TACGEN_REFERENCE)")
            continue
        dots = real_dots.dots(read(path))
        best, own, far = (fitted(sensor, dots, d) for d in (None, sensor.camera.distance_mm, FARTHEST))
        print(
            f"{name}: {best.distance:.1f} +- {best.error:.1f} mm, axis at {best.axis.round(0)} px, pitch"
            f" {best.pitch.round(3)} mm; dots off by {best.off:.2f} px, at the file's {own.distance:g} mm"
            f" by {own.off:.2f}, from far away by {far.off:.2f}"
        )


if __name__ == "__main__":
    main()
