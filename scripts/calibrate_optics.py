"""Fit a shipped sensor file to the reference photographs of a real unit, by `tacgen calibrate optics`.

    python scripts/calibrate_optics.py gelsight_mini [../shared/reference] [-o mine.yaml]

It only arranges the photographs as that command needs them: background.png and presses.csv.
"""

import argparse
import csv
import sys
import tempfile
from pathlib import Path

from tacgen.calibrate import optics, photometric_model

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks import photographs  # noqa: E402


def lay_out(unit: photographs.Unit, untouched: str, into: Path) -> None:
    """background.png and presses.csv in a folder of links to photographs."""
    into.mkdir()
    (into / "background.png").symlink_to((unit.folder / untouched).resolve())
    with (into / "presses.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["file", "ball_radius_mm", "x_px", "y_px", "contact_radius_px", "depth_mm"])
        for press in unit.presses:
            (into / press.name).symlink_to((unit.folder / press.name).resolve())
            table.writerow([press.name, press.ball, *press.center, press.contact, press.depth])


def main() -> None:
    """Fit, and say how well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sensor", choices=photographs.SENSORS)
    parser.add_argument("photos", type=Path, nargs="?", help="a folder a sensor in it")
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--start", help="the sensor file to start from; the shipped one if not given")
    parser.add_argument("--tolerance-mm", type=float, default=0.5)
    parser.add_argument("--tolerance-deg", type=float, default=5.0)
    parser.add_argument("--steps", type=int, default=1)
    asked = parser.parse_args()
    unit = photographs.unit(asked.sensor, asked.photos)
    if unit is None:
        sys.exit(f"no photographs in {asked.photos or photographs.reference()}")
    how = photometric_model.FitLimits(asked.tolerance_mm, asked.tolerance_deg, bare=True, steps=asked.steps)
    with tempfile.TemporaryDirectory() as scratch:
        into = Path(scratch) / "reference"
        lay_out(unit, photographs.UNTOUCHED[asked.sensor], into)
        found = optics.optics(asked.start or asked.sensor, into, how)
        print("\n".join(found.lines()))
        if asked.out:
            found.write(asked.out)


if __name__ == "__main__":
    main()
