"""Parts of reports: pages of plots, counts and durations as text."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MIN_IMAGE_HEIGHT_IN = 0.01  # [inch]


def round_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """At most so many round numbers from low to high, evenly spaced."""
    from matplotlib.ticker import MaxNLocator

    values = MaxNLocator(most - 1, steps=[1, 2, 5, 10]).tick_values(low, high)
    return [float(value) + 0.0 for value in values if low <= value <= high]


class Page:
    """A matplotlib figure of this size [inch], whose plots are placed from its left and upper edges."""

    def __init__(self, width: float, height: float) -> None:
        from matplotlib.figure import Figure

        self.width, self.height = width, height
        self.figure = Figure(figsize=(width, height))

    def axes(self, x: float, y: float, w: float, h: float) -> "Axes":
        """New axes of size (w, h) whose upper left corner is at (x, y) [inch]; of a thin image at least
        MIN_IMAGE_HEIGHT_IN high.
        """
        h = max(h, MIN_IMAGE_HEIGHT_IN)
        place = (x / self.width, 1 - (y + h) / self.height, w / self.width, h / self.height)
        return self.figure.add_axes(place)

    def row(self, count: int, x: float, y: float, w: float, h: float, gap: float) -> list["Axes"]:
        """So many axes of size (w, h) side by side, the first one's upper left corner at (x, y) [inch]."""
        return [self.axes(x + k * (w + gap), y, w, h) for k in range(count)]

    def colour_bar(self, drawn: Any, label: str, *, x: float, y: float, h: float) -> "Axes":
        """The colour bar of what was `drawn`, of height h with its upper left corner at (x, y) [inch]."""
        bar = self.axes(x, y, 0.1, h)
        self.figure.colorbar(drawn, cax=bar).set_label(label, fontsize=8)
        bar.tick_params(labelsize=7, length=2)
        return bar


def counted(n: int, noun: str) -> str:
    """`1 scene`, `2 scenes`."""
    return f"{n} {noun}" + ("" if n == 1 else "s")


def duration(seconds: float) -> str:
    """`40 s`, `12 min`, `3.1 h`."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
