"""An animation of a bundle: camera, pressure and traction side by side, the force curve below."""

from pathlib import Path

from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.report.bundle_figure import rows_of, side_by_side

ANIMATION_WRITERS = {".webp": "pillow", ".gif": "pillow", ".mp4": "ffmpeg"}  # matplotlib's writers
ANIMATION_FPS = 5  # frames; the shipped trajectories have 4 to 15
ANIMATION_ROWS, ANIMATION_DPI = 3, 100


def write(bundle: Bundle, out: Path) -> None:
    """Draw a bundle into `out`: webp or gif, or mp4 where ffmpeg is installed.

    Raises:
        UserError: a bundle without frames, another kind of file, or no ffmpeg.
        OSError: `out` cannot be written.
    """
    from matplotlib import animation

    if (kind := ANIMATION_WRITERS.get(out.suffix.lower())) is None:
        raise UserError(f"{out.suffix or 'no suffix'}: unknown kind of film, use one of {', '.join(ANIMATION_WRITERS)}")
    if not animation.writers.is_available(kind):
        raise UserError(".mp4: needs ffmpeg on the PATH; .webp and .gif do without")
    if not bundle.frames:
        raise UserError(f"{bundle.path}: has no frames to show")
    film(bundle, animation.writers[kind](fps=ANIMATION_FPS), out)


def film(bundle: Bundle, writer: object, out: Path) -> None:
    """Draw the panels of all frames once; each frame of the animation shows one of each stack."""
    sheet, stacks, forces = side_by_side(bundle, rows_of(bundle, ANIMATION_ROWS))
    cursor = forces.axvline(0, color="black", linewidth=0.8)
    with writer.saving(sheet.figure, out, ANIMATION_DPI):  # type: ignore[attr-defined]
        for k in range(bundle.frames):
            cursor.set_xdata([k, k])
            for panels in stacks:
                for j, panel in enumerate(panels[1:], 1):
                    panel.set_visible(j == k)
            writer.grab_frame()  # type: ignore[attr-defined]
