"""An object made with trimesh, pressed into a DIGIT: pressure and height. python examples/trimesh_object.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import trimesh

import tacgen


def main(folder: Path, quality: object = "draft") -> None:
    ring = trimesh.creation.torus(major_radius=3, minor_radius=1)  # [mm], lying flat
    press = tacgen.Press(depth_mm=0.5, frames=2)
    frames = tacgen.simulate("digit", ring, press, outputs=("traction", "height"), quality=quality)
    x, y = frames.x_mm, frames.y_mm
    extent = np.nanmin(x), np.nanmax(x), np.nanmax(y), np.nanmin(y)
    figure, axes = plt.subplots(1, 2, figsize=(7, 4), layout="constrained")
    for panel, values, label in zip(
        axes, (frames.pressure[-1], frames.height[-1]), ("pressure [MPa]", "height [mm]"), strict=True
    ):
        figure.colorbar(panel.imshow(values, extent=extent), ax=panel, label=label)
        panel.set(xlabel="x [mm]", ylabel="y [mm]")
    figure.savefig(folder / "trimesh_object.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
