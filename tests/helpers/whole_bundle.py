"""A bundle with every dataset of the layout, for readers that are tried on all of it."""

from pathlib import Path
from typing import Any

import numpy as np

from helpers.synthetic import attributes, image, marker_grid, states
from helpers.synthetic import frame as synthetic_frame
from tacgen.bundle.bundle import Writer
from tacgen.outputs import LAYOUT

IMAGE, MAP = (240, 320), (60, 80)  # FEATS takes images of this size only
SIZES = {"H": IMAGE[0], "W": IMAGE[1], "h": MAP[0], "w": MAP[1], "M": 63, "n": 8, "m": 1, "k": 4}
MESH = {
    "/mesh/points": np.indices((2, 2, 2)).reshape(3, 8).T - [0.5, 0.5, 1.0],
    "/mesh/cells": np.array([[0, 4, 6, 2, 1, 5, 7, 3]]),
    "/mesh/layer": np.zeros(1, int),
    "/mesh/facets/coated": np.array([[1, 5, 7, 3]]),
    "/mesh/surface/points": np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) - [0.5, 0.5, 0.0],
    "/mesh/surface/facets": np.array([[0, 1, 2, 3]]),
}


def write(path: Path, frames: int = 3, **changes: Any) -> Path:
    """Write it; `changes` are those of the attributes."""
    outputs = frozenset({"traction", "height", "markers", "rgb", "stress"})
    whole = {"/reference/rgb": image(IMAGE, 0.0, 0.0, 0.0), "/reference/markers": marker_grid(IMAGE), **MESH}
    rows = states()[:: len(states()) // frames][:frames]
    with Writer(path, attributes(**changes), frames=frames) as writer:
        for name in (name for name, row in LAYOUT.items() if not row.per_frame and not name.endswith("*")):
            writer.put(name, whole[name] if name in whole else np.zeros(_shape(name), LAYOUT[name].dtype))
        writer.put("/mesh/facets/coated", whole["/mesh/facets/coated"])
        for state in rows:
            made = synthetic_frame(state, IMAGE, outputs)
            fits = {name: values for name, values in made.items() if np.shape(values) == _shape(name)}
            fits |= {"/frames/time": 0.1 * writer.appended, "/frames/quality/min_gap_mm": 0.01}
            each = (name for name, row in LAYOUT.items() if row.per_frame)
            writer.append({name: fits.get(name, np.zeros(_shape(name), LAYOUT[name].dtype)) for name in each})
        writer.finish()
    return path


def _shape(name: str) -> tuple[int, ...]:
    dims = LAYOUT[name].dims[LAYOUT[name].per_frame :]
    return tuple(size if isinstance(size, int) else SIZES[size] for size in dims)
