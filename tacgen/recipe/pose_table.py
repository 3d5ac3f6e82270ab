"""A pose table: CSV with a header and one pose a row, as plain numbers; what is wrong with it is told by line."""

import csv
import functools
import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

from tacgen.errors import UserError, why
from tacgen.recipe.turns import Placement, unit

# What a column may be called; x, y and z may end in _mm or _m, time in _s. Capitals do not matter.
COLUMNS = {
    "time": ("time", "timestamp", "t"),
    **{axis: (axis, f"t{axis}", f"p{axis}", f"position_{axis}", f"position.{axis}") for axis in "xyz"},
    **{f"q{part}": (f"q{part}", f"orientation_{part}", f"orientation.{part}") for part in "wxyz"},
}
MM = {"mm": 1.0, "m": 1000.0}
TOLD = 5  # problems of one file


@dataclass(frozen=True)
class Pose:
    """One row: where a body stands in the table's frame, lengths in mm."""

    line: int  # of the file, from 1
    time: float  # [s]
    place: Placement


@dataclass(frozen=True)
class Table:
    """The poses of a file in order."""

    sha256: str
    poses: tuple[Pose, ...]


def read(path: Path, units: str | None = None) -> Table:
    """Read a table; `units` of x, y and z where the header does not say, mm if neither does.

    Raises:
        UserError: the file cannot be read, or is no such table; a line each, without the file's name.
    """
    try:
        raw = path.read_bytes()
    except (OSError, ValueError) as error:
        raise UserError(f"cannot be read: {why(error)}") from None
    return _parsed(raw, units)


@functools.lru_cache(maxsize=8)
def _parsed(raw: bytes, units: str | None) -> Table:
    """The table in the bytes of a file; those of a batch are parsed once."""
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise UserError("is not a text file (UTF-8)") from None
    rows = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not rows:
        raise UserError("is empty: it must start with a header such as time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz")
    try:
        header = _cells(rows[0][1])
    except ValueError as error:
        raise UserError(f"line {rows[0][0]}: {error}") from None
    where, scale = _columns(header, units)
    poses: list[Pose] = []
    wrong: list[str] = []
    for line, content in rows[1:]:
        try:
            poses.append(_pose(line, _cells(content), where, scale, len(header), poses[-1] if poses else None))
        except ValueError as error:
            wrong.append(f"line {line}: {error}")
    if wrong:
        more = [f"and {len(wrong) - TOLD} more lines"] if len(wrong) > TOLD else []
        raise UserError([*wrong[:TOLD], *more])
    if not poses:
        raise UserError("holds no pose below its header")
    return Table(hashlib.sha256(raw).hexdigest(), tuple(poses))


def _cells(line: str) -> list[str]:
    try:
        return next(csv.reader([line]))
    except csv.Error as error:
        raise ValueError(f"is no line of CSV: {error}") from None


def _columns(header: list[str], units: str | None) -> tuple[dict[str, int], float]:
    """Where each column stands, and what a length in the file is in mm."""
    where: dict[str, int] = {}
    said: dict[str, str] = {}  # column -> unit in its name
    for i, title in enumerate(header):
        name, _, suffix = title.strip().lower().rpartition("_")
        if not name or suffix not in ("s", *MM):
            name, suffix = title.strip().lower(), ""
        for column, names in COLUMNS.items():
            fits = suffix in ({"time": ("", "s")}.get(column, ("", *MM) if column in "xyz" else ("",)))
            if name in names and fits:
                if column in where:
                    raise UserError(f"the columns {header[where[column]]} and {title} are both {column}")
                where[column] = i
                if suffix in MM:
                    said[column] = suffix
    missing = [column for column in COLUMNS if column not in where]
    if missing:
        raise UserError(f"has no column {', '.join(missing)} (its header: {','.join(header)})")
    found = {*said.values(), *([units] if units else [])}
    if len(found) > 1 or 0 < len(said) < 3:
        raise UserError(f"x, y and z must be in one unit (header: {','.join(header)}; units: {units or 'not given'})")
    return where, MM[found.pop() if found else "mm"]


def _pose(line: int, cells: list[str], where: dict[str, int], scale: float, width: int, before: Pose | None) -> Pose:
    """One row's pose. Raises ValueError, in words."""
    if len(cells) != width:
        raise ValueError(f"has {len(cells)} cells, and the header {width}")
    value: dict[str, float] = {}
    for column, i in where.items():
        try:
            value[column] = float(cells[i])
        except ValueError:
            value[column] = math.nan
        if not math.isfinite(value[column]):
            raise ValueError(f"{column} must be a number (got {cells[i].strip()!r})")
    if before is not None and value["time"] <= before.time:
        raise ValueError(f"time must increase (got {value['time']:g} after {before.time:g})")
    turn = unit((value["qw"], value["qx"], value["qy"], value["qz"]))
    place = Placement((scale * value["x"], scale * value["y"], scale * value["z"]), turn)
    return Pose(line, value["time"], place)
