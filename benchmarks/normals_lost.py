"""Where the error of normals in photographs comes from: parts of photographed presses are replaced by rendered ones.

    python -m benchmarks.normals_lost [digit|gelsight_mini] [--file mine.yaml]

Each line is the error [deg] of the network of `bench real` for each press, and the mean. In the last lines the misfit,
photographed less rendered change of colour, is fitted by a polynomial in the slopes and taken off: light from wrong
directions leaves such a misfit, marks on the coating and noise do not.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from benchmarks import photographs
from tacgen.calibrate import press_faces
from tacgen.calibrate.likeness import Comparison, PictureOfPress, near
from tacgen.recipe import assets, loading
from tacgen.sensor.model import LitSensor

Array = np.ndarray
CORE = 0.7  # contact radii: the middle, half of the contact's area


def swapped(real: PictureOfPress, made: PictureOfPress, where: Array) -> PictureOfPress:
    """A photographed press with the rendered change of colour `where`, bool that broadcasts to (H, W, 3)."""
    return replace(real, change=np.where(where, made.change, real.change))


def smooth_misfit(real: PictureOfPress, made: PictureOfPress, order: int) -> Array:
    """Polynomial in the slopes that fits photographed less rendered change inside the contact, (n, 3) [counts]."""
    x, y = (real.slopes - real.flat).T
    table = np.column_stack([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)])
    off = (real.change - made.change)[real.where]
    return np.asarray(table @ np.linalg.lstsq(table, off, rcond=None)[0])


def without(real: PictureOfPress, made: PictureOfPress, order: int) -> PictureOfPress:
    """A photographed press without that polynomial."""
    change = real.change.copy()
    change[real.where] -= smooth_misfit(real, made, order)
    return replace(real, change=change)


def lines(sensor: LitSensor, unit: photographs.Unit) -> Sequence[tuple[str, Array]]:
    """What is replaced, and the errors (presses,) [deg]."""
    compared, random = Comparison(sensor), np.random.default_rng(0)
    faces = [press_faces.face(sensor, press, {}) for press in unit.presses]
    real = [compared.photographed(p, f, unit.untouched) for p, f in zip(unit.presses, faces, strict=True)]
    made = [compared.rendered(p, f) for p, f in zip(unit.presses, faces, strict=True)]
    noisy = [compared.rendered(p, f, random) for p, f in zip(unit.presses, faces, strict=True)]
    net = compared.net(unit.presses)
    core = [near(press, CORE)[..., None] for press in unit.presses]
    number = range(len(real))

    def off(change: Callable[[int], PictureOfPress]) -> Array:
        return np.array([one.off(net.normals(one.features)) for one in map(change, number)])

    out = [("photographed", off(lambda k: real[k])), ("rendered with noise", off(lambda k: noisy[k]))]
    out += [("rendered without noise", off(lambda k: made[k]))]
    for channel, name in enumerate(("red", "green", "blue")):
        out.append((f"{name} rendered", off(lambda k, c=channel: swapped(real[k], made[k], np.arange(3) == c))))  # type: ignore[misc]
    out.append((f"rendered within {CORE:g} radii", off(lambda k: swapped(real[k], made[k], core[k]))))
    out.append((f"rendered beyond {CORE:g} radii", off(lambda k: swapped(real[k], made[k], ~core[k]))))
    for order, name in enumerate(("mean", "linear", "quadratic", "cubic")):
        out.append((f"less the {name} misfit", off(lambda k, n=order: without(real[k], made[k], n))))  # type: ignore[misc]
    return out


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sensor", choices=("digit", "gelsight_mini"), nargs="?", default="digit")
    parser.add_argument("--file", type=Path, help="the sensor file; the shipped one if not given")
    asked = parser.parse_args()
    unit = photographs.unit(asked.sensor)
    if unit is None:
        print(f"no photographs in {photographs.reference()} (set TACGEN_REFERENCE)")
        return
    sensor = cast(LitSensor, loading.read_sensor(asked.file or assets.sensor_path(asked.sensor))[0])
    for name, degrees in lines(sensor, unit):
        print(f"{name:28}{degrees.mean():6.1f}  |" + "".join(f"{one:6.1f}" for one in degrees))


if __name__ == "__main__":
    main()
