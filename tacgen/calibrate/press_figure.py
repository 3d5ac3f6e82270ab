"""A figure of presses that a fit has not seen: photographed, and rendered with the sensor file and with the fit."""

from pathlib import Path

import numpy as np

from tacgen.calibrate.unseen import Unseen
from tacgen.render import images
from tacgen.sensor.model import LitSensor

Array = np.ndarray
MOST = 6  # presses in the figure
SPP = 16  # samples a pixel, of gels that scatter light
GREY, CONTRAST = 128.0, 2.0  # of the pictures of changes


def draw(sensor: LitSensor, unseen: Unseen, untouched: Array, out: Path) -> None:
    """Write the figure: a press a row, its picture and the change against the untouched picture, each photographed,
    rendered before and rendered after the fit; `untouched`: photograph (H, W, 3), 8 bit."""
    from matplotlib.figure import Figure

    count = min(MOST, len(unseen.presses))
    figure = Figure(figsize=(14, 1.0 + 2.0 * count), layout="constrained")
    axes = figure.subplots(count, 6, squeeze=False)
    before = images.Renderer(sensor, SPP, 0, markers=False)
    for k in range(count):
        press, face = unseen.presses[k], unseen.faces[k]
        after = images.Renderer(unseen.sensors[k], SPP, 0, markers=False)
        shown = [(press.picture, untouched)]
        shown += [(r.develop(r.image(face)), r.develop(r.flat())) for r in (before, after)]
        titles = [press.name, f"before: {unseen.score(0, k)}", f"after: {unseen.score(1, k)}"]
        for column, (picture, flat) in enumerate(shown):
            change = GREY + CONTRAST * (picture.astype(float) - flat)
            axes[k, column].imshow(picture)
            axes[k, column].set_title(titles[column], fontsize=8)
            axes[k, column + 3].imshow(np.clip(change, 0, 255).astype(np.uint8))
            axes[k, column + 3].set_title(
                f"change x {CONTRAST:g}, {('photograph', 'before', 'after')[column]}", fontsize=8
            )
    for one in axes.ravel():
        one.set_axis_off()
    figure.suptitle(f"{sensor.name}, presses that the fit has not seen: {unseen}")
    figure.savefig(out, dpi=110, format=out.suffix.lstrip(".") or "png")
