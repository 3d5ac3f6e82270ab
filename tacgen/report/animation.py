"""An animation of a bundle: camera, pressure and traction side by side, the force curve below."""

from pathlib import Path

import numpy as np

from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.report.bundle_figure import (
    BELOW,
    FORCES,
    ROWS,
    draw_camera,
    draw_forces,
    heading,
    image_size,
    only,
    scale_of,
    window_of,
)
from tacgen.report.sheet import Page

KINDS = {".webp": "pillow", ".gif": "pillow", ".mp4": "ffmpeg"}  # matplotlib's writers
PER_SECOND = 5  # frames; the shipped trajectories have 4 to 15
WIDE, LEFT, RIGHT, TOP, BETWEEN, BAR, ABOVE_FORCES = 2.1, 0.65, 0.75, 0.5, 0.7, 0.6, 0.8  # inches
DPI = 100


def write(path: Path, out: Path) -> None:
    """Draw a bundle, or the only one of a folder, into `out`: webp or gif, or mp4 where ffmpeg is installed.

    Raises:
        UserError: no whole bundle, one without frames, another kind of file, or no ffmpeg.
        OSError: `out` cannot be written.
    """
    from matplotlib import animation

    if (kind := KINDS.get(out.suffix.lower())) is None:
        raise UserError(f"{out.suffix or 'no suffix'}: unknown kind of film, use one of {', '.join(KINDS)}")
    if not animation.writers.is_available(kind):
        raise UserError(".mp4: needs ffmpeg on the PATH; .webp and .gif do without")
    bundle = only(path)
    if not bundle.frames:
        raise UserError(f"{bundle.path}: has no frames to show")
    film(bundle, animation.writers[kind](fps=PER_SECOND), out)


def film(bundle: Bundle, writer: object, out: Path) -> None:
    """Draw the panels of all frames once, one above the other; each frame of the animation shows one of each stack."""
    rows = [draw for wanted, draw in ROWS[:3] if any(path in bundle for path in wanted)]
    image, window, frames = image_size(bundle), window_of(bundle), np.arange(bundle.frames)
    tall = WIDE * image[0] / image[1]
    bars = [BAR * (draw is not draw_camera) for draw in rows]  # beside each panel
    across = LEFT + max(len(rows), 2) * (WIDE + BETWEEN) - BETWEEN + max(sum(bars), BAR) + 0.2
    sheet = Page(across, (TOP + tall if rows else 0.2) + ABOVE_FORCES + FORCES + BELOW)
    stacks = []
    for c, draw in enumerate(rows):
        x = LEFT + c * (WIDE + BETWEEN) + sum(bars[:c])
        panels = [sheet.axes(x, TOP, WIDE, tall) for _ in frames]
        colours = draw(bundle, panels, frames, image, window)
        if colours is not None:
            sheet.colour_bar(*colours, x=x + WIDE + 0.03, y=TOP, h=tall)
        panels[0].tick_params(labelbottom=True, bottom=True)  # the lowest panel, always visible: its ticks serve all
        panels[0].set_xlabel(f"x [{scale_of(bundle).unit}]", fontsize=8, labelpad=1)
        stacks.append(panels[1:])
    forces = sheet.axes(LEFT, sheet.height - BELOW - FORCES, across - LEFT - RIGHT, FORCES)
    draw_forces(forces, bundle, frames[:0])
    cursor = forces.axvline(0, color="black", linewidth=0.8)
    heading(sheet, bundle)
    with writer.saving(sheet.figure, out, DPI):  # type: ignore[attr-defined]
        for k in frames:
            cursor.set_xdata([k, k])
            for panels in stacks:
                for j, panel in enumerate(panels, 1):
                    panel.set_visible(j == k)
            writer.grab_frame()  # type: ignore[attr-defined]
