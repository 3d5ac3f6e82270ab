"""Force with its expected error, by mesh and by material. python examples/expected_error.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tacgen

CASES = {
    "mesh": True,
    "modulus known to 10 %": tacgen.Uncertainty(material=tacgen.MaterialDeviation(modulus=0.1)),
    "depth known to 0.02 mm": tacgen.Uncertainty(pose=tacgen.PoseDeviation(depth_mm=0.02)),
}


def main(folder: Path, quality: object = "draft", steps: int = 4) -> None:
    figure, axes = plt.subplots(layout="constrained")
    for place, (name, uncertainty) in enumerate(CASES.items()):
        frames = tacgen.simulate(
            "gelsight_mini",
            tacgen.Sphere(radius_mm=4),
            tacgen.Press(depth_mm=0.8, frames=steps),
            outputs="force",
            uncertainty=uncertainty,
            quality=quality,
        )
        depth_mm = np.linspace(0, 0.8, steps + 1)[1:] + 0.01 * place
        axes.errorbar(depth_mm, -frames.force[:, 2], frames.force_std[:, 2], fmt="o", capsize=3, label=name)
    axes.set(xlabel="depth [mm]", ylabel="normal force and its standard deviation [N]")
    axes.legend()
    figure.savefig(folder / "expected_error.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
