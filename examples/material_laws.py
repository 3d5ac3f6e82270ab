"""Three material laws of the same shear modulus, pressed with a punch. python examples/material_laws.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tacgen

SHEAR_MPA = 0.07
PAD = {"name": "pad", "thickness_mm": 4, "poissons_ratio": 0.48}
LAWS = {
    "neo-Hookean": tacgen.NeoHookeLayer(youngs_modulus_mpa=2 * 1.48 * SHEAR_MPA, **PAD),
    "Mooney-Rivlin": tacgen.MooneyRivlinLayer(c10_mpa=0.3 * SHEAR_MPA, c01_mpa=0.2 * SHEAR_MPA, **PAD),
    "Yeoh": tacgen.YeohLayer(c10_mpa=SHEAR_MPA / 2, c20_mpa=0.02, c30_mpa=0.01, **PAD),
}


def main(folder: Path, quality: object = "draft", steps: int = 5) -> None:
    figure, axes = plt.subplots(layout="constrained")
    for name, layer in LAWS.items():
        gel = tacgen.Gel(width_mm=14, height_mm=14, layers=(layer,))
        punch = tacgen.Cylinder(radius_mm=3, fillet_mm=0.5)
        press = tacgen.Press(depth_mm=1.2, frames=steps)
        frames = tacgen.simulate(gel, punch, press, outputs="force", quality=quality)
        axes.plot(np.linspace(0, 1.2, steps + 1), [0, *-frames.force[:, 2]], "o-", label=name)
    axes.set(xlabel="depth [mm]", ylabel="normal force [N]")
    axes.legend()
    figure.savefig(folder / "material_laws.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
