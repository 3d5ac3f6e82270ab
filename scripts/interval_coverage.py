"""How often an error lies within the interval that `uncertainty: {mesh: true}` gives it, where 90 % are expected.

    python scripts/interval_coverage.py [--edge 0.25] [--sensors gelsight_mini digit] [--draws 8 9 14]

Five shapes are pressed and slid on each sensor at `draft`; with --draws, ordinary scenes of these numbers
(benchmarks/draws.py) instead. An error is the difference from the same scene on a mesh with edges of --edge [mm]; the
interval is 1.645 standard deviations on both sides. Of the maps only pixels with more than a fifth of the largest
pressure count. The last line is the mean of the scenes. A scene takes half a minute to six minutes.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.draws import drawn
from benchmarks.reference_runs import row_of
from tacgen import pipeline
from tacgen.bundle.bundle import Bundle, read
from tacgen.recipe.model import QUALITIES

SHAPES = (
    "{shape: sphere, radius_mm: 4}",
    "{shape: sphere, radius_mm: 7}",
    "{shape: capsule, radius_mm: 2.5, length_mm: 4}",
    "{shape: cylinder, radius_mm: 3, fillet_mm: 0.8}",
    "{shape: torus, radius_mm: 3, tube_radius_mm: 2}",
)
SHARE, NINETY = 0.2, 1.645
MOVES = "trajectory=[{press: {depth_mm: 0.6, frames: 2}}, {slide: {x_mm: 0.6, y_mm: 0.2, frames: 1}}]"


def scenes(sensors: list[str], draws: list[int]) -> dict[str, tuple[str, ...]]:
    """Settings of each scene by its name."""
    if draws:
        some = {number: drawn(number) for number in draws}
        return {f"draw {number}, {one.sensor}": (f"sensor={one.sensor}", *one.sets) for number, one in some.items()}
    both = [(sensor, shape) for sensor in sensors for shape in SHAPES]
    return {f"{a}, {b}": (f"sensor={a}", f"indenter={b}", MOVES, "contact.friction=0.5") for a, b in both}


def bundle(folder: Path, *sets: str) -> Bundle:
    """That of one scene, made in the folder."""
    return read(pipeline.run_scene(row_of(("outputs=[force, traction]", *sets)), folder).path)


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
    parser.add_argument("--draws", type=int, nargs="*", default=[])
    asked = parser.parse_args()
    quality = f"quality={{edge_mm: {asked.edge}, dhat_mm: {QUALITIES['draft'].dhat_mm}}}"
    every: dict[str, list[float]] = {}
    for name, sets in scenes(asked.sensors, asked.draws).items():
        with TemporaryDirectory() as folder:
            rough = bundle(Path(folder) / "rough", *sets, "quality=draft", "uncertainty={mesh: true}")
            fine = bundle(Path(folder) / "fine", *sets, quality)
            if rejected := [one.attrs["reason"] for one in (rough, fine) if one.attrs["status"] != "ok"]:
                print(f"{name}: left out, {rejected[0]}", flush=True)
                continue
            found = {label: float(within.mean()) for label, within in inside(rough, fine).items()}
        for label, share in found.items():
            every.setdefault(label, []).append(share)
        print(f"{name}: {', '.join(f'{label} {share:.0%}' for label, share in found.items())}", flush=True)
    print(f"mean: {', '.join(f'{label} {np.mean(shares):.1%}' for label, shares in every.items())}")


if __name__ == "__main__":
    main()
