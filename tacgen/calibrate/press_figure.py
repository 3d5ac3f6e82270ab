"""A figure of presses that a fit has not seen: photographed, and rendered with the sensor file and with the fit."""

from pathlib import Path

import numpy as np

from tacgen.calibrate.unseen import Unseen
from tacgen.render import images
from tacgen.sensor.model import LitSensor

Array = np.ndarray
MOST = 6  # presses in the figure
SPP = 16  # samples a pixel, of gels that scatter light


def draw(sensor: LitSensor, unseen: Unseen, untouched: Array, out: Path) -> None:
    """Write the figure; `untouched`: photograph (H, W, 3), 8 bit."""
    from tacgen.report import picture_rows

    before, rows = images.Renderer(sensor, SPP, 0, markers=False), []
    for k in range(min(MOST, len(unseen.presses))):
        press, face = unseen.presses[k], unseen.faces[k]
        after = images.Renderer(unseen.sensors[k], SPP, 0, markers=False)
        titles = [press.name, f"before: {unseen.score(0, k)}", f"after: {unseen.score(1, k)}"]
        shown = [(press.picture, untouched)]
        shown += [(r.develop(r.image(face)), r.develop(r.flat())) for r in (before, after)]
        rows.append([(title, *pair) for title, pair in zip(titles, shown, strict=True)])
    picture_rows.draw(rows, f"{sensor.name}, presses that the fit has not seen: {unseen}", out)
