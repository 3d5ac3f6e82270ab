"""Friction while a ball starts to slide, for three coefficients. python examples/stick_to_slip.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tacgen


def main(folder: Path, quality: object = "draft", steps: int = 8) -> None:
    figure, axes = plt.subplots(layout="constrained")
    moves = [tacgen.Press(depth_mm=0.8, frames=2), tacgen.Slide(x_mm=1.6, frames=steps)]
    for friction in (0.2, 0.5, 1.0):
        ball = tacgen.Sphere(radius_mm=4)
        frames = tacgen.simulate("gelsight_mini", ball, moves, friction=friction, outputs="force", quality=quality)
        ratio = -frames.force[:, 0] / frames.force[:, 2]
        axes.plot(np.linspace(0, 1.6, steps + 1), ratio[1:], "o-", label=f"friction coefficient {friction}")
        axes.axhline(friction, color="grey", linewidth=0.5)
    axes.set(xlabel="slide [mm]", ylabel="tangential over normal force [-]")
    axes.legend()
    figure.savefig(folder / "stick_to_slip.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
