"""A ball on gels of three thicknesses: thin ones are stiffer. python examples/gel_thickness.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tacgen


def main(folder: Path, quality: object = "draft") -> None:
    figure, axes = plt.subplots(1, 3, figsize=(9, 3), layout="constrained")
    for panel, thickness_mm in zip(axes, (1.5, 3, 6), strict=True):
        silicone = tacgen.NeoHookeLayer(
            name="silicone", thickness_mm=thickness_mm, youngs_modulus_mpa=0.2, poissons_ratio=0.48
        )
        gel = tacgen.Gel(width_mm=16, height_mm=16, layers=(silicone,))
        press = tacgen.Press(depth_mm=0.5, frames=2)
        frames = tacgen.simulate(gel, tacgen.Sphere(radius_mm=4), press, outputs=("force", "traction"), quality=quality)
        x, y = frames.x_mm, frames.y_mm
        drawn = panel.imshow(
            1000 * frames.pressure[-1], extent=(np.nanmin(x), np.nanmax(x), np.nanmax(y), np.nanmin(y))
        )
        panel.set(title=f"{thickness_mm} mm: {-frames.force[-1, 2]:.2f} N", xlabel="x [mm]")
        figure.colorbar(drawn, ax=panel, label="pressure [kPa]")
    figure.savefig(folder / "gel_thickness.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
