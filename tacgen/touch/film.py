"""A film of an episode: what each finger's camera sees, and below it the forces on its gel over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.base import output_file
from tacgen.report import animation
from tacgen.report.force_figure import OUR_COLOUR, THEIR_COLOUR
from tacgen.report.sheet import Page
from tacgen.touch.episode import Array, EpisodeLog, Touch
from tacgen.touch.label_columns import Felt, file_of, title
from tacgen.touch.recording import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_FILM_FRAMES = 150  # of longer episodes every second row is shown, or fewer
# inches: a picture, the gap between the fingers, margins, and the plot of forces
PICTURE_IN, BETWEEN_IN, SIDE_IN, HEAD_IN, ABOVE_PLOT_IN, PLOT_IN, FOOT_IN = 3.0, 0.55, 0.65, 0.55, 0.25, 1.5, 0.75
SHEAR_COLOUR, SLIP_COLOUR, LIFTED_COLOUR, NOTE_COLOUR = "#009e73", "#fce5cd", "#606060", "#b00000"
LIFTED_AT, NOTE_AT = 1.03, -0.02  # height of the marks over the plot's [-]


def write(source: Recording, felt: Felt, out: Path, *, overwrite: bool) -> list[Path]:
    """Draw each episode into `out`/<name>.webp, or a single one into the file `out`: webp or gif, or mp4 with ffmpeg.

    Raises:
        UserError: another kind of file, no ffmpeg, or a file is there already.
    """
    made = [file_of(episode, out, ".webp") for episode, _ in felt.values()]
    for (episode, fingers), path in zip(felt.values(), made, strict=True):
        step = -(-len(episode) // MAX_FILM_FRAMES)
        rows = np.arange(0, len(episode), step)
        spacing = float(np.diff(episode.time).mean()) if len(episode) > 1 else 1.0
        writer = animation.writer_for(path, max(1, round(1 / (spacing * step))))
        with output_file.written(path, [source.path], overwrite=overwrite) as new:
            _draw(episode, fingers, rows, writer, new)
    return made


def _draw(episode: EpisodeLog, fingers: Sequence[Touch], rows: Array, writer: object, out: Path) -> None:
    """One frame for each of `rows`."""
    time = episode.time - episode.time[0]
    shape = fingers[0].image(0).shape
    tall, wide = PICTURE_IN * shape[0] / shape[1], len(fingers) * (PICTURE_IN + BETWEEN_IN) - BETWEEN_IN
    sheet = Page(2 * SIDE_IN + wide, HEAD_IN + tall + ABOVE_PLOT_IN + PLOT_IN + FOOT_IN)
    heading = sheet.figure.suptitle("", x=SIDE_IN / sheet.width, y=0.99, ha="left", va="top", fontsize=9)
    across = range(len(fingers))
    lefts = [SIDE_IN + k * (PICTURE_IN + BETWEEN_IN) for k in across]
    pictures = [_picture(sheet.axes(x, HEAD_IN, PICTURE_IN, tall), f) for x, f in zip(lefts, fingers, strict=True)]
    plots = [sheet.axes(x, HEAD_IN + tall + ABOVE_PLOT_IN, PICTURE_IN, PLOT_IN) for x in lefts]
    highest = max(np.nanmax([*np.linalg.norm(f.force, axis=1), *f.engine, 0.1]) for f in fingers)
    for plot, finger in zip(plots, fingers, strict=True):
        _curves(plot, time, finger, highest)
    plots[0].set_ylabel("force on the gel [N]", fontsize=8)
    sheet.figure.legend(*plots[0].get_legend_handles_labels(), fontsize=7, ncols=6, frameon=False, loc="lower center")
    cursors = [plot.axvline(0, color="black", linewidth=0.8) for plot in plots]

    def show(k: int) -> None:
        row = int(rows[k])
        notes = [f"{f.finger}: {f.note[row]}" for f in fingers if f.note[row]]
        heading.set_text("\n".join([f"{title(episode)}, {time[row]:.2f} s", *notes]))
        for picture, cursor, finger in zip(pictures, cursors, fingers, strict=True):
            picture.set_data(finger.image(row))
            picture.axes.set_title(_state(finger, row), fontsize=8, pad=3)
            cursor.set_xdata([time[row], time[row]])

    animation.record(sheet.figure, len(rows), show, writer, out)


def _picture(axes: "Axes", finger: Touch) -> Any:
    axes.set_axis_off()
    return axes.imshow(finger.image(0), aspect="auto")


def _state(finger: Touch, row: int) -> str:
    """`left: key, slips`."""
    said = [finger.touched[row] or "no contact"]
    said += ["slips"] * bool(finger.moved[row]) + ["lifted"] * bool(finger.lifted[row])
    return f"{finger.finger}: {', '.join(said)}"


def _curves(plot: "Axes", time: Array, finger: Touch, highest: float) -> None:
    """Normal and tangential force with the expected error, the engine's normal force, and marks of rows."""
    normal, shear = -finger.force[:, 2], np.linalg.norm(finger.force[:, :2], axis=1)
    spread = np.nan_to_num(finger.error) * np.linalg.norm(finger.force, axis=1)
    plot.fill_between(time, normal - spread, normal + spread, color=OUR_COLOUR, alpha=0.3, linewidth=0)
    plot.plot(time, normal, color=OUR_COLOUR, linewidth=1.2, label="normal")
    plot.plot(time, shear, color=SHEAR_COLOUR, linewidth=1.2, label="tangential")
    plot.plot(time, finger.engine, "--", color=THEIR_COLOUR, linewidth=1.0, label="asked for, or the engine's")
    across, up = plot.get_xaxis_transform(), np.asarray(finger.moved, bool)
    plot.fill_between(
        time, 0, 1, where=up.tolist(), step="mid", transform=across, color=SLIP_COLOUR, linewidth=0, zorder=0,
        label="slips",
    )  # fmt: skip
    style: dict[str, Any] = {"transform": across, "clip_on": False, "linestyle": "none"}
    marks = (
        (np.asarray(finger.lifted, bool), LIFTED_AT, "s", LIFTED_COLOUR, "lifted"),
        (np.array([bool(note) for note in finger.note]), NOTE_AT, "|", NOTE_COLOUR, "note"),
    )
    for which, height, marker, colour, label in marks:
        at = time[which]
        plot.plot(at, np.full(len(at), height), marker=marker, color=colour, markersize=3, label=label, **style)
    plot.set(xlim=(time[0], max(time[-1], time[0] + 1e-3)), ylim=(-0.05 * highest, 1.1 * highest))
    plot.set_xlabel("time [s]", fontsize=8, labelpad=1)
    plot.tick_params(labelsize=7, length=2)
    plot.spines[["top", "right"]].set_visible(False)
