"""A ball pressed into a GelSight Mini and slid: force, and a figure. python examples/first_press.py [FOLDER]"""

import sys
from pathlib import Path

import tacgen


def main(folder: Path, quality: object = "default") -> None:
    frames = tacgen.simulate(
        "gelsight_mini",
        tacgen.Sphere(radius_mm=4),
        [tacgen.Press(depth_mm=1, frames=5), tacgen.Slide(x_mm=1, frames=5)],
        friction=0.6,
        quality=quality,
    )
    print(frames.force.round(3))  # (10, 3) [N]
    print(f"largest pressure {frames.pressure.max():.3f} MPa")
    frames.plot().savefig(folder / "first_press.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
