"""Photographs of three GelSight Minis, two of them without dots, and where dots hide the coating."""

import csv
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from benchmarks import photographs
from tacgen.calibrate import contact_circle
from tacgen.calibrate.likeness import PictureOfPress
from tacgen.calibrate.photos import PhotographedPress
from tacgen.recipe.background_photo import read

Array = np.ndarray
FOLDERS = ("gelsight_mini", "gelsight_mini_unit2", "gelsight_mini_dotted")
DARK = 0.15  # a dot is darker than its surroundings by this share
WIDTH, RIM = 21, 3  # side of a square larger than a dot, and width of its rim [px]
FILL = 4.0  # standard deviation of the Gaussian by which hidden pixels are filled [px]


@dataclass(frozen=True)
class MiniUnit:
    """One real Mini: its untouched picture (H, W, 3) of 8 bit, its presses, and the pixels (H, W) that a dot or its rim
    hides in each press or in the untouched picture."""

    name: str
    untouched: Array
    presses: tuple[PhotographedPress, ...]
    hidden: tuple[Array, ...]

    @property
    def pictures(self) -> list[Array]:
        """The pictures of the presses (H, W, 3)."""
        return [press.picture for press in self.presses]


def here() -> bool:
    """Whether photographs of all three are there."""
    return all((photographs.reference() / name / "background.png").is_file() for name in FOLDERS)


def unit(name: str) -> MiniUnit:
    """The photographs in one of FOLDERS; contact circles are refined."""
    if name == FOLDERS[0]:
        found = photographs.unit(name)
        assert found is not None
        untouched, presses = found.untouched, found.presses
    else:
        folder = photographs.reference() / name
        untouched = read(folder / "background.png")
        rows = csv.DictReader((folder / "presses.csv").read_text(encoding="utf-8").splitlines())
        numbers = ("ball_diameter_mm", "centre_x_px", "centre_y_px", "contact_radius_px")
        marked = []
        for row in rows:
            ball, x, y, radius = (float(row[key]) for key in numbers)
            marked.append(PhotographedPress(row["image"], read(folder / row["image"]), ball / 2, (x, y), radius, None))
        presses = tuple(marked)
    if name == FOLDERS[2]:
        hidden = tuple(dark(untouched) | dark(press.picture) for press in presses)
        presses = tuple(refined(press, untouched, where) for press, where in zip(presses, hidden, strict=True))
        return MiniUnit(name, untouched, presses, hidden)
    if name != FOLDERS[0]:  # whose circles are refined already
        presses = tuple(contact_circle.refined(press, untouched) for press in presses)
    return MiniUnit(name, untouched, presses, tuple(np.zeros(untouched.shape[:2], bool) for _ in presses))


def refined(press: PhotographedPress, untouched: Array, hidden: Array) -> PhotographedPress:
    """The press with its contact circle, found in a picture whose dots are filled from around them."""
    change = filled(press.picture.astype(float) - untouched, hidden)
    found = contact_circle.refined(replace(press, picture=untouched + change), untouched)
    return replace(found, picture=press.picture)


def filled(change: Array, hidden: Array) -> Array:
    """A change of colour (H, W, 3) with hidden pixels (H, W) filled from around them."""
    seen = (~hidden).astype(float)[..., None]
    around = [ndimage.gaussian_filter(part, (FILL, FILL, 0)) for part in (change * seen, seen)]
    return np.where(hidden[..., None], around[0] / np.maximum(around[1], 1e-9), change)


def dark(picture: Array) -> Array:
    """Pixels (H, W) bool of dots and their rims."""
    grey = picture.astype(float).max(axis=2)
    ground = ndimage.grey_closing(grey, (WIDTH, WIDTH))
    return np.asarray(ndimage.binary_dilation(ground - grey > DARK * ground, iterations=RIM))


def without(press: PictureOfPress, hidden: Array) -> PictureOfPress:
    """A press without the pixels that are hidden; their change is filled, so that smoothing does not spread it."""
    kept, change = ~hidden[press.where], filled(press.change, hidden)
    return PictureOfPress(change, press.where & ~hidden, press.slopes[kept], press.flat[kept])
