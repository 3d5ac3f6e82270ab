"""A folder of photographs of a unit: untouched, and with balls pressed into it, each a row of presses.csv."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacgen import csv_table
from tacgen.errors import UserError
from tacgen.recipe import background_photo
from tacgen.sensor.model import Camera

Array = np.ndarray
UNTOUCHED = ("background.png", "background.jpg", "background.jpeg", "background.bmp")
TABLE = "presses.csv"
NEEDED = ("file", "ball_radius_mm", "x_px", "y_px")
EITHER = ("contact_radius_px", "depth_mm", "force_n")
SATURATED, DARK = 254, 5  # 8-bit counts
MOST_SATURATED = 0.01  # largest share of saturated pixels
UNCHANGED = 0.5  # counts: standard deviation of the change over a picture, below which it shows no press
RANGES = {"ball_radius_mm": (0.1, 100.0), "contact_radius_px": (3.0, np.inf), "depth_mm": (1e-3, np.inf),
          "force_n": (1e-3, 1e6)}  # fmt: skip


@dataclass(frozen=True)
class PhotographedPress:
    """A photographed press: its ball, and at least one of the radius of its contact, its depth and its force."""

    name: str
    picture: Array  # (H, W, 3), 8 bit
    ball: float  # radius [mm]
    center: tuple[float, float]  # of the contact [px]
    contact: float | None  # radius of the contact [px], across
    depth: float | None  # [mm] from first touch
    force: float | None = None  # normal force [N]; a depth, where there is one, goes first
    aspect: float = 1.0  # height of a pixel over its width

    @property
    def solved(self) -> bool:
        """Whether the face is computed by finite elements."""
        return self.depth is not None or self.force is not None


@dataclass(frozen=True)
class Photos:
    """All photographs of one unit."""

    folder: Path
    untouched: Array  # (H, W, 3), 8 bit
    presses: tuple[PhotographedPress, ...]


def read(folder: Path, camera: Camera) -> Photos:
    """The photographs in a folder. Raises UserError: all that are missing or cannot be used, a line each."""
    picture = next((folder / name for name in UNTOUCHED if (folder / name).is_file()), None)
    wrong: list[str] = []
    if not folder.is_dir():
        raise UserError(f"{folder}: no such folder")
    if picture is None:
        wrong.append(f"{folder}: holds no background.png, the photograph of the untouched sensor")
    untouched = np.zeros(0) if picture is None else read_picture(picture, camera, wrong)
    presses = []
    table = folder / TABLE
    for line, row in csv_table.rows(table, NEEDED, EITHER, wrong) if table.is_file() else ():
        press = _press(folder, line, row, camera, wrong)
        presses += [press] if press else []
    for press in presses if not wrong else ():
        if (press.picture.astype(float) - untouched).std(axis=(0, 1)).max() < UNCHANGED:
            wrong.append(f"{folder / press.name}: shows no press: it is like the untouched picture")
    if wrong:
        raise UserError(wrong)
    return Photos(folder, untouched, tuple(presses))


def read_picture(path: Path, camera: Camera, wrong: list[str]) -> Array:
    """A picture (H, W, 3) of the camera's size, 8 bit; problems are added to `wrong`."""
    try:
        picture = background_photo.read(path)
    except UserError as error:
        wrong += error.lines
        return np.zeros(0)
    height, width = picture.shape[:2]
    if (width, height) != (camera.width_px, camera.height_px):
        wrong.append(
            f"{path}: is {width} x {height}, and the camera's pictures are {camera.width_px} x {camera.height_px}:"
            " crop and resize it as they are"
        )
        return picture
    if (share := np.mean((picture >= SATURATED).any(axis=2))) > MOST_SATURATED:
        wrong.append(f"{path}: {100 * share:.0f} % of its pixels are saturated: expose it less, and all others alike")
    if picture.mean() < DARK:
        wrong.append(f"{path}: is dark, {picture.mean():.1f} of 255 in the mean: are the LEDs on?")
    return picture


def _press(folder: Path, line: int, row: dict[str, str], camera: Camera, wrong: list[str]) -> PhotographedPress | None:
    """Read a row of the table; problems are added to `wrong`."""
    said = f"{folder / TABLE}:{line}"
    name = row["file"]
    if not name:
        wrong.append(f"{said}: file: is missing")
        return None
    before = len(wrong)
    number: dict[str, float] = {}
    for column in (*NEEDED[1:], *EITHER):
        text = row.get(column, "")
        if not text and column in EITHER:
            continue
        number[column] = csv_table.number(text)
        low, high = RANGES.get(column, (-np.inf, np.inf))
        if not low <= number[column] <= high:
            reach = f" of at least {low:g}" if low > -np.inf else ""
            reach += f" and at most {high:g}" if high < np.inf else ""
            wrong.append(f"{said}: {column}: must be a number{reach} (got {text!r})")
    if not any(column in number for column in EITHER):
        wrong.append(f"{said}: must hold {', '.join(EITHER[:-1])} or {EITHER[-1]}")
    picture = read_picture(folder / name, camera, wrong)
    if len(wrong) > before:
        return None
    x, y, contact = number["x_px"], number["y_px"], number.get("contact_radius_px")
    if not (0 <= x <= camera.width_px and 0 <= y <= camera.height_px):
        wrong.append(f"{said}: ({x:g}, {y:g}) lies outside the picture")
    if contact is not None and contact * camera.mm_per_px >= number["ball_radius_mm"]:
        size = contact * camera.mm_per_px
        wrong.append(f"{said}: contact_radius_px: is {size:.3g} mm, and the ball's radius {row['ball_radius_mm']}")
    if len(wrong) > before:
        return None
    return PhotographedPress(
        name, picture, number["ball_radius_mm"], (x, y), contact, number.get("depth_mm"), number.get("force_n"),
        camera.aspect,
    )  # fmt: skip
