"""Curves over the frames of a bundle in a figure: its force, and the lift of a grasp."""

from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from tacgen.bundle.bundle import Bundle
from tacgen.bundle.force_error import force_error
from tacgen.mechanics.grasp_balance import Mode

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SEGMENT_COLOURS = {"press": "#e4e4e4", "slide": "#d3e5f5", "twist": "#fce5cd", "hold": "#f4f4f4", "release": "#ddefdd"}
SEGMENT_COLOURS |= {"close": "#e4e4e4", "lift": "#d3e5f5", "tilt": "#ece1f3", "replay": "#f4f4f4"}
FORCE_COLOURS = {"$F_x$": "#d55e00", "$F_y$": "#009e73", "$F_z$": "#0072b2"}  # Okabe and Ito's palette


def draw_forces(panel: "Axes", bundle: Bundle, shown: np.ndarray) -> None:
    """Plot the force over the frames, with the segments of the trajectory shaded and the pictured frames marked."""
    panel.set_xlabel("frame (pictured above: triangles)" if len(shown) else "frame", fontsize=8)
    panel.set_ylabel("force on gel [N]", fontsize=8)
    _segments(panel, bundle)
    if "/frames/force" not in bundle or not bundle.frames:
        panel.text(0.5, 0.5, "no frames" if not bundle.frames else "no forces", transform=panel.transAxes, ha="center")
        return
    panel.axhline(0, color="#808080", linewidth=0.6)
    frames = np.arange(bundle.frames)
    for (name, colour), values in zip(FORCE_COLOURS.items(), bundle["/frames/force"].T, strict=True):
        panel.plot(frames, values, color=colour, marker="o", markersize=2.5 if len(frames) < 80 else 0, label=name)
    panel.plot(shown, np.zeros(len(shown)), "k^", markersize=4, transform=panel.get_xaxis_transform(), clip_on=False)
    _legend(panel)
    largest = int(np.linalg.norm(bundle["/frames/force"], axis=1).argmax())
    if (error := force_error(bundle)) and error.text(largest):
        panel.set_xlabel(f"{panel.get_xlabel()}; the largest force {error.text(largest)} ({error.kind})")


def draw_lift(panel: "Axes", bundle: Bundle) -> None:
    """Plot how high the fingers and the object of a grasp are above their start, with frames in which it falls."""
    _segments(panel, bundle)
    panel.set_xlabel("frame", fontsize=8)
    panel.set_ylabel("lift [mm]", fontsize=8)
    for name, label, colour in (("sensor", "fingers", "#606060"), ("object", "object", "#cc79a7")):
        height = bundle[f"/frames/grasp/{name}"][:, 2, 3]
        panel.plot(height - height[0], color=colour, marker="o", markersize=2.5, label=label)
    falls = np.flatnonzero(bundle["/frames/grasp/mode"] == Mode.falling)
    if len(falls):
        panel.plot(falls, (height - height[0])[falls], "v", color="#b00000", markersize=6, label="falls")
    _legend(panel)


def _legend(panel: "Axes") -> None:
    panel.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _segments(panel: "Axes", bundle: Bundle) -> None:
    """An axis of frames, with the segments of the trajectory shaded and named."""
    panel.tick_params(labelsize=7, length=2)
    panel.spines[["top", "right"]].set_visible(False)
    start = 0
    for kind, group in groupby(bundle.segments):
        stop = start + len(list(group))
        panel.axvspan(start - 0.5, stop - 0.5, color=SEGMENT_COLOURS.get(kind, "white"), linewidth=0)
        panel.text((start + stop - 1) / 2, 1.02, kind, transform=panel.get_xaxis_transform(), fontsize=8, ha="center")
        start = stop
    if bundle.frames < bundle.attrs["frames_planned"]:
        middle = (bundle.frames + bundle.attrs["frames_planned"] - 1) / 2
        panel.text(middle, 1.02, "not reached", transform=panel.get_xaxis_transform(), fontsize=8, ha="center")
    panel.set_xlim(-0.5, max(bundle.frames, bundle.attrs["frames_planned"]) - 0.5)
    panel.locator_params(axis="x", integer=True, min_n_ticks=1)
