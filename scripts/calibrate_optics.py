"""Fit a shipped sensor file to the reference photographs of a real unit, as `tacgen calibrate optics` does.

python scripts/calibrate_optics.py gelsight_mini [../shared/reference] [-o mine.yaml]
"""

import argparse
import sys
from pathlib import Path

from tacgen.calibrate import optics
from tacgen.calibrate.photometric_model import FitLimits
from tacgen.calibrate.photos import Photos
from tacgen.recipe import assets

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks import photographs  # noqa: E402


def main() -> None:
    """Fit, and say how well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sensor", choices=photographs.SENSORS)
    parser.add_argument("photos", type=Path, nargs="?", help="a folder a sensor in it")
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--start", help="the sensor file to start from; the shipped one if not given")
    for name, usual in (("--tolerance-mm", 0.5), ("--tolerance-deg", 5.0), ("--steps", 1)):
        parser.add_argument(name, type=type(usual), default=usual)
    asked = parser.parse_args()
    unit = photographs.unit(asked.sensor, asked.photos)
    if unit is None:
        sys.exit(f"no photographs in {asked.photos or photographs.reference()}")
    path, photos = assets.sensor_path(asked.start or asked.sensor), Photos(unit.folder, unit.untouched, unit.presses)
    limits = FitLimits(asked.tolerance_mm, asked.tolerance_deg, bare=True, steps=asked.steps)
    found = optics.calibrated(path, photos, limits)
    print("\n".join(found.lines()))
    if asked.out:
        found.write(asked.out)


if __name__ == "__main__":
    main()
