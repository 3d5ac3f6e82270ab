"""Force of a viscoelastic gel that is pressed within 0.1 s and held. python examples/relaxation.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import tacgen


def main(folder: Path, quality: object = "draft", frames_held: int = 8) -> None:
    layer = tacgen.NeoHookeLayer(
        name="gel",
        thickness_mm=4,
        youngs_modulus_mpa=0.15,
        poissons_ratio=0.48,
        prony=(tacgen.PronyTerm(g=0.3, tau_s=0.2), tacgen.PronyTerm(g=0.1, tau_s=2.0)),
    )
    frames = tacgen.simulate(
        tacgen.Gel(width_mm=14, height_mm=14, layers=(layer,)),
        tacgen.Sphere(radius_mm=4),
        [tacgen.Press(depth_mm=0.6, frames=2, duration_s=0.1), tacgen.Hold(frames=frames_held, duration_s=1.0)],
        dynamics=tacgen.Dynamics(density_kg_m3=1050),
        outputs="force",
        quality=quality,
    )
    figure, axes = plt.subplots(layout="constrained")
    axes.plot([0, *frames["time"]], [0, *-frames.force[:, 2]], "o-")
    axes.set(xlabel="time [s]", ylabel="normal force [N]")
    figure.savefig(folder / "relaxation.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
