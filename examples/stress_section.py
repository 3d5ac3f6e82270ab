"""Von Mises stress in the gel under a ball, in the plane y = 0. python examples/stress_section.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tacgen


def main(folder: Path, quality: object = "draft") -> None:
    moves = [tacgen.Press(depth_mm=1, frames=2), tacgen.Slide(x_mm=1, frames=2)]
    frames = tacgen.simulate(
        "gelsight_mini", tacgen.Sphere(radius_mm=4), moves, friction=0.8, outputs=("stress",), quality=quality
    )
    points = frames["/mesh/points"]  # (n, 3) [mm], at rest
    near = np.abs(points[:, 1]) < np.abs(points[:, 1]).min() + 1e-6
    figure, axes = plt.subplots(2, 1, figsize=(7, 5), sharex=True, layout="constrained")
    for panel, k, title in zip(axes, (1, 3), ("pressed", "slid"), strict=True):
        x, _, z = (points + frames.displacement[k])[near].T
        drawn = panel.tricontourf(x, z, 1000 * tacgen.von_mises(frames.stress[k, near]), 12)
        panel.set(title=title, ylabel="z [mm]", xlim=(-6, 6), aspect="equal")
        figure.colorbar(drawn, ax=panel, label="von Mises stress [kPa]")
    axes[1].set_xlabel("x [mm]")
    figure.savefig(folder / "stress_section.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
