"""Photographs of real units, if available: in ../shared/reference, or the folder in TACGEN_REFERENCE."""

import csv
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.results_page import ROOT
from tacgen.calibrate import contact_circle
from tacgen.calibrate.photos import PhotographedPress
from tacgen.recipe.background_photo import read

Array = np.ndarray
UNTOUCHED = {"gelsight_mini": "background.png", "digit": "background.png", "ninedtact": "reference_rectified.png"}
# Centre and radius of the contact [px], start values of the refinement. In circles.csv this circle is only around the
# bright part of the dent; the rim, where the colours turn, is as large as for the same ball elsewhere.
MINI = {"ball_6.310mm_5.png": (279.5, 30.0, 34.0)}
# The ball is 4.7 mm across at 19.58 px/mm (Rancho-zhao/FOTS, mlp_calib/scripts/create_image_dataset.py and
# config/normal_to_rgb.yaml). Contact circles of these pictures were not recorded; those of the same unit's other
# presses are 36 to 46 px in radius there.
DIGIT_BALL = 2.35  # [mm]
DIGIT = {  # centre and radius of the contact [px], and depth [mm]: solved faces that suit the unit's LEDs best
    "sphere_0001.png": (143.8, 147.1, 38.7, 1.35),
    "sphere_0005.png": (118.9, 196.9, 40.7, 1.50),
    "sphere_0010.png": (100.6, 88.2, 40.0, 1.46),
    "sphere_0017.png": (80.0, 176.2, 36.9, 1.26),
    "sphere_0024.png": (103.0, 223.3, 38.9, 1.41),
    "sphere_0036.png": (164.0, 230.2, 40.0, 1.45),
}
NINE = ("ball_R4mm_rectified.png", 4.0, (245.0, 189.5), 1.78)  # radius [mm], centre [px], depth [mm]


@dataclass(frozen=True)
class Unit:
    """One real sensor: its untouched picture (H, W, 3) of 8 bit, and its presses."""

    folder: Path
    untouched: Array
    presses: tuple[PhotographedPress, ...]


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


def radial_profile(change: Array, middle: tuple[float, float], mm_per_px: float) -> Array:
    """Mean change [counts] of a picture (h, w) in rings of 0.2 mm to 9 mm around a place [px]."""
    y, x = np.mgrid[: change.shape[0], : change.shape[1]] + 0.5
    ring = (np.hypot(x - middle[0], y - middle[1]) * mm_per_px / 0.2).astype(int)
    sums, count = (np.bincount(ring.ravel(), w, 45)[:45] for w in (change.ravel(), np.ones(change.size)))
    return np.asarray(sums / count)


def _presses(name: str, folder: Path) -> list[PhotographedPress]:
    if name == "ninedtact":
        file, ball, center, depth = NINE
        return [PhotographedPress(file, read(folder / file), ball, center, None, depth)]
    if name == "digit":
        return [
            PhotographedPress(file, read(folder / file), DIGIT_BALL, (x, y), r, d)
            for file, (x, y, r, d) in DIGIT.items()
        ]
    rows = csv.DictReader((folder / "circles.csv").read_text().splitlines())
    keys = ("cx_px", "cy_px", "contact_radius_px")
    presses = []
    for row in rows:
        x, y, radius = MINI.get(row["image"], [float(row[key]) for key in keys])
        ball = float(row["ball_diameter_mm"]) / 2
        presses.append(PhotographedPress(row["image"], read(folder / row["image"]), ball, (x, y), radius, None))
    return presses
