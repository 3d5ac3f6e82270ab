"""Random draws of photographs: does `tacgen calibrate optics` harm the presses that it was not given?

    python scripts/calibration_draws.py [3] [--first 0] [--unit gelsight_mini_unit2] [--given 5] [--photos DIR]

Each draw gives some presses of a real unit to the fit, which starts from the shipped file and judges itself by them
alone, and compares file and fit on the other presses. Exit code 1: a fit that would be written is worse there.
"""

import argparse
import csv
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]
from calibrate_optics import lay_out  # noqa: E402

from benchmarks import photographs  # noqa: E402
from tacgen.calibrate import contact_circle, led_fit, press_faces  # noqa: E402
from tacgen.calibrate.likeness import Comparison  # noqa: E402
from tacgen.calibrate.photos import PhotographedPress  # noqa: E402
from tacgen.recipe import background_photo, loading  # noqa: E402

SENSOR = {"gelsight_mini": "gelsight_mini", "gelsight_mini_unit2": "gelsight_mini", "digit": "digit"}


def unit_of(name: str, folder: Path) -> photographs.Unit | None:
    """The photographs of a unit; None where there are none. Circles of the second Mini unit are refined."""
    if name != "gelsight_mini_unit2":
        return photographs.unit(name, folder)
    folder = folder / name
    if not (folder / "presses.csv").is_file():
        return None
    untouched, presses = background_photo.read(folder / "background.png"), []
    with (folder / "presses.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            center = (float(row["centre_x_px"]), float(row["centre_y_px"]))
            picture, ball = background_photo.read(folder / row["image"]), float(row["ball_diameter_mm"]) / 2
            press = PhotographedPress(row["image"], picture, ball, center, float(row["contact_radius_px"]), None)
            presses.append(contact_circle.refined(press, untouched))
    return photographs.Unit(folder, untouched, tuple(presses))


def normals(file: Path, unit: photographs.Unit) -> float:
    """Error of the normals in a unit's photographs [deg], by a network trained on pictures of a sensor file."""
    sensor, _ = loading.read_sensor(file)
    faces = [press_faces.face(sensor, press, {}) for press in unit.presses]
    return Comparison(sensor).likeness(unit.presses, faces, unit.untouched).normals


def draw(unit: photographs.Unit, sensor: str, given: int, seed: int, steps: int) -> bool:
    """Fit to some presses; whether a fit that would be written is worse on the others."""
    order = np.random.default_rng(seed).permutation(len(unit.presses))
    some, others = (replace(unit, presses=tuple(unit.presses[k] for k in sorted(part)))
                    for part in (order[:given], order[given:]))  # fmt: skip
    with tempfile.TemporaryDirectory() as scratch:
        lay_out(some, "background.png", Path(scratch) / "photos", [])
        found = led_fit.optics(sensor, Path(scratch) / "photos", led_fit.FitLimits(bare=True, steps=steps))
        out = Path(scratch) / "fitted.yaml"
        found.write(out)
        before, after = normals(found.path, others), normals(out, others)
    written = not found.problem()
    print(f"draw {seed}: given {', '.join(press.name for press in some.presses)}")
    print(f"  by itself: {found.fitted.unseen}, ridge {found.fitted.ridge:g}: {'written' if written else 'refused'}")
    print(f"  on the {len(others.presses)} others: {before:.1f} deg before, {after:.1f} deg after", flush=True)
    return written and after > before


def main() -> None:
    """Draw, fit and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("draws", type=int, nargs="?", default=3)
    parser.add_argument("--first", type=int, default=0, help="seed of the first draw")
    parser.add_argument("--unit", choices=SENSOR, default="gelsight_mini_unit2")
    parser.add_argument("--given", type=int, default=5, help="presses that a fit is given")
    parser.add_argument("--steps", type=int, default=4, help="iterations of a fit at most")
    parser.add_argument(
        "--photos", type=Path, default=photographs.reference(), help="a folder, a unit in each folder of it"
    )
    asked = parser.parse_args()
    unit = unit_of(asked.unit, asked.photos)
    if unit is None:
        sys.exit(f"no photographs of {asked.unit} in {asked.photos}")
    seeds = range(asked.first, asked.first + asked.draws)
    harmed = [draw(unit, SENSOR[asked.unit], asked.given, seed, asked.steps) for seed in seeds]
    print(f"{asked.unit}: {sum(harmed)} of {len(harmed)} fits would be written and are worse on the other presses")
    sys.exit(int(any(harmed)))


if __name__ == "__main__":
    main()
