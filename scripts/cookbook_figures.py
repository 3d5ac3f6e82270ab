"""Draw a picture of the documentation that is named as its recipe; DRAWN has them.

python scripts/cookbook_figures.py NAME out/NAME docs/cookbook/NAME.png, after `tacgen run NAME -o out/NAME`.
"""

import sys
from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tacgen.bundle import caption, dataset, taxels
from tacgen.bundle.bundle import Bundle
from tacgen.geometry.pose import Pose
from tacgen.recipe.indenters import analytic
from tacgen.recipe.model import Recipe
from tacgen.report.bundle_figure import image_size, scale_of, window_of
from tacgen.report.frame_curves import FORCE_COLOURS

COLOURS = {"sticks": "#0b6fa4", "friction used": "#c2571a"}
HEIGHT, DPI = 1.6, 100  # of a panel [inches]; pixels an inch
NINETY = 1.645  # standard deviations on both sides of a 90 % interval
TAXELS, PITCH = (6, 8), 2.35  # rows and columns, and mm apart
FINGERS = {"left": "#0b6fa4", "right": "#c2571a"}
HELD = ("stands", "held", "falls")  # modes of a grasp
REACH = 12.0  # of the section of a grasp, from the gripper's middle [mm]
SHEAR = 5.0  # length of an arrow [mm] per N


def pairs(bundles: list[Bundle]) -> Figure:
    """A row for the camera and one for the pressure of each contact, a column for each sensor; the last frame."""
    contacts = sorted({int(bundle.attrs["pair"]) for bundle in bundles})
    sensors = list(dict.fromkeys(bundle.attrs["sensor"] for bundle in bundles))
    found = {(int(bundle.attrs["pair"]), bundle.attrs["sensor"]): bundle for bundle in bundles}
    largest = max(bundle["/frames/pressure"].max() for bundle in bundles)
    shapes = [image_size(found[contacts[0], sensor]) for sensor in sensors]
    wide = [width / height for height, width in shapes]
    sheet = Figure(figsize=(HEIGHT * sum(wide) + 1.8, 2 * len(contacts) * (HEIGHT + 0.15)), layout="constrained")
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
    sheet = Figure(figsize=(1.6 * len(changes), 4.4), layout="constrained")
    cameras, below = sheet.subfigures(2, 1, height_ratios=(1, 1.4))
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


def uncertainty(bundle: Bundle) -> Figure:
    """The force with its interval, what the inputs contribute to its deviation, and the deviation of the pressure."""
    sheet = Figure(figsize=(9.4, 3.0), layout="constrained")
    curve, parts, map_ = sheet.subplots(1, 3, width_ratios=(1.2, 0.8, 1.1))
    force, sure, last = bundle["/frames/force"], bundle["/frames/uncertainty/force"], bundle.frames - 1
    for k, (name, colour) in enumerate(FORCE_COLOURS.items()):
        curve.plot(force[:, k], "o-", color=colour, markersize=3, label=name)
        low, high = (force[:, k] + side * NINETY * sure[:, k] for side in (-1, 1))
        curve.fill_between(np.arange(bundle.frames), low, high, color=colour, alpha=0.25, linewidth=0)
    curve.set(xlabel="frame", ylabel="force on gel [N]", title="force and its 90 % interval")
    curve.legend(fontsize=8, frameon=False)
    asked = bundle.recipe["uncertainty"]
    inputs = asked["material"] | {"depth": asked["pose"]["depth_mm"]}
    share = [abs(bundle[f"/frames/sensitivity/{name}"][last, 2]) * value for name, value in inputs.items()]
    mesh = np.sqrt(sure[last, 2] ** 2 - np.square(share).sum())  # inputs are independent
    names = [name.replace("poissons_", "Poisson's ") for name in (*inputs, "mesh")]
    parts.barh(names, [*share, mesh], color=COLOURS["sticks"])
    parts.invert_yaxis()
    parts.set(xlabel="standard deviation of $F_z$ [N]", title=f"by input, frame {last}")
    label(bundle, sheet, map_, bundle.frame("/frames/uncertainty/pressure", last), "standard deviation [MPa]")
    map_.set_title(f"pressure, frame {last}")
    return sheet


def label(bundle: Bundle, sheet: Figure, axes: Axes, values: np.ndarray, name: str) -> None:
    """Draw a map (h, w) over the region touched in any frame, in mm, with a colour bar."""
    (height, width), (x0, x1, y0, y1), scale = image_size(bundle), window_of(bundle), scale_of(bundle)
    drawn = axes.imshow(values, extent=(0, width, height, 0))
    axes.set(xlim=(x0 * width, x1 * width), ylim=(y1 * height, y0 * height), xlabel="x [mm]", ylabel="y [mm]")
    axes.set_xticks(*scale.ticks(x0 * width, x1 * width, width, 0))
    axes.set_yticks(*scale.ticks(y0 * height, y1 * height, height, 1))
    sheet.colorbar(drawn, ax=axes, label=name, shrink=0.8)


