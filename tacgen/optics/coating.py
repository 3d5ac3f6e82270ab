"""The coating seen from inside and the markers on it: Mitsuba dictionaries, and a mask over rest coordinates."""

from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.optics.mitsuba_dicts import diffuse
from tacgen.physics import coat
from tacgen.physics.runtime import call

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tacgen.sensor.markers import Markers
    from tacgen.sensor.model import Coating

    Floats = NDArray[np.float64]

METAL_REFLECTANCE = 0.9  # reflectance of the metallic part, that of aluminium in the visible range [-]


def bsdf(coating: "Coating") -> dict[str, Any]:
    """Diffuse plus a rough (GGX) metallic part of constant reflectance METAL_REFLECTANCE, mixed by `specular`."""
    if coating.specular == 0.0:
        return diffuse(coating.albedo)
    return {
        "type": "blendbsdf",
        "weight": coating.specular,
        "matt": diffuse(coating.albedo),
        "metal": {
            "type": "roughconductor",
            "material": "none",
            "distribution": "ggx",
            "alpha": coating.roughness,
            "specular_reflectance": {"type": "rgb", "value": [METAL_REFLECTANCE] * 3},
        },
    }


def white(coating: "Coating") -> "Floats":
    """Total reflectance of the coating (3,)."""
    return np.asarray((1 - coating.specular) * np.array(coating.albedo) + coating.specular * METAL_REFLECTANCE)


def dotted(coat: dict[str, Any], markers: "Markers", mask: "Floats") -> dict[str, Any]:
    """The coating with markers: their paint where `mask` (h, w) in [0, 1] over UV is 1."""
    texture = {"type": "bitmap", "bitmap": mask, "raw": True, "filter_type": "bilinear", "wrap_mode": "clamp"}
    return {"type": "blendbsdf", "weight": texture, "coat": coat, "paint": diffuse(markers.albedo)}


def centers(markers: "Markers") -> "Floats":
    """Rest positions of the dots on the coated face [mm], (dots, 2), row by row from the top left."""
    across, down = markers.spacing_mm
    last = (len(markers.row_counts) - 1) / 2
    rows, middle = enumerate(markers.row_counts), markers.middle_mm
    return np.array([((i - (n - 1) / 2) * across, (row - last) * down) for row, n in rows for i in range(n)]) + middle


def paint(markers: "Markers", xy: "Floats", edge: float) -> "Floats":
    """Share of paint, 0 to 1, at rest positions xy (..., 2) [mm], 0 where they are nan; `edge` [mm] is the width of the
    blurred rim."""
    flat = np.asarray(xy, dtype=np.float64).reshape(-1, 2) - markers.middle_mm
    counts, share = np.array(markers.row_counts, np.int32), np.empty(xy.shape[:-1])
    sizes = *markers.spacing_mm, markers.diameter_mm / 2, edge
    call(coat.paint, (len(flat),), flat, counts, *map(float, sizes), share.reshape(-1))
    return share


def mask(markers: "Markers", size: tuple[float, float], pixel: float) -> "Floats":
    """`paint` as a picture over a rectangle of `size` (x, y) [mm] centred on the pad: (h, w), row 0 at the least y."""
    count = [max(2, round(s / pixel)) for s in size]
    x, y = ((np.arange(n) + 0.5) / n * s - s / 2 for n, s in zip(count, size, strict=True))
    return paint(markers, np.stack(np.meshgrid(x, y), axis=-1), pixel)
