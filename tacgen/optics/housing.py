"""Where light is made and where it ends: the strips of LEDs, and the walls around gel and plate."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tacgen.sensor.model import LitSensor

Floats = NDArray[np.float64]

SEMICIRCLE_WALLS = 16  # number of walls around a semicircle
WALL_RISE_MM = 3.0  # height of the walls above the coated face, so that no light leaks past a bulging gel [mm]


def frame(normal: "Sequence[float]", up: "Sequence[float]") -> Floats:
    """Columns (along, up, normal) of a right-handed orthonormal frame, (3, 3); `up` need not be orthogonal to `normal`.

    Raises:
        ValueError: normal is zero or parallel to up.
    """
    n, u = np.array(normal, dtype=float), np.array(up, dtype=float)
    along = np.cross(u, n)
    if np.linalg.norm(along) < 1e-9 * (1 + np.linalg.norm(n)):
        raise ValueError(f"a rectangle's normal {tuple(normal)} is zero or parallel to its up {tuple(up)}")
    n, along = n / np.linalg.norm(n), along / np.linalg.norm(along)
    return np.column_stack([along, np.cross(n, along), n])


def strips(sensor: "LitSensor") -> Floats:
    """Ends of each LED's longer middle line and half its other side [mm], (leds, 7), from the picture's middle."""
    out, origin = [], np.add(sensor.camera.center_mm, sensor.camera.crop_mm)
    for light in sensor.leds:
        axes, size = frame(light.normal, light.up), np.array(light.size_mm)
        long = int(size[1] > size[0])
        half = axes[:, long] * size[long] / 2
        middle = np.array(light.center_mm) - [*origin, 0.0]
        out.append(np.concatenate([middle - half, middle + half, [size[1 - long] / 2]]))
    return np.array(out)


def outline(sensor: "LitSensor") -> Floats:
    """Corners (n, 2) [mm] of the housing around the pad, from +x to +y; a semicircle in SEMICIRCLE_WALLS pieces."""
    return np.asarray(sensor.gel.pad.housing(sensor.walls.margin_mm).walls(SEMICIRCLE_WALLS))


def bottom_depth(sensor: "LitSensor") -> float:
    """Depth of the plate's air face below the untouched coated face [mm]."""
    return sensor.plate.thickness_mm + sum(layer.thickness_mm for layer in sensor.gel.layers)


def wall_patches(sensor: "LitSensor", top: float, spacing: float) -> tuple[Floats, Floats, Floats]:
    """Middles (n, 3) [mm], inward normals (n, 3) and areas (n,) [mm^2] of the walls' patches up to height `top`,
    about `spacing` apart [mm]."""
    corners, bottom = outline(sensor), -bottom_depth(sensor)
    at, normals, area = [], [], []
    tall = max(1, round((top - bottom) / spacing))
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length = float(np.linalg.norm(b - a))
        wide = max(1, round(length / spacing))
        for i in range(wide):
            for j in range(tall):
                at.append([*(a + (b - a) * (i + 0.5) / wide), bottom + (top - bottom) * (j + 0.5) / tall])
                normals.append([(a[1] - b[1]) / length, (b[0] - a[0]) / length, 0.0])
                area.append(length / wide * (top - bottom) / tall)
    return np.array(at), np.array(normals), np.array(area)
