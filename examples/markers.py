"""Motion of the markers of a GelSight Mini that is sheared and twisted. python examples/markers.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import tacgen


def main(folder: Path, quality: object = "draft") -> None:
    moves = [
        tacgen.Press(depth_mm=0.8, frames=1),
        tacgen.Slide(x_mm=0.6, y_mm=0.3, frames=1),
        tacgen.Twist(angle_deg=15, frames=1),
    ]
    frames = tacgen.simulate(
        "gelsight_mini", tacgen.Sphere(radius_mm=5), moves, friction=0.9, outputs=("markers",), quality=quality
    )
    rest = frames["/reference/markers"]  # (M, 2) [px]
    figure, axes = plt.subplots(1, 3, figsize=(10, 3), layout="constrained")
    for panel, move, flow in zip(axes, frames.segments, frames.marker_flow, strict=True):
        panel.quiver(*rest.T, *flow.T, angles="xy", scale_units="xy", scale=0.3)
        panel.set(title=move, aspect="equal", xlabel="x [px]")
        panel.invert_yaxis()
    figure.savefig(folder / "markers.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
