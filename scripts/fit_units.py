"""Fit the Mini's sensor file to photographs of each other unit, for the population of recipes/many_units.yaml.

    python scripts/fit_units.py [--tolerance-mm 1] [--out recipes/units]

Each fit starts from the shipped file, which is of the first unit, and is held to it by a ridge. A unit's lights, stray
light, vignette, crop and gloss are written to a sensor file without dots; ratios to the shipped light are printed.
"""

import argparse
import sys
from pathlib import Path
from typing import cast

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks import photographs  # noqa: E402
from tacgen.calibrate import cross_validation, optics, solved_presses  # noqa: E402
from tacgen.calibrate.photometric_fit import TOLERANCE_RIDGES, PhotometricFits  # noqa: E402
from tacgen.calibrate.photometric_model import FitLimits  # noqa: E402
from tacgen.calibrate.photos import Photos  # noqa: E402
from tacgen.calibrate.sensor_fit import write_sensor  # noqa: E402
from tacgen.recipe import assets, loading  # noqa: E402
from tacgen.sensor.model import LitSensor  # noqa: E402

SHIPPED = "gelsight_mini"
UNITS = {  # name of the file, and where the photographs come from
    "gelsight_mini_unit2": ("gelsight_mini_second", "skleff1994/gs_sdk"),
    "gelsight_mini_dotted": ("gelsight_mini_third", "yepengfei81-cpu/gelsight_gripper_controller"),
}
RIDGE = TOLERANCE_RIDGES[1]  # the shipped file's own fit chose it by presses that it had not seen
ROTATED, STEPS = 5.0, 8  # largest rotation of an LED [deg]; Jacobians at most


def fit(sensor: LitSensor, unit: photographs.Unit, tolerance: float) -> cross_validation.Fitted:
    """Fit to all presses of a unit; pixels that a dot hides are not compared."""
    photos = Photos(unit.folder, unit.untouched, unit.presses)
    faces = [solved_presses.face(sensor, press, {}) for press in unit.presses]
    trial = PhotometricFits(sensor, photos, faces, FitLimits(tolerance, ROTATED, bare=True, steps=STEPS))
    eye = trial.sensor.camera
    for picture, hidden in zip(trial.pictures, (np.any(unit.hidden, axis=0), *unit.hidden), strict=True):
        cells = hidden.reshape(eye.height_px, hidden.shape[0] // eye.height_px, eye.width_px, -1)
        picture.counts[:] &= ~cells.any(axis=(1, 3)).ravel()
    return trial.whole(RIDGE)


def main() -> None:
    """Fit and write each unit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "recipes" / "units")
    parser.add_argument("--tolerance-mm", type=float, default=1.0)
    asked = parser.parse_args()
    path = assets.sensor_path(SHIPPED)
    sensor = cast(LitSensor, loading.read_sensor(path)[0])
    asked.out.mkdir(parents=True, exist_ok=True)
    for folder, (name, origin) in UNITS.items():
        if (unit := photographs.unit(folder)) is None:
            sys.exit(f"no photographs in {photographs.reference() / folder}")
        found = fit(sensor, unit, asked.tolerance_mm)
        said = f"an untouched picture and {len(unit.presses)} presses of another unit ({origin})"
        changes = optics.changes_of(sensor, found, said, bare=True)
        told = {key: text.replace(optics.OPTICS_SOURCE, "by scripts/fit_units.py") for key, text in changes.items()
                if key[-1] == "source"}  # fmt: skip
        told["name",] = name
        told["description",] = f"GelSight Mini, lights fitted to photographs of a {name[14:]} unit, no markers"
        write_sensor(path, sensor, changes | told, asked.out / f"{name}.yaml")
        print(f"{name}: off by {found.untouched:.1f} counts rms untouched, {found.presses:.1f} under presses")
        for led, now in zip(sensor.leds, found.sensor.leds, strict=True):
            moved = np.subtract(now.center_mm, led.center_mm).round(2).tolist()
            print(f"  {led.name}: {sum(now.light) / sum(led.light):.2f} times, moved {moved}")


if __name__ == "__main__":
    main()
