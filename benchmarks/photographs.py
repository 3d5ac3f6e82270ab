"""Photographs of real units, if available: in ../shared/reference, or the folder in TACGEN_REFERENCE."""

import csv
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.results_page import ROOT
from tacgen.calibrate import contact_circle
from tacgen.calibrate.photos import Press
from tacgen.recipe.background_photo import read

Array = np.ndarray
UNTOUCHED = {"gelsight_mini": "background.png", "digit": "background.png", "ninedtact": "reference_rectified.png"}
# Centre and radius of the contact [px], start values of the refinement. In circles.csv this circle is only around the
# bright part of the dent; the rim, where the colours turn, is as large as for the same ball elsewhere.
MINI = {"ball_6.310mm_5.png": (279.5, 30.0, 34.0)}
DIGIT_BALL = 1.9  # [mm]
DIGIT = {  # centre and radius [px], not recorded: fitted together with the unit's LEDs
    "sphere_0001.png": (142.5, 147.6, 34.9),
    "sphere_0005.png": (118.1, 196.1, 35.8),
    "sphere_0010.png": (99.7, 92.2, 36.0),
    "sphere_0017.png": (79.4, 175.2, 35.1),
    "sphere_0024.png": (102.4, 221.1, 34.8),
    "sphere_0036.png": (163.5, 228.4, 35.3),
}
NINE = ("ball_R4mm_rectified.png", 4.0, (245.0, 189.5), 1.78)  # radius [mm], centre [px], depth [mm]


@dataclass(frozen=True)
class Unit:
    """One real sensor: its untouched picture (H, W, 3) of 8 bit, and its presses."""

    folder: Path
    untouched: Array
    presses: tuple[Press, ...]


def reference() -> Path:
    """The folder of photographs, with a folder for each sensor; it may not exist."""
    return Path(os.environ.get("TACGEN_REFERENCE", ROOT.parent / "shared" / "reference"))


def unit(name: str, folder: Path | None = None) -> Unit | None:
    """The photographs of a sensor; None if there are none."""
    folder = (folder or reference()) / name
    if not (folder / UNTOUCHED[name]).is_file():
        return None
    untouched, presses = read(folder / UNTOUCHED[name]), _presses(name, folder)
    if name == "gelsight_mini":  # flat gel: refine the circles, which are a tenth too large by eye
        presses = [contact_circle.refined(press, untouched) for press in presses]
    return Unit(folder, untouched, tuple(presses))


def _presses(name: str, folder: Path) -> list[Press]:
    if name == "ninedtact":
        file, ball, center, depth = NINE
        return [Press(file, read(folder / file), ball, center, None, depth)]
    if name == "digit":
        circles = {file: (DIGIT_BALL, *circle) for file, circle in DIGIT.items()}
    else:
        rows = csv.DictReader((folder / "circles.csv").read_text().splitlines())
        keys = ("cx_px", "cy_px", "contact_radius_px")
        circles = {
            row["image"]: (float(row["ball_diameter_mm"]) / 2, *MINI.get(row["image"], [float(row[k]) for k in keys]))
            for row in rows
        }
    return [Press(file, read(folder / file), ball, (x, y), r, None) for file, (ball, x, y, r) in circles.items()]
