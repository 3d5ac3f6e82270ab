"""An animation of a bundle: camera, pressure and traction side by side, the force curve below."""

from pathlib import Path

import numpy as np

from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.report.bundle_figure import (
    BELOW_IN,
    FIGURE_ROWS,
    FORCES_IN,
    draw_camera,
    draw_forces,
    heading,
    image_size,
    only,
    scale_of,
    window_of,
)
from tacgen.report.sheet import Page

ANIMATION_WRITERS = {".webp": "pillow", ".gif": "pillow", ".mp4": "ffmpeg"}  # matplotlib's writers
ANIMATION_FPS = 5  # frames; the shipped trajectories have 4 to 15
# inches
PANEL_WIDTH_IN, LEFT_MARGIN_IN, RIGHT_MARGIN_IN, TOP_MARGIN_IN, PANEL_GAP_IN, COLOUR_BAR_IN, FORCES_GAP_IN = (
    2.1,
    0.65,
    0.75,
    0.5,
    0.7,
    0.6,
    0.8,
)
ANIMATION_DPI = 100


def write(path: Path, out: Path) -> None:
    """Draw a bundle, or the only one of a folder, into `out`: webp or gif, or mp4 where ffmpeg is installed.

    Raises:
        UserError: no whole bundle, one without frames, another kind of file, or no ffmpeg.
        OSError: `out` cannot be written.
    """
    from matplotlib import animation

    if (kind := ANIMATION_WRITERS.get(out.suffix.lower())) is None:
        raise UserError(f"{out.suffix or 'no suffix'}: unknown kind of film, use one of {', '.join(ANIMATION_WRITERS)}")
    if not animation.writers.is_available(kind):
        raise UserError(".mp4: needs ffmpeg on the PATH; .webp and .gif do without")
    bundle = only(path)
    if not bundle.frames:
        raise UserError(f"{bundle.path}: has no frames to show")
    film(bundle, animation.writers[kind](fps=ANIMATION_FPS), out)


def film(bundle: Bundle, writer: object, out: Path) -> None:
    """Draw the panels of all frames once, one above the other; each frame of the animation shows one of each stack."""
    rows = [draw for wanted, draw in FIGURE_ROWS[:3] if any(path in bundle for path in wanted)]
    image, window, frames = image_size(bundle), window_of(bundle), np.arange(bundle.frames)
    tall = PANEL_WIDTH_IN * image[0] / image[1]
    bars = [COLOUR_BAR_IN * (draw is not draw_camera) for draw in rows]  # beside each panel
    across = (
        LEFT_MARGIN_IN
        + max(len(rows), 2) * (PANEL_WIDTH_IN + PANEL_GAP_IN)
        - PANEL_GAP_IN
        + max(sum(bars), COLOUR_BAR_IN)
        + 0.2
    )
    sheet = Page(across, (TOP_MARGIN_IN + tall if rows else 0.2) + FORCES_GAP_IN + FORCES_IN + BELOW_IN)
    stacks = []
    for c, draw in enumerate(rows):
        x = LEFT_MARGIN_IN + c * (PANEL_WIDTH_IN + PANEL_GAP_IN) + sum(bars[:c])
        panels = [sheet.axes(x, TOP_MARGIN_IN, PANEL_WIDTH_IN, tall) for _ in frames]
        colours = draw(bundle, panels, frames, image, window)
        if colours is not None:
            sheet.colour_bar(*colours, x=x + PANEL_WIDTH_IN + 0.03, y=TOP_MARGIN_IN, h=tall)
        panels[0].tick_params(labelbottom=True, bottom=True)  # the lowest panel, always visible: its ticks serve all
        panels[0].set_xlabel(f"x [{scale_of(bundle).unit}]", fontsize=8, labelpad=1)
        stacks.append(panels[1:])
    forces = sheet.axes(
        LEFT_MARGIN_IN, sheet.height - BELOW_IN - FORCES_IN, across - LEFT_MARGIN_IN - RIGHT_MARGIN_IN, FORCES_IN
    )
    draw_forces(forces, bundle, frames[:0])
    cursor = forces.axvline(0, color="black", linewidth=0.8)
    heading(sheet, bundle)
    with writer.saving(sheet.figure, out, ANIMATION_DPI):  # type: ignore[attr-defined]
        for k in frames:
            cursor.set_xdata([k, k])
            for panels in stacks:
                for j, panel in enumerate(panels, 1):
                    panel.set_visible(j == k)
            writer.grab_frame()  # type: ignore[attr-defined]
