"""Force against depth of three balls. python examples/ball_sizes.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tacgen


def main(folder: Path, quality: object = "draft", steps: int = 6) -> None:
    figure, axes = plt.subplots(layout="constrained")
    depth_mm = np.linspace(0, 1.2, steps + 1)
    for radius_mm in (2, 4, 8):
        press = tacgen.Press(depth_mm=1.2, frames=steps)
        ball = tacgen.Sphere(radius_mm=radius_mm)
        frames = tacgen.simulate("gelsight_mini", ball, press, outputs="force", quality=quality)
        axes.plot(depth_mm, [0, *-frames.force[:, 2]], "o-", label=f"radius {radius_mm} mm")
    axes.set(xlabel="depth [mm]", ylabel="normal force [N]")
    axes.legend()
    figure.savefig(folder / "ball_sizes.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
