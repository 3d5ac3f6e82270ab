"""Units of the tiny sensor for `tacgen calibrate`: their files, photographs of presses, and the command."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import Result
from PIL import Image
from ruamel.yaml import YAML

from helpers.command import tacgen_
from tacgen.optics.camera import PinholeCamera
from tacgen.optics.hertz_dent import BallDent
from tacgen.render import images, mitsuba_variants
from tacgen.sensor.model import Sensor

FINE = {"mm_per_px": 0.1, "width_px": 80, "height_px": 64}
PRESSES = ((4.0, (30, 28), 15.0), (3.0, (52, 40), 14.0), (4.0, (45, 20), 15.0), (5.0, (25, 45), 16.0))  # ball, px, px
CIRCLE_COLUMNS = ("file", "ball_radius_mm", "x_px", "y_px", "contact_radius_px")


def photographed(unit: Sensor, folder: Path, presses: Any = PRESSES) -> Path:
    """A folder of photographs of a unit, with its noise if it has any."""
    made, camera = images.Renderer(unit, 64, 0, False, mitsuba_variants.SCALAR_VARIANT), PinholeCamera.from_sensor(unit)
    folder.mkdir(exist_ok=True)
    save(made.develop(made.flat()), folder / "background.png")
    rows = []
    for k, (ball, center, contact) in enumerate(presses):
        dent = BallDent.seen(camera, ball, center, contact)
        save(made.develop(made.image(dent)), folder / f"press_{k}.png")
        rows.append((f"press_{k}.png", ball, *center, contact))
    table(folder, CIRCLE_COLUMNS, rows)
    return folder


def save(picture: np.ndarray, path: Path) -> None:
    """Write a picture (H, W, 3), rounded and limited to 8 bit."""
    Image.fromarray(np.clip(picture, 0, 255).round().astype(np.uint8)).save(path)


def grey(path: Path, *colour: int) -> None:
    """Write a picture of FINE's size in one colour, by default a grey of 90."""
    Image.new("RGB", (FINE["width_px"], FINE["height_px"]), colour or (90, 90, 90)).save(path)


def table(folder: Path, columns: Any, rows: Any, name: str = "presses.csv") -> Path:
    """A CSV table in a folder."""
    with (folder / name).open("w", newline="") as file:
        csv.writer(file).writerows([columns, *rows])
    return folder / name


def written(made: Sensor, path: Path) -> Path:
    """A sensor file, with a comment."""
    with path.open("w") as file:
        file.write("# a unit of ours\n")
        YAML().dump(json.loads(made.model_dump_json(exclude_none=True)), file)
    return path


def calibrate(*words: object) -> Result:
    """Run `tacgen calibrate`."""
    return tacgen_("calibrate", *words)


def refused(done: Result, says: str) -> None:
    """Check that a command ended with one line that says this, after its steps, if it took long."""
    assert done.exit_code == 2, done.output
    *steps, last = done.stderr.splitlines()
    assert says in last
    assert not [line for line in steps if "must" in line or "cannot" in line]
