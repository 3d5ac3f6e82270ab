"""How often an error lies within the interval that `uncertainty: {mesh: true}` gives it, where 90 % are expected.

    python scripts/interval_coverage.py [--edge 0.25] [--sensors gelsight_mini digit]

Five shapes are pressed and slid on each sensor at `draft`. An error is the difference from the same scene on a mesh
with edges of --edge [mm]; the interval is 1.645 standard deviations on both sides. Of the maps only pixels with more
than a fifth of the largest pressure count.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tacgen import pipeline
from tacgen.bundle.bundle import Bundle, read
from tacgen.recipe import assets, plan
from tacgen.recipe.model import QUALITIES

SHAPES = (
    "{shape: sphere, radius_mm: 4}",
    "{shape: sphere, radius_mm: 7}",
    "{shape: capsule, radius_mm: 2.5, length_mm: 4}",
    "{shape: cylinder, radius_mm: 3, fillet_mm: 0.8}",
    "{shape: torus, radius_mm: 3, tube_radius_mm: 2}",
)
SHARE, NINETY = 0.2, 1.645


def scene(sensor: str, shape: str, folder: Path, *sets: str) -> Bundle:
    """The bundle of a shape pressed and slid."""
    moves = "trajectory=[{press: {depth_mm: 0.6, frames: 2}}, {slide: {x_mm: 0.6, y_mm: 0.2, frames: 1}}]"
    asked = (f"sensor={sensor}", f"indenter={shape}", moves, "contact.friction=0.5", "outputs=[force, traction]", *sets)
    return read(pipeline.run_scene(plan.load(assets.recipe_path("quickstart"), asked).rows[0], folder).path)


def inside(rough: Bundle, fine: Bundle) -> dict[str, np.ndarray]:
    """Whether each error is within its interval, by label."""
    pressure = fine["/frames/pressure"]
    pressed = pressure > SHARE * pressure.max()
    found = {}
    for name in ("force", "pressure", "traction"):
        error = np.abs(rough[f"/frames/{name}"] - fine[f"/frames/{name}"])
        within = error <= NINETY * rough[f"/frames/uncertainty/{name}"]
        found[name] = (within if name == "force" else within[pressed]).ravel()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--edge", type=float, default=0.25)
    parser.add_argument("--sensors", nargs="*", default=["gelsight_mini", "digit"])
    asked = parser.parse_args()
    quality = f"quality={{edge_mm: {asked.edge}, dhat_mm: {QUALITIES['draft'].dhat_mm}}}"
    every: dict[str, list[np.ndarray]] = {}
    for sensor in asked.sensors:
        for shape in SHAPES:
            with TemporaryDirectory() as name:
                rough = scene(sensor, shape, Path(name) / "rough", "quality=draft", "uncertainty={mesh: true}")
                found = inside(rough, scene(sensor, shape, Path(name) / "fine", quality))
            for label, within in found.items():
                every.setdefault(label, []).append(within)
            said = ", ".join(f"{label} {within.mean():.0%}" for label, within in found.items())
            print(f"{sensor}, {shape}: {said}", flush=True)
    said = ", ".join(f"{label} {np.concatenate(within).mean():.1%}" for label, within in every.items())
    print(f"all: {said}")


if __name__ == "__main__":
    main()
