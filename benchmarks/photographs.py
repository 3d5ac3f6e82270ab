"""Photographs of real units, if available: in ../shared/reference, or the folder in TACGEN_REFERENCE."""

import csv
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from scipy import ndimage

from benchmarks.results_page import ROOT
from tacgen.calibrate.contact_circle import LampChanges, refined
from tacgen.calibrate.photos import PhotographedPress
from tacgen.calibrate.render_comparison import PictureOfPress
from tacgen.recipe import assets, loading
from tacgen.render.photograph import read
from tacgen.sensor.model import LitSensor

Array = np.ndarray
SENSORS = ("gelsight_mini", "digit", "ninedtact")  # whose shipped files are compared with photographs
DOTTED = "gelsight_mini_dotted"
MINIS = ("gelsight_mini", "gelsight_mini_unit2", DOTTED)
# whose lamps show where the contacts are: those of another unit
LAMPS = {"gelsight_mini": "gelsight_mini_second", "gelsight_mini_unit2": "gelsight_mini", DOTTED: "gelsight_mini"}
RECIPE = "many_units"  # the files of other units lie beside it
UNTOUCHED = {"ninedtact": "reference_rectified.png"} | dict.fromkeys((*MINIS, "digit"), "background.png")
# centre and radius of the contact [px], start values of the refinement: circles.csv has that of the bright part alone
MINI = {"ball_6.310mm_5.png": (279.5, 30.0, 34.0)}
# 4.7 mm across at 19.58 px/mm (Rancho-zhao/FOTS, mlp_calib/scripts/create_image_dataset.py, config/normal_to_rgb.yaml).
# Contact circles were not recorded; those of the same unit's other presses are 36 to 46 px in radius there.
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
DARK = 0.15  # a dot is darker than its surroundings by this share
WIDTH, RIM = 21, 3  # side of a square larger than a dot, and width of its rim [px]
FILL = 4.0  # standard deviation of the Gaussian by which hidden pixels are filled [px]


@dataclass(frozen=True)
class Unit:
    """One real sensor: its untouched picture (H, W, 3) of 8 bit, its presses, and the pixels (H, W) bool that a dot or
    its rim hides in each press or in the untouched picture."""

    folder: Path
    untouched: Array
    presses: tuple[PhotographedPress, ...]
    hidden: tuple[Array, ...]


def reference() -> Path:
    """The folder of photographs, with a folder for each unit; it may not exist."""
    return Path(os.environ.get("TACGEN_REFERENCE", ROOT.parent / "shared" / "reference"))


def there(name: str, folder: Path | None = None) -> bool:
    """Whether there are photographs of a unit."""
    return ((folder or reference()) / name / UNTOUCHED[name]).is_file()


def unit(name: str, folder: Path | None = None) -> Unit | None:
    """The photographs of a unit; None if there are none. Circles on flat gels, drawn by eye, are refined by
    another unit's lamps."""
    if not there(name, folder):
        return None
    folder = (folder or reference()) / name
    untouched, presses = read(folder / UNTOUCHED[name]), as_drawn(name, folder)
    hidden = [np.zeros(untouched.shape[:2], bool) for _ in presses]
    if name == DOTTED:
        hidden = [dark(untouched) | dark(press.picture) for press in presses]
    if name in MINIS:
        lamps = LampChanges(sensor_of(LAMPS[name]))
        presses = [placed(press, untouched, lamps, where) for press, where in zip(presses, hidden, strict=True)]
    return Unit(folder, untouched, tuple(presses), tuple(hidden))


def as_drawn(name: str, folder: Path) -> list[PhotographedPress]:
    """The presses of a unit with the circles that were drawn by eye."""
    if name == "ninedtact":
        file, ball, center, depth = NINE
        return [PhotographedPress(file, read(folder / file), ball, center, None, depth)]
    if name == "digit":
        return [PhotographedPress(k, read(folder / k), DIGIT_BALL, (x, y), r, d) for k, (x, y, r, d) in DIGIT.items()]
    first = name == "gelsight_mini"
    keys = ("cx_px", "cy_px", "contact_radius_px") if first else ("centre_x_px", "centre_y_px", "contact_radius_px")
    presses = []
    for row in csv.DictReader((folder / ("circles.csv" if first else "presses.csv")).read_text().splitlines()):
        x, y, radius = MINI.get(row["image"], [float(row[key]) for key in keys])
        ball = float(row["ball_diameter_mm"]) / 2
        presses.append(PhotographedPress(row["image"], read(folder / row["image"]), ball, (x, y), radius, None))
    return presses


def radial_profile(change: Array, middle: tuple[float, float], mm_per_px: float) -> Array:
    """Mean change [counts] of a picture (h, w) in rings of 0.2 mm to 9 mm around a place [px]."""
    y, x = np.mgrid[: change.shape[0], : change.shape[1]] + 0.5
    ring = (np.hypot(x - middle[0], y - middle[1]) * mm_per_px / 0.2).astype(int)
    sums, count = (np.bincount(ring.ravel(), w, 45)[:45] for w in (change.ravel(), np.ones(change.size)))
    return np.asarray(sums / count)


def dark(picture: Array) -> Array:
    """Pixels (H, W) bool of dots, which are darker than what surrounds them, and of their rims."""
    grey = picture.astype(float).max(axis=2)
    ground = ndimage.grey_closing(grey, (WIDTH, WIDTH))
    return np.asarray(ndimage.binary_dilation((ground - grey) / np.maximum(ground, 1.0) > DARK, iterations=RIM))


def placed(press: PhotographedPress, untouched: Array, lamps: LampChanges, hidden: Array) -> PhotographedPress:
    """The press with its contact circle, found beside the dots; rims are filled from around them."""
    change = filled(press.picture.astype(float) - untouched, hidden)
    found = refined(replace(press, picture=untouched + change), untouched, lamps, hidden)
    return replace(found, picture=press.picture)


def sensor_of(name: str) -> LitSensor:
    """The sensor file of a unit, shipped or of the population."""
    beside = assets.recipe_path(RECIPE).parent / "units" / f"{name}.yaml"
    return cast(LitSensor, loading.read_sensor(beside if beside.is_file() else assets.sensor_path(name))[0])


def filled(change: Array, hidden: Array) -> Array:
    """Colours (H, W, 3) with hidden pixels (H, W) filled from around them."""
    seen = (~hidden).astype(float)[..., None]
    around = [ndimage.gaussian_filter(part, (FILL, FILL, 0)) for part in (change * seen, seen)]
    return np.where(hidden[..., None], around[0] / np.maximum(around[1], 1e-9), change)


def without(press: PictureOfPress, hidden: Array) -> PictureOfPress:
    """A press without the pixels that are hidden; their colours are filled, so that smoothing does not spread it."""
    kept = ~hidden[press.where]
    change, untouched = (filled(one, hidden) for one in (press.change, press.untouched))
    where, slopes, flat = press.where & ~hidden, press.slopes[kept], press.flat[kept]
    return replace(press, change=change, untouched=untouched, where=where, slopes=slopes, flat=flat)
