"""Draw docs/cookbook/sensor_pairs.png and contact_events.png from bundles of the recipes with these names.

python scripts/cookbook_figures.py out docs/cookbook, after `tacgen run sensor_pairs -o out/sensor_pairs` and
`tacgen run contact_events -o out/contact_events`.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tacgen.bundle import caption, dataset
from tacgen.bundle.bundle import Bundle
from tacgen.report.bundle_figure import image_size

COLOURS = {"sticks": "#0b6fa4", "friction used": "#c2571a"}
HEIGHT, DPI = 1.6, 100  # of a panel [inches]; pixels an inch


def pairs(bundles: list[Bundle]) -> Figure:
    """A row for the camera and one for the pressure of each contact, a column for each sensor; the last frame."""
    contacts = sorted({int(bundle.attrs["pair"]) for bundle in bundles})
    sensors = list(dict.fromkeys(bundle.attrs["sensor"] for bundle in bundles))
    found = {(int(bundle.attrs["pair"]), bundle.attrs["sensor"]): bundle for bundle in bundles}
    largest = max(bundle["/frames/pressure"].max() for bundle in bundles)
    shapes = [image_size(found[contacts[0], sensor]) for sensor in sensors]
    wide = [width / height for height, width in shapes]
    size = HEIGHT * sum(wide) + 1.8, 2 * len(contacts) * (HEIGHT + 0.15)
    sheet = Figure(figsize=size, layout="constrained")
    grid = sheet.subplots(2 * len(contacts), len(sensors), squeeze=False, width_ratios=wide)
    for row, contact in zip(range(0, len(grid), 2), contacts, strict=True):
        for camera, map_, sensor in zip(grid[row], grid[row + 1], sensors, strict=True):
            bundle = found[contact, sensor]
            normal = -bundle.frame("/frames/force", bundle.frames - 1)[2]
            camera.imshow(bundle.frame("/frames/rgb", bundle.frames - 1))
            camera.set_title(f"{sensor}: {normal:.3f} N", fontsize=9)
            pressure = bundle.frame("/frames/pressure", bundle.frames - 1)
            drawn = map_.imshow(pressure, vmin=0, vmax=largest)
        grid[row, 0].set_ylabel(f"pair {contact}: camera")
        grid[row + 1, 0].set_ylabel("pressure")
    for axes in grid.ravel():
        axes.set(xticks=[], yticks=[])
    sheet.colorbar(drawn, ax=grid, label="pressure [MPa]", shrink=0.5)
    return sheet


def events(bundle: Bundle) -> Figure:
    """The camera where the mode changes, and what the contact does over the frames."""
    changes = [change for change in caption.changes(bundle) if change.mode != "apart"]
    sheet = Figure(figsize=(1.8 * len(changes), 3.8), layout="constrained")
    cameras, below = sheet.subfigures(2, 1, height_ratios=(1, 1.6))
    for axes, change in zip(cameras.subplots(1, len(changes)), changes, strict=True):
        axes.imshow(bundle.frame("/frames/rgb", change.frame))
        axes.set_title(f"frame {change.frame}:\n{change.mode}", fontsize=9)
        axes.set(xticks=[], yticks=[])
    axes = below.subplots()
    lines = {"sticks": bundle["/frames/events/stick_ratio"], "friction used": bundle["/frames/events/friction_used"]}
    for name, values in lines.items():
        axes.plot(values, "o-", label=name, color=COLOURS[name], markersize=4)
    starts = [change.frame for change in caption.changes(bundle)]
    for k, (start, end) in enumerate(zip(starts, [*starts[1:], bundle.frames], strict=True)):
        axes.axvspan(start - 0.5, end - 0.5, color="#e4e4e4" if k % 2 else "#f7f7f7", zorder=0)
    axes.set(xlabel="frame", ylabel="share [-]", xlim=(-0.5, bundle.frames - 0.5), xticks=np.arange(bundle.frames))
    axes.legend(fontsize=8, loc="center left")
    return sheet


if __name__ == "__main__":
    source, out = Path(sys.argv[1]), Path(sys.argv[2])
    pairs(dataset.scenes(source / "sensor_pairs")).savefig(out / "sensor_pairs.png", dpi=DPI)
    events(dataset.scenes(source / "contact_events")[0]).savefig(out / "contact_events.png", dpi=DPI)
