"""Plots of an HTML page as SVG in the page's colours: a histogram, points, and curves over frames."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from tacgen.report.sheet import counted, round_ticks

Array = np.ndarray
MAX_LABEL_LETTERS = 34  # of a name under a plot
MAX_DOTTED_FRAMES = 40  # frames of a curve whose points are marked
WIDTH, HEIGHT = 300, 170  # of every plot, in units of which a narrow page has one a pixel
LEFT, RIGHT, TOP, BOTTOM = 50, 288, 20, 130  # of the plot's area
POINT_GAP_PX = 9.0  # [px] between the points of scenes with one frame, which are set side by side by colour


class Axis(NamedTuple):
    """A scale of a plot: the values at its ends, and the pixels [px] where they are."""

    low: float
    high: float
    start: float
    end: float

    def at(self, value: float) -> float:
        """The pixel of a value."""
        return self.start + (self.end - self.start) * (value - self.low) / max(self.high - self.low, 1e-12)

    def ticks(self) -> list[float]:
        """At most five round numbers."""
        return round_ticks(self.low, self.high, 5)


def histogram(name: str, values: Array) -> str:
    """How many scenes have which value, labelled with the ends of the range and the largest count."""
    count, edges = np.histogram(values, bins=min(20, max(5, len(values) // 3)))
    x, y = Axis(edges[0], edges[-1], LEFT, RIGHT), Axis(0, count.max(), BOTTOM, TOP)
    bars = "".join(
        f"<rect class=dot x={x.at(left) + 0.5:.1f} y={y.at(n):.1f} width={(RIGHT - LEFT) / len(count) - 1:.1f} "
        f"height={BOTTOM - y.at(n):.1f} />"
        for n, left in zip(count, edges, strict=False)
    )
    return _svg(f"{bars}{_ticks(x, x.ticks())}{_text(LEFT, 13, counted(count.max(), 'scene'), 'start')}", name)


def scatter(a: str, x: Array, b: str, y: Array, colours: Sequence[str]) -> str:
    """A point for each pair of values, coloured by a class of the page's style, with ticks at round numbers."""
    right, up = Axis(x.min(), x.max(), LEFT, RIGHT), Axis(y.min(), y.max(), BOTTOM, TOP)
    points = "".join(
        f'<circle class="dot {colour}" cx={right.at(u):.1f} cy={up.at(v):.1f} r=2.6 />'
        for u, v, colour in zip(x, y, colours, strict=True)
    )
    return _svg(f"{_ticks(right, right.ticks())}{_beside(up)}{points}", a, b)


def curves(name: str, series: Iterable[tuple[str, Array]], span: tuple[float, float], named: Sequence[str]) -> str:
    """Curves over frames, coloured by classes of the page's style; a point where there is a single frame.

    Args:
        name: what they show, with its unit.
        series: colour and values (n,) of each.
        span: the lowest and the highest value, of this and of plots beside it.
        named: the movement of each frame.
    """
    frames, series = len(named), list(series)
    x, y = Axis(0, max(frames - 1, 1), LEFT, RIGHT), Axis(*span, BOTTOM, TOP)
    starts = [k for k in range(frames) if k == 0 or named[k] != named[k - 1]]
    grid = "".join(f'<path class=grid d="M{x.at(k - 0.5):.1f} {TOP}V{BOTTOM}"/>' for k in starts if k) + _beside(y)
    grid += "".join(_text(x.at(k - 0.5 * (k > 0)) + 3, 13, named[k], "start") for k in starts)
    grid += _ticks(x, sorted({round(v) for v in round_ticks(0, frames - 1)})) if frames > 1 else ""
    colours, drawn = list(dict.fromkeys(colour for colour, _ in series)), []
    for colour, values in series:
        if alone := len(values) == 1:
            beside = POINT_GAP_PX * (colours.index(colour) - (len(colours) - 1) / 2)
            at = [((LEFT + RIGHT) / 2 + beside if frames == 1 else x.at(0), y.at(values[0]))]
        else:
            at = [(x.at(k), y.at(v)) for k, v in enumerate(values)]
            drawn.append(f'<path class="line {colour}" d="M{"L".join(f"{u:.1f} {v:.1f}" for u, v in at)}"/>')
        if alone or frames <= MAX_DOTTED_FRAMES:
            size = f"r={3.2 if alone else 1.8}"
            drawn += [f'<circle class="dot {colour}" cx={u:.1f} cy={v:.1f} {size} />' for u, v in at]
    return _svg(f"{grid}{''.join(drawn)}", "frame" if frames > 1 else "the only frame", name)


def _ticks(x: Axis, values: Iterable[float]) -> str:
    """Ticks at some values below the plot."""
    return "".join(
        f'<path class=grid d="M{x.at(v):.1f} {BOTTOM + 1}v4"/>{_text(x.at(v), BOTTOM + 17, _number(v))}' for v in values
    )


def _beside(y: Axis) -> str:
    """Lines at round values across the plot, and these values at its left."""
    return "".join(
        f'<path class=grid d="M{LEFT} {y.at(v):.1f}H{RIGHT}"/>{_text(LEFT - 6, y.at(v) + 4, _number(v), "end")}'
        for v in y.ticks()
    )


def _svg(content: str, below: str, beside: str = "") -> str:
    """A plot with the names of its axes."""
    turned = f"translate(11 {(TOP + BOTTOM) / 2:g}) rotate(-90)"
    left = f'<text transform="{turned}" text-anchor=middle>{_label(beside)}</text>' if beside else ""
    under = _text((LEFT + RIGHT) / 2, HEIGHT - 5, below)
    return f'<svg class="card c0" viewBox="0 0 {WIDTH} {HEIGHT}" role=img>{content}{under}{left}</svg>'


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    return f"<text x={x:.1f} y={y:.1f} text-anchor={anchor}>{_label(text)}</text>"


def _number(value: float) -> str:
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


def _label(name: str) -> str:
    """A name, cut at the left if it is long."""
    cut = name if len(name) <= MAX_LABEL_LETTERS else "\N{HORIZONTAL ELLIPSIS}" + name[2 - MAX_LABEL_LETTERS :]
    return escape(cut)
