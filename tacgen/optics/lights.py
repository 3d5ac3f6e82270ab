"""LEDs, walls and clear interfaces as plain dictionaries: a renderer's rectangle is the square [-1, 1]^2, +z its front.

`to_world` is a 4 x 4 array here; the renderer's own home turns it into the renderer's type.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from tacgen.sensor import Led, LitSensor

    Floats = NDArray[np.float64]

WALL_RISE = 3.0  # [mm] the walls go on beyond the coated face, so that no light leaks past a bulging gel


def frame(normal: "Sequence[float]", up: "Sequence[float]") -> "Floats":
    """Columns (along, up, normal) of a right-handed orthonormal frame, (3, 3); `up` only has to lean the right way.

    Raises:
        ValueError: normal is zero or parallel to up.
    """
    n, u = np.array(normal, dtype=float), np.array(up, dtype=float)
    along = np.cross(u, n)
    if np.linalg.norm(along) < 1e-9 * (1 + np.linalg.norm(n)):
        raise ValueError(f"a rectangle's normal {tuple(normal)} is zero or parallel to its up {tuple(up)}")
    n, along = n / np.linalg.norm(n), along / np.linalg.norm(along)
    return np.column_stack([along, np.cross(n, along), n])


def rectangle(
    center: "Sequence[float]", normal: "Sequence[float]", up: "Sequence[float]", size: tuple[float, float]
) -> "Floats":
    """Matrix (4, 4) that takes the unit square to a rectangle of `size` (along, up) [mm] facing `normal`."""
    matrix = np.eye(4)
    matrix[:3, :3] = frame(normal, up) * [size[0] / 2, size[1] / 2, 1.0]
    matrix[:3, 3] = center
    return matrix


def diffuse(albedo: "float | Sequence[float]") -> dict[str, Any]:
    """A Lambertian surface."""
    rgb = [float(albedo)] * 3 if isinstance(albedo, float | int) else [float(a) for a in albedo]
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": rgb}}


def led(light: "Led", wall_albedo: float) -> dict[str, Any]:
    """One LED strip: it radiates from its front and is as dark as the walls otherwise."""
    return {
        "type": "rectangle",
        "to_world": rectangle(light.center_mm, light.normal, light.up, light.size_mm),
        "bsdf": diffuse(wall_albedo),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [float(v) for v in light.radiance]}},
    }


def housing(sensor: "LitSensor") -> dict[str, dict[str, Any]]:
    """The four dark walls around gel and plate, from the plate's air face past the coated face."""
    w, h = sensor.gel.width_mm, sensor.gel.height_mm
    bottom = -bottom_depth(sensor)
    middle, tall = (WALL_RISE + bottom) / 2, WALL_RISE - bottom
    sides = {"left": (-1, 0), "right": (1, 0), "top": (0, -1), "bottom": (0, 1)}
    return {
        f"wall_{name}": {
            "type": "rectangle",
            "to_world": rectangle((x * w / 2, y * h / 2, middle), (-x, -y, 0), (0, 0, 1), (w if x == 0 else h, tall)),
            "bsdf": diffuse(sensor.walls.albedo),
        }
        for name, (x, y) in sides.items()
    }


def interfaces(sensor: "LitSensor") -> dict[str, dict[str, Any]]:
    """Clear interfaces from the air inward; one between equal indices does not exist."""
    w, h = sensor.gel.width_mm, sensor.gel.height_mm
    z, outside, made = -bottom_depth(sensor), 1.0, {}
    bodies = [
        ("plate", sensor.plate.thickness_mm, sensor.plate.refractive_index),
        *((layer.name, layer.thickness_mm, layer.refractive_index) for layer in sensor.gel.layers),
    ]
    for name, thickness, index in bodies:
        if index != outside:
            made[f"into_{name}"] = {
                "type": "rectangle",
                "to_world": rectangle((0, 0, z), (0, 0, -1), (0, 1, 0), (w, h)),
                "bsdf": {"type": "dielectric", "int_ior": index, "ext_ior": outside},
            }
        z, outside = z + thickness, index
    return made


def bottom_depth(sensor: "LitSensor") -> float:
    """Depth of the plate's air face below the untouched coated face [mm]."""
    return sensor.plate.thickness_mm + sum(layer.thickness_mm for layer in sensor.gel.layers)
