"""How each map of a bundle is drawn in figures and in the viewer: datasets, values, label and colours."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tacgen.bundle.bundle import Bundle

Array = np.ndarray


class Layer(NamedTuple):
    """A map over the frames, with a perceptually uniform colour map of matplotlib."""

    needs: tuple[str, ...]
    values: Callable[[Bundle], Array]  # (N, h, w), nan outside the coating
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
    "height": Layer(  # minus the reference: on a dome its height would hide the change
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
    """The ends of a colour scale: 0 or the smallest negative value, and the largest value."""
    known = values[np.isfinite(values)]
    low = float(known.min(initial=0.0))
    return low, float(known.max(initial=low + 1e-3))
