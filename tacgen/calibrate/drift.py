"""How much of the change of photographs needs no dent: light that drifts, in time or smoothly over the picture."""

from collections.abc import Sequence

import numpy as np

from tacgen.calibrate.fit_unit import Gauge
from tacgen.calibrate.press_colours import PressPicture

Array = np.ndarray
LEAST = 4  # pictures of a sequence from which a drift can be told


def share(pictures: Sequence[PressPicture], gauge: Gauge) -> float:
    """Share of the pictures' squared changes that the better one of two drifts explains.

    Smooth light: see `PressView.picture`. In time: one pattern that changes linearly, with each picture predicted from
    the others of its recording; pictures without time count in their order, and those of short recordings together.
    """
    whole = sum(float((one.change**2).sum()) for one in pictures)
    long = [k for k in np.unique(gauge.recording) if (gauge.recording == k).sum() >= LEAST]
    rest = ~np.isin(gauge.recording, long)
    part = 0.0
    for where in (*(gauge.recording == k for k in long), rest):
        here, time = np.flatnonzero(where), gauge.time[where]
        if len(here) >= LEAST:
            time = time if np.isfinite(time).all() and where is not rest else np.arange(len(here))
            part += _in_time(np.array([pictures[int(k)].change.ravel() for k in here]), time)
    return max(part, sum(one.smooth for one in pictures)) / whole


def _in_time(changes: Array, time: Array) -> float:
    """Sum of squares of changes (n, values) that lines over the time (n,) predict, each from the other rows."""
    table = np.column_stack([np.ones(len(time)), time - time.mean()])
    hat = table @ np.linalg.pinv(table)
    left = (changes - hat @ changes) / np.maximum(1 - np.diag(hat), 1e-9)[:, None]
    return max(0.0, float((changes**2).sum() - (left**2).sum()))
