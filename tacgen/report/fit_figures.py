"""Figures of fits: forces over depth, computed over measured forces, and camera images in rows.

All raise UserError where the suffix of `out` is not an image format.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacgen.report.bundle_figure import save

Array = np.ndarray
BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#888888"
NO_CHANGE, CONTRAST = 128.0, 2.0  # of the images of changes [counts], [-]


def forces_over_depth(depth: Array, measured: Array, fitted: Array, off: Array, out: Path) -> None:
    """Plot forces [N] and the relative error `off` of the fit over depth [mm], each (n,), into `out`."""
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(5.2, 4.6), layout="constrained")
    forces, errors = sheet.subplots(2, sharex=True, height_ratios=(2, 1))
    forces.plot(depth, fitted, color=BLUE, label="fitted")
    forces.plot(depth, measured, "o", color=ORANGE, markersize=4, label="measured")
    forces.set_ylabel("force [N]")
    forces.legend()
    errors.axhline(0, color=GREY, linewidth=0.8)
    errors.plot(depth, 100 * off, "o-", color=BLUE, markersize=4)
    errors.set(xlabel="depth [mm]", ylabel="fitted less\nmeasured [%]")
    save(sheet, out)


def computed_over_measured(
    seen: Sequence[tuple[float, float]], unseen: Sequence[tuple[float, float]], out: Path
) -> None:
    """Plot pairs of measured and computed forces [N], of presses that the fit has and has not seen, into `out`."""
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(4.6, 4.4), layout="constrained")
    panel = sheet.subplots()
    for pairs, colour, name in ((seen, BLUE, "seen by the fit"), (unseen, ORANGE, "not seen")):
        if pairs:
            panel.plot(*zip(*pairs, strict=True), "o", color=colour, markersize=4, label=name)
    panel.axline((0, 0), slope=1, color=GREY, linewidth=0.8)
    panel.set(xlabel="measured force [N]", ylabel="force from the picture [N]")
    panel.legend()
    save(sheet, out)


def pictures(rows: Sequence[Sequence[tuple[str, Array, Array]]], title: str, out: Path) -> None:
    """Write rows of (title, image, untouched image), (H, W, 3) of 8 bit, with the images at the left and the changes
    against the untouched ones, CONTRAST times as strong, at the right."""
    from matplotlib.figure import Figure

    count = len(rows[0])
    figure = Figure(figsize=(14, 1.0 + 2.0 * len(rows)), layout="constrained")
    axes = figure.subplots(len(rows), 2 * count, squeeze=False)
    for line, row in zip(axes, rows, strict=True):
        for k, (name, image, untouched) in enumerate(row):
            change = NO_CHANGE + CONTRAST * (image.astype(float) - untouched)
            line[k].imshow(image)
            line[k].set_title(name, fontsize=8, parse_math=False)
            line[k + count].imshow(np.clip(change, 0, 255).astype(np.uint8))
            line[k + count].set_title(f"change x {CONTRAST:g}, {name.split(':')[0]}", fontsize=8, parse_math=False)
    for one in axes.ravel():
        one.set_axis_off()
    figure.suptitle(title, parse_math=False)
    save(figure, out)