def binned(bundle: Bundle) -> Figure:
    """The normal force on each taxel, and arrows of its shear force, at the end of each movement."""
    ends = [k for k, kind in enumerate(bundle.segments) if kind not in bundle.segments[k + 1 :]]
    layout = taxels.grid(*TAXELS, PITCH)
    found = [taxels.forces(bundle, k, layout) for k in ends]
    sheet = Figure(figsize=(4.2 * len(ends) + 0.8, 3.6), layout="constrained")
    panels = sheet.subplots(1, len(ends), sharey=True)
    top = max(-forces[:, 2].min() for forces in found)
    y, x = (PITCH * (np.arange(n + 1) - n / 2) for n in TAXELS)  # borders
    for axes, k, forces in zip(panels, ends, found, strict=True):
        drawn = axes.pcolormesh(x, y, -forces[:, 2].reshape(TAXELS), vmin=0, vmax=top, edgecolors="#808080", lw=0.5)
        felt = np.linalg.norm(forces[:, :2], axis=1) > 0.01
        style = {"angles": "xy", "scale_units": "xy", "scale": 1, "color": "#d55e00"}
        axes.quiver(*layout[felt].T, *(SHEAR * forces[felt, :2].T), **style)
        axes.set(title=f"frame {k}, {bundle.segments[k]}: {-forces[:, 2].sum():.2f} N", xlabel="x [mm]", aspect="equal")
        axes.set_ylim(y[-1], y[0])  # down, as in the image
    panels[0].set_ylabel("y [mm]")
    sheet.colorbar(drawn, ax=panels, label="normal force of a taxel [N]")
    return sheet


def section(bundle: Bundle, k: int) -> np.ndarray:
    """Points (n, 3) of the face now in the world [mm], down the middle of the image."""
    height, sensor = bundle.frame("/frames/height", k), bundle.sensor
    rows = (np.arange(height.shape[0]) + 0.5) * sensor.camera.height_px / height.shape[0]
    y = (rows - sensor.camera.height_px / 2) * sensor.camera.mm_per_px
    local = np.column_stack([np.zeros(len(y)), y, height[:, height.shape[1] // 2]])
    return Pose.of(bundle.frame("/frames/grasp/sensor", k)).world(local)


def grasp(found: list[Bundle]) -> Figure:
    """The fingers of a grasp in section, and both cameras, where the movement or the object's mode ends."""
    bundles = {str(bundle.attrs["finger"]): bundle for bundle in found}
    left = bundles["left"]
    shape = analytic(Recipe.model_validate(left.recipe).indenter)
    modes = left["/frames/grasp/mode"]
    ends = np.cumsum([len(list(group)) for _, group in groupby(zip(left.segments, modes, strict=True))]) - 1
    shown = [int(k) for k in ends][:5]
    sheet = Figure(figsize=(2.1 * len(shown), 6.4), layout="constrained")
    grid = sheet.subplots(3, len(shown))
    for column, k in zip(grid.T, shown, strict=True):
        x, z = np.meshgrid(np.linspace(-REACH, REACH, 200), np.linspace(-REACH, REACH + 6, 250))
        pose = left.frame("/frames/grasp/object", k)
        points = np.stack([x, np.full_like(x, pose[1, 3]), z], -1).reshape(-1, 3)
        gap = shape.distance(Pose.of(pose).local(points))[0].reshape(x.shape)
        column[0].contourf(x, z, gap, levels=[-1e3, 0], colors="#c9c9c9")
        for side, bundle in bundles.items():
            face, sensor = section(bundle, k), bundle.frame("/frames/grasp/sensor", k)
            column[0].plot(face[:, 0], face[:, 2], color=FINGERS[side], linewidth=1.5)
            force = -sensor[:3, :3] @ bundle.frame("/frames/force", k)
            at = [sensor[0, 3], pose[2, 3] + shape.support(np.array([0.0, 0.0, 1.0])) / 2]
            style = {"angles": "xy", "scale_units": "xy", "scale": 0.6, "color": FINGERS[side], "width": 0.02}
            column[0].quiver(*at, force[0], force[2], **style)
        title = f"frame {k}: {left.segments[k]}, {HELD[modes[k]]}"
        column[0].set(title=title, xlim=(-REACH, REACH), ylim=(-REACH, REACH + 4), aspect="equal", xlabel="x [mm]")
        for axes, side in zip(column[1:], FINGERS, strict=True):
            axes.imshow(bundles[side].frame("/frames/rgb", k))
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set(color=FINGERS[side], linewidth=2)
        for axes in column:
            axes.title.set_fontsize(8)
            axes.tick_params(labelsize=7)
    grid[0, 0].set_ylabel("z of the world [mm]")
    for axes, side in zip(grid[1:, 0], FINGERS, strict=True):
        axes.set_ylabel(f"{side}: {bundles[side].attrs['sensor']}")
    return sheet


DRAWN = {"sensor_pairs": pairs, "grasp": grasp, "contact_events": lambda found: events(found[0])}
DRAWN |= {"uncertainty": lambda found: uncertainty(found[0]), "taxels": lambda found: binned(found[0])}
if __name__ == "__main__":
    name, source, out = sys.argv[1:]
    DRAWN[name](dataset.scenes(Path(source))).savefig(out, dpi=DPI)
