"""The maps of a bundle as they are drawn everywhere: what they need, their values, label and colours."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tacgen.bundle.bundle import Bundle

Array = np.ndarray


class Layer(NamedTuple):
    """A map over the frames. Its colours rise evenly to the eye (matplotlib's names)."""

    needs: tuple[str, ...]
    values: Callable[[Bundle], Array]  # (N, h, w), nan where there is none
    label: str
    colours: str
    vectors: str = ""  # the dataset (N, h, w, 2) whose arrows are drawn on it


LAYERS = {
    "pressure": Layer(("/frames/pressure",), lambda bundle: bundle["/frames/pressure"], "pressure [MPa]", "viridis"),
    "traction": Layer(
        ("/frames/traction",),
        lambda bundle: np.linalg.norm(bundle["/frames/traction"], axis=-1),
        "traction [MPa]",
        "magma",
        "/frames/traction",
    ),
    "height": Layer(  # a dome's own height would hide how far the face has risen or sunk
        ("/frames/height", "/reference/height"),
        lambda bundle: bundle["/frames/height"] - bundle["/reference/height"],
        "change of z [mm]",
        "cividis",
    ),
    "flow": Layer(
        ("/frames/flow",),
        lambda bundle: np.linalg.norm(bundle["/frames/flow"], axis=-1),
        "flow [px]",
        "viridis",
        "/frames/flow",
    ),
}


def limits(values: Array) -> tuple[float, float]:
    """The ends of a colour scale from 0, or what is below it, to the largest value."""
    known = values[np.isfinite(values)]
    low = float(known.min(initial=0.0))
    return low, float(known.max(initial=low + 1e-3))
