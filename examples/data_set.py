"""A data set of presses at random places, written, read and drawn. python examples/data_set.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tacgen


def main(folder: Path, quality: object = "draft", samples: int = 12) -> None:
    recipe = {
        "tacgen": 1,
        "name": "places",
        "sensor": "digit",
        "indenter": tacgen.Sphere(radius_mm=3),
        "trajectory": [{"press": tacgen.Press(depth_mm=0.6, frames=2)}],
        "outputs": ["force", "height"],
        "quality": quality,
        "vary": {"samples": samples, "over": {"start.x_mm": {"uniform": [-5, 5]}, "start.y_mm": {"uniform": [-6, 6]}}},
    }
    tacgen.run(recipe, folder / "places", workers=2)
    scenes = tacgen.read_all(folder / "places")
    places = np.array([(each.recipe["start"]["x_mm"], each.recipe["start"]["y_mm"]) for each in scenes])
    figure, axes = plt.subplots(layout="constrained")
    drawn = axes.scatter(*places.T, c=[-each.force[-1, 2] for each in scenes], s=80)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    figure.colorbar(drawn, label="normal force [N]")
    figure.savefig(folder / "data_set.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
