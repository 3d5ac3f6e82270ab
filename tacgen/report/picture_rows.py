"""A figure of camera images in rows, each beside its change against the untouched image."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacgen.report.bundle_figure import save

Array = np.ndarray
GREY, CONTRAST = 128.0, 2.0  # of the images of changes


def draw(rows: Sequence[Sequence[tuple[str, Array, Array]]], title: str, out: Path) -> None:
    """Write rows of (title, image, untouched image), (H, W, 3) of 8 bit, with the images at the left and the changes
    against the untouched ones, twice as strong, at the right.

    Raises UserError: the suffix of `out` is not an image format.
    """
    from matplotlib.figure import Figure

    count = len(rows[0])
    figure = Figure(figsize=(14, 1.0 + 2.0 * len(rows)), layout="constrained")
    axes = figure.subplots(len(rows), 2 * count, squeeze=False)
    for line, row in zip(axes, rows, strict=True):
        for k, (name, image, untouched) in enumerate(row):
            change = GREY + CONTRAST * (image.astype(float) - untouched)
            line[k].imshow(image)
            line[k].set_title(name, fontsize=8, parse_math=False)
            line[k + count].imshow(np.clip(change, 0, 255).astype(np.uint8))
            line[k + count].set_title(f"change x {CONTRAST:g}, {name.split(':')[0]}", fontsize=8, parse_math=False)
    for one in axes.ravel():
        one.set_axis_off()
    figure.suptitle(title, parse_math=False)
    save(figure, out)
