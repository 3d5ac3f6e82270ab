"""A folder of photographs of a unit: untouched, and with balls pressed into it, each a row of presses.csv.

`read` takes presses of known place for `calibrate optics`, `read_gauged` presses with the readings of a gauge for
`calibrate unit`.
"""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacgen.base import csv_table
from tacgen.base.errors import UserError
from tacgen.render import photograph
from tacgen.sensor.model import Camera

Array = np.ndarray
UNTOUCHED_FILES = ("background.png", "background.jpg", "background.jpeg", "background.bmp")
PRESS_TABLE_FILE = "presses.csv"
NEEDED_PRESS_COLUMNS = ("file", "ball_radius_mm", "x_px", "y_px")
PRESS_SIZE_COLUMNS = ("contact_radius_px", "depth_mm", "force_n")
SATURATED_COUNT, MIN_MEAN_COUNT = 254, 5  # 8-bit counts
MAX_SATURATED_SHARE = 0.01  # largest share of saturated pixels
MIN_CHANGE_STD = 0.5  # counts: standard deviation of the change over a picture, below which it shows no press
MAX_NUMBER = 1e6  # [N], [s], [px], [mm]: no press has more
PRESS_COLUMN_RANGES = {"ball_radius_mm": (0.1, 100.0), "contact_radius_px": (3.0, MAX_NUMBER),
          "depth_mm": (1e-3, MAX_NUMBER), "force_n": (1e-3, MAX_NUMBER)}  # fmt: skip
GAUGED_PRESS_COLUMNS = ("file", "ball_radius_mm", "force_n")
LEAST_GAUGED = 4  # presses that show something
MAX_BALL_SIZES = 5  # sizes: each takes minutes to solve


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


@dataclass(frozen=True)
class GaugedPress:
    """A photographed press with the reading of a gauge."""

    name: str
    picture: Array  # (H, W, 3), 8 bit
    untouched: Array  # (H, W, 3), 8 bit
    ball: float  # radius [mm]
    force: float  # [N], pressed into the gel positive
    recording: str
    time: float  # [s]; nan if not given


@dataclass(frozen=True)
class GaugedPhotos:
    """All presses of one unit with a gauge."""

    folder: Path
    presses: tuple[GaugedPress, ...]

    @property
    def recordings(self) -> list[str]:
        """Names of the recordings, in the table's order."""
        return list(dict.fromkeys(press.recording for press in self.presses))


def read(folder: Path, camera: Camera) -> Photos:
    """The photographs in a folder. Raises UserError: all that are missing or cannot be used, a line each."""
    picture, wrong = _untouched(folder), list[str]()
    if picture is None:
        wrong.append(f"{folder}: holds no background.png, the photograph of the untouched sensor")
    untouched = np.zeros(0) if picture is None else read_picture(picture, camera, wrong)
    presses = []
    table = folder / PRESS_TABLE_FILE
    for line, row in csv_table.rows(table, NEEDED_PRESS_COLUMNS, PRESS_SIZE_COLUMNS, wrong) if table.is_file() else ():
        press = _press(folder, line, row, camera, wrong)
        presses += [press] if press else []
    for press in presses if not wrong else ():
        if not _shows(press.picture, untouched):
            wrong.append(f"{folder / press.name}: shows no press: it is like the untouched picture")
    if wrong:
        raise UserError(wrong)
    return Photos(folder, untouched, tuple(presses))


def _untouched(folder: Path) -> Path | None:
    """The photograph of the untouched sensor, if there is one. Raises UserError: there is no such folder."""
    if not folder.is_dir():
        raise UserError(f"{folder}: no such folder")
    return next((folder / name for name in UNTOUCHED_FILES if (folder / name).is_file()), None)


def read_picture(path: Path, camera: Camera, wrong: list[str]) -> Array:
    """A picture (H, W, 3) of the camera's size, 8 bit; problems are added to `wrong`."""
    try:
        picture = photograph.read(path)
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
    if (share := np.mean((picture >= SATURATED_COUNT).any(axis=2))) > MAX_SATURATED_SHARE:
        wrong.append(f"{path}: {100 * share:.0f} % of its pixels are saturated: expose it less, and all others alike")
    if picture.mean() < MIN_MEAN_COUNT:
        wrong.append(f"{path}: is dark, {picture.mean():.1f} of 255 in the mean: are the LEDs on?")
    return picture


def _shows(picture: Array, untouched: Array) -> bool:
    """Whether a picture (H, W, 3) shows a press."""
    return bool((picture.astype(float) - untouched).std(axis=(0, 1)).max() >= MIN_CHANGE_STD)


