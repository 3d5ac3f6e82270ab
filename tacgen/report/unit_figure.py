"""Figure of the forces of a calibrated unit."""

from collections.abc import Sequence
from pathlib import Path

from tacgen.report.bundle_figure import save


def draw(seen: Sequence[tuple[float, float]], unseen: Sequence[tuple[float, float]], out: Path) -> None:
    """Plot pairs of measured and computed forces [N], of presses that the fit has and has not seen, into `out`.

    Raises UserError: the suffix of `out` is not an image format.
    """
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(4.6, 4.4), layout="constrained")
    panel = sheet.subplots()
    for pairs, colour, name in ((seen, "#0072b2", "seen by the fit"), (unseen, "#d55e00", "not seen")):
        if pairs:
            panel.plot(*zip(*pairs, strict=True), "o", color=colour, markersize=4, label=name)
    panel.axline((0, 0), slope=1, color="#888888", linewidth=0.8)
    panel.set(xlabel="measured force [N]", ylabel="force from the picture [N]")
    panel.legend()
    save(sheet, out)
