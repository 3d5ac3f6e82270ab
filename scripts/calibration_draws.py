"""Random draws of photographs: does `tacgen calibrate optics` harm the presses that it was not given?

    python scripts/calibration_draws.py [3] [--first 0] [--unit gelsight_mini_unit2] [--given 5] [--wrong powers]

Each draw gives some presses of a real unit to the fit, which starts from the shipped file and judges itself by them
alone, and compares file and fit on the other presses. `--wrong` starts from wrong lights instead: `powers` times .72,
1.35 and .75 and LEDs .5 mm higher or lower, `double` the radiance, or each LED's radiance `swapped` for the next one's.
The last line sums up; refused fits count with the file that they started from. Exit code 1: a fit that would be written
is worse.
"""

import argparse
import csv
import math
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]
from calibrate_optics import lay_out  # noqa: E402

from benchmarks import photographs  # noqa: E402
from tacgen.calibrate import contact_circle, led_fit, press_faces  # noqa: E402
from tacgen.calibrate.likeness import Comparison  # noqa: E402
from tacgen.calibrate.photos import PhotographedPress  # noqa: E402
from tacgen.calibrate.result import write_sensor  # noqa: E402
from tacgen.recipe import assets, background_photo, loading  # noqa: E402
from tacgen.sensor.yaml_source import KeyPath  # noqa: E402

SENSOR = {"gelsight_mini": "gelsight_mini", "gelsight_mini_unit2": "gelsight_mini", "digit": "digit"}
MOST_SEEDS = 20  # that are tried for each draw
WRONG = "powers", "double", "swapped"
POWERS, HIGHER = (0.72, 1.35, 0.75), 0.5  # factors on the LEDs' radiances, and their shift in height, up and down [mm]


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


@dataclass(frozen=True)
class Drawn:
    """One fit, and the error of normals on presses that it was not given [deg]."""

    written: bool
    before: float
    after: float  # of the file that the user ends with: the start where the fit is refused
    shipped: float  # of the shipped file

    @property
    def worse(self) -> bool:
        """Whether the fit was written and harms."""
        return self.written and self.after > self.before


def start(name: str, wrong: str, into: Path) -> Path:
    """The shipped sensor file, or one with wrong lights in `into`."""
    path = assets.sensor_path(name)
    if not wrong:
        return path
    sensor, _ = loading.read_sensor(path)
    leds = sensor.leds or ()
    lights, changes = [led.light for led in leds], dict[KeyPath, Any]()
    if wrong == "powers":
        lights = [tuple(v * POWERS[k % 3] for v in light) for k, light in enumerate(lights)]
        for k, led in enumerate(leds):
            x, y, z = led.center_mm
            changes["leds", k, "center_mm"] = [x, y, z + HIGHER * (-1) ** k]
    elif wrong == "double":
        lights = [tuple(2 * v for v in light) for light in lights]
    else:  # every LED has the light of the next
        lights = [*lights[1:], lights[0]]
    for k, light in enumerate(lights):
        changes["leds", k, "radiance"], changes["leds", k, "power"] = list(light), None
    write_sensor(path, sensor, changes, into / f"{name}.yaml")
    return into / f"{name}.yaml"


def draws(presses: int, given: int, first: int, count: int) -> Iterator[tuple[int, list[int]]]:
    """Seeds from `first` on, and the presses that each gives to the fit; a choice that came before is left out.

    Of six presses, five can be given in six ways only.
    """
    seen: set[tuple[int, ...]] = set()
    for seed in range(first + min(count, math.comb(presses, given)) * MOST_SEEDS):
        some = tuple(sorted(np.random.default_rng(seed).permutation(presses)[:given].tolist()))
        if some not in seen and seed >= first and count:
            yield seed, list(some)
            count -= 1
        seen.add(some)


def draw(unit: photographs.Unit, asked: argparse.Namespace, seed: int, given: list[int]) -> Drawn:
    """Fit to some presses, and compare the start and the fit on the others."""
    name = SENSOR[asked.unit]
    some, others = (replace(unit, presses=tuple(p for k, p in enumerate(unit.presses) if (k in given) == chosen))
                    for chosen in (True, False))  # fmt: skip
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        lay_out(some, "background.png", folder / "photos", [])
        begun, begin = time.process_time(), start(name, asked.wrong, folder)
        found = led_fit.optics(str(begin), folder / "photos", led_fit.FitLimits(bare=True, steps=asked.steps))
        took, out = time.process_time() - begun, folder / "fitted.yaml"
        found.write(out)
        before, after = normals(begin, others), normals(out, others)
        shipped = normals(assets.sensor_path(name), others) if asked.wrong else before
    written = not found.problem()
    print(f"draw {seed}: given {', '.join(press.name for press in some.presses)}")
    print(f"  by itself: {found.fitted.unseen}, ridge {found.fitted.ridge:g}: {'written' if written else 'refused'}")
    print(f"  on the {len(others.presses)} others: {before:.1f} deg before, {after:.1f} deg after; {took:.0f} s")
    sys.stdout.flush()
    return Drawn(written, before, after if written else before, shipped)


def main() -> None:
    """Draw, fit and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("draws", type=int, nargs="?", default=3)
    parser.add_argument("--first", type=int, default=0, help="seed of the first draw")
    parser.add_argument("--unit", choices=SENSOR, default="gelsight_mini_unit2")
    parser.add_argument("--given", type=int, default=5, help="presses that a fit is given")
    parser.add_argument("--steps", type=int, default=1, help="tables of derivatives at most, for each ridge")
    parser.add_argument("--wrong", choices=WRONG, default="", help="start from wrong lights")
    parser.add_argument(
        "--photos", type=Path, default=photographs.reference(), help="a folder, a unit in each folder of it"
    )
    asked = parser.parse_args()
    unit = unit_of(asked.unit, asked.photos)
    if unit is None:
        sys.exit(f"no photographs of {asked.unit} in {asked.photos}")
    chosen = draws(len(unit.presses), asked.given, asked.first, asked.draws)
    every = [draw(unit, asked, seed, given) for seed, given in chosen]
    written, worse = sum(one.written for one in every), sum(one.worse for one in every)
    before, after, shipped = (float(np.mean([getattr(one, k) for one in every]))
                              for k in ("before", "after", "shipped"))  # fmt: skip
    beside = f" (the shipped file: {shipped:.1f})" if asked.wrong else ""
    print(f"{asked.unit}{f' from wrong lights ({asked.wrong})' if asked.wrong else ''}: {len(every)} draws, {written}"
          f" written, {len(every) - written} refused, {worse} worse on the other presses; mean error of normals there"
          f" {before:.2f} deg before, {after:.2f} after{beside}")  # fmt: skip
    sys.exit(int(worse > 0))


if __name__ == "__main__":
    main()
