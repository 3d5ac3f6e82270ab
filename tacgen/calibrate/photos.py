"""A folder of photographs of a unit: untouched, and with balls pressed into it, each a row of presses.csv.

`read` takes presses of known place for `calibrate optics`, `read_gauged` presses with the readings of a gauge for
`calibrate unit`.
"""

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
PRESS_COLUMN_RANGES = {"ball_radius_mm": (0.1, 100.0), "contact_radius_px": (3.0, np.inf), "depth_mm": (1e-3, np.inf),
          "force_n": (1e-3, 1e6)}  # fmt: skip
GAUGED = ("file", "ball_radius_mm", "force_n")
MAX_UNIT_NUMBER = 1e6  # [N], [s]: readings and times
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


def _press(folder: Path, line: int, row: dict[str, str], camera: Camera, wrong: list[str]) -> PhotographedPress | None:
    """Read a row of the table; problems are added to `wrong`."""
    said = f"{folder / PRESS_TABLE_FILE}:{line}"
    name = row["file"]
    if not name:
        wrong.append(f"{said}: file: is missing")
        return None
    before = len(wrong)
    number: dict[str, float] = {}
    for column in (*NEEDED_PRESS_COLUMNS[1:], *PRESS_SIZE_COLUMNS):
        text = row.get(column, "")
        if not text and column in PRESS_SIZE_COLUMNS:
            continue
        number[column] = csv_table.number(text)
        low, high = PRESS_COLUMN_RANGES.get(column, (-np.inf, np.inf))
        if not low <= number[column] <= high:
            reach = f" of at least {low:g}" if low > -np.inf else ""
            reach += f" and at most {high:g}" if high < np.inf else ""
            wrong.append(f"{said}: {column}: must be a number{reach} (got {text!r})")
    if not any(column in number for column in PRESS_SIZE_COLUMNS):
        wrong.append(f"{said}: must hold {', '.join(PRESS_SIZE_COLUMNS[:-1])} or {PRESS_SIZE_COLUMNS[-1]}")
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


def read_gauged(folder: Path, camera: Camera) -> GaugedPhotos:
    """The presses of a folder. Raises UserError: all that are missing or cannot be used, a line each."""
    usual, wrong = _untouched(folder), list[str]()
    pictures, presses = dict[str, Array](), list[GaugedPress]()
    for line, row in csv_table.rows(folder / PRESS_TABLE_FILE, GAUGED, (), wrong):
        said, before = f"{folder / PRESS_TABLE_FILE}:{line}", len(wrong)
        force, time = _number(row, "force_n", said, wrong), np.nan
        if row.get("time_s"):
            time = _number(row, "time_s", said, wrong)
        ball, (low, high) = csv_table.number(row["ball_radius_mm"]), PRESS_COLUMN_RANGES["ball_radius_mm"]
        if not low <= ball <= high:
            wrong.append(f"{said}: ball_radius_mm: must be from {low:g} to {high:g} (got {row['ball_radius_mm']!r})")
        plain = row.get("untouched") or (usual.name if usual else "")
        if not plain:
            wrong.append(
                f"{said}: has no untouched picture: {folder / UNTOUCHED_FILES[0]}, or one named in `untouched`"
            )
        for name in (row["file"], plain):
            if name and name not in pictures and len(wrong) == before:
                pictures[name] = read_picture(folder / name, camera, wrong)
        if not row["file"]:
            wrong.append(f"{said}: file: is missing")
        if len(wrong) == before:
            recording = row.get("recording") or f"press {len(presses) + 1}"
            both = pictures[row["file"]], pictures[plain]
            presses.append(GaugedPress(row["file"], *both, ball, force, recording, time))
    if not wrong:
        wrong += _problems(folder, presses)
    if wrong:
        raise UserError(wrong)
    return GaugedPhotos(folder, tuple(presses))


def _number(row: dict[str, str], column: str, said: str, wrong: list[str]) -> float:
    value = csv_table.number(row[column])
    if not abs(value) < MAX_UNIT_NUMBER:
        wrong.append(f"{said}: {column}: must be a number below {MAX_UNIT_NUMBER:g} (got {row[column]!r})")
    return value


def _problems(folder: Path, presses: list[GaugedPress]) -> list[str]:
    """Problems of all presses together, a line each."""
    table, wrong = folder / PRESS_TABLE_FILE, []
    shown = sum(_shows(press.picture, press.untouched) for press in presses)
    if shown < LEAST_GAUGED:
        wrong.append(f"{table}: {shown} of its pictures show a press, and a fit takes {LEAST_GAUGED} at least")
    forces = [press.force for press in presses]
    if presses and not max(forces) > 0:
        wrong.append(f"{table}: force_n: holds no press: forces count positive into the gel")
    if presses and max(forces) == min(forces):
        wrong.append(f"{table}: force_n: all forces are alike: press lightly and hard")
    if (count := len({press.ball for press in presses})) > MAX_BALL_SIZES:
        wrong.append(f"{table}: ball_radius_mm: has {count} sizes, and {MAX_BALL_SIZES} are the most")
    seen: set[tuple[str, float]] = set()
    for press in presses:
        if (press.recording, press.time) in seen:
            wrong.append(f"{table}: {press.name}: time_s: {press.time:.15g} is there twice in {press.recording}")
        seen |= {(press.recording, press.time)} if np.isfinite(press.time) else set()
    return wrong
