"""An animation of a bundle: camera, pressure and traction side by side, the force curve below."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.report.bundle_figure import rows_of, side_by_side

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ANIMATION_WRITERS = {".webp": "pillow", ".gif": "pillow", ".mp4": "ffmpeg"}  # matplotlib's writers
ANIMATION_FPS = 5  # frames; the shipped trajectories have 4 to 15
ANIMATION_ROWS, ANIMATION_DPI = 3, 100


def write(bundle: Bundle, out: Path) -> None:
    """Draw a bundle into `out`: webp or gif, or mp4 where ffmpeg is installed.

    Raises:
        UserError: a bundle without frames, another kind of file, or no ffmpeg.
        OSError: `out` cannot be written.
    """
    writer = writer_for(out, ANIMATION_FPS)
    if not bundle.frames:
        raise UserError(f"{bundle.path}: has no frames to show")
    film(bundle, writer, out)


def writer_for(out: Path, fps: int) -> object:
    """matplotlib's writer for the suffix of `out`. Raises UserError: another kind of file, or no ffmpeg."""
    from matplotlib import animation

    if (kind := ANIMATION_WRITERS.get(out.suffix.lower())) is None:
        raise UserError(f"{out.suffix or 'no suffix'}: unknown kind of film, use one of {', '.join(ANIMATION_WRITERS)}")
    if not animation.writers.is_available(kind):
        raise UserError(".mp4: needs ffmpeg on the PATH; .webp and .gif do without")
    return animation.writers[kind](fps=fps)


def record(figure: "Figure", frames: int, show: Callable[[int], None], writer: object, out: Path) -> None:
    """Write so many frames of a figure, each as it is after `show` with its number."""
    with writer.saving(figure, out, ANIMATION_DPI):  # type: ignore[attr-defined]
        for k in range(frames):
            show(k)
            writer.grab_frame()  # type: ignore[attr-defined]


def film(bundle: Bundle, writer: object, out: Path) -> None:
    """Draw the panels of all frames once; each frame of the animation shows one of each stack."""
    sheet, stacks, forces = side_by_side(bundle, rows_of(bundle, ANIMATION_ROWS))
    cursor = forces.axvline(0, color="black", linewidth=0.8)

    def show(k: int) -> None:
        cursor.set_xdata([k, k])
        for panels in stacks:
            for j, panel in enumerate(panels[1:], 1):
                panel.set_visible(j == k)

    record(sheet.figure, bundle.frames, show, writer, out)