def _number(
    row: dict[str, str], column: str, said: str, wrong: list[str], low: float = -MAX_NUMBER, high: float = MAX_NUMBER
) -> float:
    """The number in a column; if it is none from `low` to `high`, a problem is added to `wrong`."""
    value = csv_table.number(row[column])
    if not low <= value <= high:
        wrong.append(f"{said}: {column}: must be a number from {low:g} to {high:g} (got {row[column]!r})")
    return value


def _press(folder: Path, line: int, row: dict[str, str], camera: Camera, wrong: list[str]) -> PhotographedPress | None:
    """Read a row of the table; problems are added to `wrong`."""
    said, name, before = f"{folder / PRESS_TABLE_FILE}:{line}", row["file"], len(wrong)
    if not name:
        wrong.append(f"{said}: file: is missing")
        return None
    given = [column for column in PRESS_SIZE_COLUMNS if row.get(column)]
    number = {column: _number(row, column, said, wrong, *PRESS_COLUMN_RANGES.get(column, ()))
              for column in (*NEEDED_PRESS_COLUMNS[1:], *given)}  # fmt: skip
    if not given:
        wrong.append(f"{said}: must hold {', '.join(PRESS_SIZE_COLUMNS[:-1])} or {PRESS_SIZE_COLUMNS[-1]}")
    picture = read_picture(folder / name, camera, wrong)
    if len(wrong) > before:
        return None
    ball, x, y = (number[column] for column in NEEDED_PRESS_COLUMNS[1:])
    if not (0 <= x <= camera.width_px and 0 <= y <= camera.height_px):
        wrong.append(f"{said}: ({x:g}, {y:g}) lies outside the picture")
    contact, depth, force = (number.get(column) for column in PRESS_SIZE_COLUMNS)
    if contact is not None and (size := contact * camera.mm_per_px) >= ball:
        wrong.append(f"{said}: contact_radius_px: is {size:.3g} mm, and the ball's radius {row['ball_radius_mm']}")
    return PhotographedPress(name, picture, ball, (x, y), contact, depth, force, camera.aspect)


def read_gauged(folder: Path, camera: Camera) -> GaugedPhotos:
    """The presses of a folder. Raises UserError: all that are missing or cannot be used, a line each."""
    usual, wrong = _untouched(folder), list[str]()
    pictures, presses = dict[str, Array](), list[GaugedPress]()
    for line, row in csv_table.rows(folder / PRESS_TABLE_FILE, GAUGED_PRESS_COLUMNS, (), wrong):
        said, before = f"{folder / PRESS_TABLE_FILE}:{line}", len(wrong)
        force = _number(row, "force_n", said, wrong)
        time = _number(row, "time_s", said, wrong) if row.get("time_s") else np.nan
        ball = _number(row, "ball_radius_mm", said, wrong, *PRESS_COLUMN_RANGES["ball_radius_mm"])
        plain = row.get("untouched") or (usual.name if usual else "")
        if not plain:
            missing = folder / UNTOUCHED_FILES[0]
            wrong.append(f"{said}: has no untouched picture: {missing}, or one named in `untouched`")
        if not row["file"]:
            wrong.append(f"{said}: file: is missing")
        for name in (row["file"], plain):
            if len(wrong) == before and name not in pictures:
                pictures[name] = read_picture(folder / name, camera, wrong)
        if len(wrong) == before:
            recording = row.get("recording") or f"press {len(presses) + 1}"
            both = pictures[row["file"]], pictures[plain]
            presses.append(GaugedPress(row["file"], *both, ball, force, recording, time))
    wrong = wrong or _problems(folder / PRESS_TABLE_FILE, presses)
    if wrong:
        raise UserError(wrong)
    return GaugedPhotos(folder, tuple(presses))


def _problems(table: Path, presses: list[GaugedPress]) -> list[str]:
    """Problems of all presses together, a line each."""
    shown, wrong = sum(_shows(press.picture, press.untouched) for press in presses), []
    if shown < LEAST_GAUGED:
        wrong.append(f"{table}: {shown} of its pictures show a press, and a fit takes {LEAST_GAUGED} at least")
    forces = [press.force for press in presses]
    if presses and not max(forces) > 0:
        wrong.append(f"{table}: force_n: holds no press: forces count positive into the gel")
    if presses and max(forces) == min(forces):
        wrong.append(f"{table}: force_n: all forces are alike: press lightly and hard")
    if (count := len({press.ball for press in presses})) > MAX_BALL_SIZES:
        wrong.append(f"{table}: ball_radius_mm: has {count} sizes, and {MAX_BALL_SIZES} are the most")
    seen = Counter((press.recording, press.time) for press in presses if np.isfinite(press.time))
    wrong += [f"{table}: time_s: {time:.15g} is there twice in {recording}"
              for (recording, time), times in seen.items() if times > 1]  # fmt: skip
    return wrong
