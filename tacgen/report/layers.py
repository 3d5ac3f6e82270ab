"""The values and the scale of a map in figures and in the viewer; outputs say which maps there are."""

import numpy as np

from tacgen.bundle.bundle import Bundle
from tacgen.outputs.base import DrawnMap

Array = np.ndarray


def datasets_of(layer: DrawnMap) -> tuple[str, ...]:
    """The datasets from which a map is drawn."""
    return (layer.path, layer.less) if layer.less else (layer.path,)


def map_of(layer: DrawnMap, bundle: Bundle) -> Array:
    """A map over the frames (N, h, w); nan outside the coating."""
    found = np.asarray(bundle[layer.path])
    found = np.linalg.norm(found, axis=-1) if found.ndim == 4 else found
    return found - bundle[layer.less] if layer.less else found


def has_arrows(layer: DrawnMap, bundle: Bundle) -> bool:
    """Whether the map is of vectors, drawn as arrows too."""
    return len(bundle.shapes[layer.path]) == 4


def limits(values: Array) -> tuple[float, float]:
    """The ends of a colour scale: 0 or the smallest negative value, and the largest value."""
    known = values[np.isfinite(values)]
    low = float(known.min(initial=0.0))
    return low, float(known.max(initial=low + 1e-3))
