"""Figure of forces of another simulator beside tacgen's, frame by frame."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tacgen.report.bundle_figure import save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = np.ndarray
HALF_90_PER_STD = 1.645  # half the 90 % interval of a normal distribution over its standard deviation [-]
MAX_NAMED_LOGS = 12  # most logs whose names have room
OUR_COLOUR, THEIR_COLOUR = "#0072b2", "#d55e00"


class Series(NamedTuple):
    """The frames of a log: forces on the gel (n, 3) [N], standard deviation of ours, and theirs if they are known."""

    name: str
    ours: Array
    std: Array | None
    theirs: Array | None
    friction: bool  # whether theirs includes friction


def draw(series: Sequence[Series], out: Path) -> None:
    """Plot normal force, its error and tangential force of all logs, one after the other, into `out`.

    Raises UserError: the suffix of `out` is not an image format.
    """
    from matplotlib.figure import Figure

    count = sum(len(one.ours) for one in series)
    sheet = Figure(figsize=(min(4.5 + 0.04 * count, 16), 6.4), layout="constrained")
    normal, error, side = sheet.subplots(3, sharex=True, height_ratios=(2, 1, 2))
    start = 0
    for one in series:
        x, first = start + np.arange(len(one.ours)), start == 0
        std = np.zeros_like(one.ours) if one.std is None else one.std
        _curves(normal, x, -one.ours[:, 2], std[:, 2], None if one.theirs is None else -one.theirs[:, 2], first)
        shear, spread = np.linalg.norm(one.ours[:, :2], axis=1), np.linalg.norm(std[:, :2], axis=1)
        theirs = np.linalg.norm(one.theirs[:, :2], axis=1) if one.theirs is not None and one.friction else None
        _curves(side, x, shear, spread, theirs, first)
        if one.theirs is not None:
            _interval(error, x, 0 * std[:, 2], std[:, 2])
            error.plot(x, one.ours[:, 2] - one.theirs[:, 2], ".-", color=THEIR_COLOUR, markersize=3, linewidth=1)
        if len(series) <= MAX_NAMED_LOGS:
            leaning = {"transform": normal.get_xaxis_transform(), "rotation": 15}
            normal.text(start, 1.03, one.name, fontsize=7, parse_math=False, **leaning)
        start += len(one.ours)
        for axes in (normal, error, side) if start < count else ():
            axes.axvline(start - 0.5, color="#cccccc", linewidth=0.6)
    error.axhline(0, color="#888888", linewidth=0.8)
    normal.set_ylabel("normal force [N]")
    error.set_ylabel("simulator\nless tacgen [N]")
    side.set(ylabel="tangential force [N]", xlabel="frame")
    if series:
        normal.legend(fontsize=8)
    save(sheet, out)


def _curves(axes: "Axes", x: Array, ours: Array, std: Array, theirs: Array | None, named: bool) -> None:
    """Our force with its 90 % interval, and theirs."""
    _interval(axes, x, ours, std)
    labels = ("tacgen, 90 % interval", "simulator") if named else (None, None)
    thin: dict[str, Any] = {"markersize": 3, "linewidth": 1}
    axes.plot(x, ours, ".-", color=OUR_COLOUR, label=labels[0], **thin)
    if theirs is not None:
        axes.plot(x, theirs, ".--", color=THEIR_COLOUR, label=labels[1], **thin)


def _interval(axes: "Axes", x: Array, middle: Array, std: Array) -> None:
    half = HALF_90_PER_STD * std
    axes.fill_between(x, middle - half, middle + half, color=OUR_COLOUR, alpha=0.3, linewidth=0)
