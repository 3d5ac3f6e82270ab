"""A ball that rolls over the gel, given as poses. python examples/poses.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tacgen

RADIUS, DEPTH = 4.0, 0.6  # [mm]


def main(folder: Path, quality: object = "draft", steps: int = 8) -> None:
    x = np.linspace(-3, 3, steps)  # of the ball's centre [mm]
    turn = x / RADIUS  # rolling without slip, about y
    poses = np.tile(np.eye(4), (steps, 1, 1))
    poses[:, 0, 0], poses[:, 0, 2] = np.cos(turn), np.sin(turn)
    poses[:, 2, 0], poses[:, 2, 2] = -np.sin(turn), np.cos(turn)
    centre = np.stack([x, 0 * x, np.full(steps, RADIUS - DEPTH)], axis=1)
    poses[:, :3, 3] = centre - RADIUS * poses[:, :3, 2]  # the indenter's origin is its lowest point at rest
    ball = tacgen.Sphere(radius_mm=RADIUS)
    frames = tacgen.simulate("gelsight_mini", ball, poses, friction=0.6, outputs=("force", "events"), quality=quality)
    figure, axes = plt.subplots(layout="constrained")
    axes.plot(x, frames["events/center_of_pressure"][:, 0], "o-", label="centre of pressure")
    axes.plot(x, x, color="grey", linewidth=0.5, label="centre of the ball")
    axes.set(xlabel="x of the ball [mm]", ylabel="x [mm]")
    axes.legend()
    figure.savefig(folder / "poses.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
