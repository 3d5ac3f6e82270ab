"""Draw docs/grasp.png: what recipes/grasp.yaml gives, the fingers in section and both cameras.

python scripts/grasp_figure.py out/grasp docs/grasp.png, after `tacgen run grasp -o out/grasp`.
"""

import sys
from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tacgen.bundle.bundle import Bundle, read
from tacgen.geometry.pose import Pose
from tacgen.recipe.indenters import analytic
from tacgen.recipe.model import Recipe

COLOURS = {"L": "#0b6fa4", "R": "#c2571a"}
MODES = ("stands", "held", "falls")
REACH = 12.0  # of the section, from the gripper's middle [mm]


def section(bundle: Bundle, k: int) -> np.ndarray:
    """Points (n, 3) of the face now in the world [mm], down the middle of the image."""
    height, sensor = bundle.frame("/frames/height", k), bundle.sensor
    rows = (np.arange(height.shape[0]) + 0.5) * sensor.camera.height_px / height.shape[0]
    y = (rows - sensor.camera.height_px / 2) * sensor.camera.mm_per_px
    local = np.column_stack([np.zeros(len(y)), y, height[:, height.shape[1] // 2]])
    return Pose.of(bundle.frame("/frames/grasp/sensor", k)).world(local)


def draw(folder: Path, out: Path) -> None:
    bundles = {side: read(folder / f"scene-00000-{side}.h5") for side in "LR"}
    left = bundles["L"]
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
            column[0].plot(face[:, 0], face[:, 2], color=COLOURS[side], linewidth=1.5)
            force = -sensor[:3, :3] @ bundle.frame("/frames/force", k)
            at = [sensor[0, 3], pose[2, 3] + shape.support(np.array([0.0, 0.0, 1.0])) / 2]
            style = {"angles": "xy", "scale_units": "xy", "scale": 0.6, "color": COLOURS[side], "width": 0.02}
            column[0].quiver(*at, force[0], force[2], **style)
        title = f"frame {k}: {left.segments[k]}, {MODES[modes[k]]}"
        column[0].set(title=title, xlim=(-REACH, REACH), ylim=(-REACH, REACH + 4), aspect="equal", xlabel="x [mm]")
        for axes, side in zip(column[1:], "LR", strict=True):
            axes.imshow(bundles[side].frame("/frames/rgb", k))
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set(color=COLOURS[side], linewidth=2)
        for axes in column:
            axes.title.set_fontsize(8)
            axes.tick_params(labelsize=7)
    grid[0, 0].set_ylabel("z of the world [mm]")
    for axes, side in zip(grid[1:, 0], "LR", strict=True):
        axes.set_ylabel(f"{bundles[side].attrs['finger']}: {bundles[side].attrs['sensor']}")
    sheet.savefig(out, dpi=100)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
