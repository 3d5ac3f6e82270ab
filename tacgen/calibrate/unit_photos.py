"""A folder of photographs of ball presses with forces: each a row of presses.csv, beside its untouched picture."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacgen import csv_table
from tacgen.calibrate.photos import RANGES, TABLE, UNCHANGED, UNTOUCHED, read_picture
from tacgen.errors import UserError
from tacgen.sensor.model import Camera

Array = np.ndarray
NEEDED = ("file", "ball_radius_mm", "force_n")
LARGEST = 1e6  # [N], [s]
LEAST = 4  # presses that show something
MOST_BALLS = 5  # sizes: each takes minutes to solve


@dataclass(frozen=True)
class UnitPress:
    """A photographed press with the reading of a gauge."""

    name: str
    picture: Array  # (H, W, 3), 8 bit
    untouched: Array  # (H, W, 3), 8 bit
    ball: float  # radius [mm]
    force: float  # [N], pressed into the gel positive
    recording: str
    time: float  # [s]; nan if not given


@dataclass(frozen=True)
class UnitPhotos:
    """All presses of one unit."""

    folder: Path
    presses: tuple[UnitPress, ...]

    @property
    def recordings(self) -> list[str]:
        """Names of the recordings, in the table's order."""
        return list(dict.fromkeys(press.recording for press in self.presses))


def read(folder: Path, camera: Camera) -> UnitPhotos:
    """The presses of a folder. Raises UserError: all that are missing or cannot be used, a line each."""
    if not folder.is_dir():
        raise UserError(f"{folder}: no such folder")
    wrong: list[str] = []
    usual = next((name for name in UNTOUCHED if (folder / name).is_file()), "")
    pictures: dict[str, Array] = {}
    presses: list[UnitPress] = []
    for line, row in csv_table.rows(folder / TABLE, NEEDED, (), wrong):
        said, before = f"{folder / TABLE}:{line}", len(wrong)
        force, time = _number(row, "force_n", said, wrong), np.nan
        if row.get("time_s"):
            time = _number(row, "time_s", said, wrong)
        ball, (low, high) = csv_table.number(row["ball_radius_mm"]), RANGES["ball_radius_mm"]
        if not low <= ball <= high:
            wrong.append(f"{said}: ball_radius_mm: must be from {low:g} to {high:g} (got {row['ball_radius_mm']!r})")
        plain = row.get("untouched") or usual
        if not plain:
            wrong.append(f"{said}: has no untouched picture: {folder / UNTOUCHED[0]}, or one named in `untouched`")
        for name in (row["file"], plain):
            if name and name not in pictures and len(wrong) == before:
                pictures[name] = read_picture(folder / name, camera, wrong)
        if not row["file"]:
            wrong.append(f"{said}: file: is missing")
        if len(wrong) == before:
            recording = row.get("recording") or f"press {len(presses) + 1}"
            presses.append(UnitPress(row["file"], pictures[row["file"]], pictures[plain], ball, force, recording, time))
    if not wrong:
        wrong += _problems(folder, presses)
    if wrong:
        raise UserError(wrong)
    return UnitPhotos(folder, tuple(presses))


def _number(row: dict[str, str], column: str, said: str, wrong: list[str]) -> float:
    value = csv_table.number(row[column])
    if not abs(value) < LARGEST:
        wrong.append(f"{said}: {column}: must be a number below {LARGEST:g} (got {row[column]!r})")
    return value


def _problems(folder: Path, presses: list[UnitPress]) -> list[str]:
    """Problems of all presses together, a line each."""
    table, wrong = folder / TABLE, []
    shown = sum((p.picture.astype(float) - p.untouched).std(axis=(0, 1)).max() >= UNCHANGED for p in presses)
    if shown < LEAST:
        wrong.append(f"{table}: {shown} of its pictures show a press, and a fit takes {LEAST} at least")
    forces = [press.force for press in presses]
    if presses and not max(forces) > 0:
        wrong.append(f"{table}: force_n: holds no press: forces count positive into the gel")
    if presses and max(forces) == min(forces):
        wrong.append(f"{table}: force_n: all forces are alike: press lightly and hard")
    if (count := len({press.ball for press in presses})) > MOST_BALLS:
        wrong.append(f"{table}: ball_radius_mm: has {count} sizes, and {MOST_BALLS} are the most")
    seen: set[tuple[str, float]] = set()
    for press in presses:
        if (press.recording, press.time) in seen:
            wrong.append(f"{table}: {press.name}: time_s: {press.time:.15g} is there twice in {press.recording}")
        seen |= {(press.recording, press.time)} if np.isfinite(press.time) else set()
    return wrong
