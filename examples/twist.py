"""Torque of a box that is twisted: it sticks, then turns on the gel. python examples/twist.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tacgen


def main(folder: Path, quality: object = "draft", steps: int = 8) -> None:
    box = tacgen.Box(size_x_mm=6, size_y_mm=4, fillet_mm=0.6)
    moves = [tacgen.Press(force_n=3, frames=2), tacgen.Twist(angle_deg=24, frames=steps)]
    frames = tacgen.simulate("gelsight_mini", box, moves, friction=0.4, outputs=("traction",), quality=quality)
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.5), layout="constrained")
    left.plot(np.linspace(0, 24, steps + 1), frames.torque[1:, 2], "o-")
    left.set(xlabel="angle [deg]", ylabel="torque about z [N mm]")
    sliding = np.where(frames.contact[-1], frames.slip[-1], np.nan)
    x, y = frames.x_mm, frames.y_mm
    right.imshow(sliding, vmin=0, vmax=1, extent=(np.nanmin(x), np.nanmax(x), np.nanmax(y), np.nanmin(y)))
    right.set(title="where it slides at the end", xlabel="x [mm]", ylabel="y [mm]")
    figure.savefig(folder / "twist.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
