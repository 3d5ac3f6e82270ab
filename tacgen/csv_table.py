"""Reading of small CSV tables with a header; problems are reported by line."""

import csv
import math
from pathlib import Path

from tacgen import regular_file
from tacgen.errors import why

LARGEST = 10_000_000  # [bytes]
MOST_MESSAGES = 5  # reported for one table
Rows = list[tuple[int, dict[str, str]]]


def rows(table: Path, needed: tuple[str, ...], either: tuple[str, ...], wrong: list[str]) -> Rows:
    """Rows with their line numbers, each with one cell for every column; names and cells without spaces around them.

    There are none, and problems are added to `wrong`, without all columns `needed` and one of `either`, with two
    columns of one name, or with a row of another length than the header: its cells may be in wrong columns.
    """
    try:
        text = regular_file.read_bytes(table, LARGEST).decode("utf-8-sig")
        reader = csv.reader(text.splitlines(), strict=True)
        found = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader if cells]
    except OSError as error:
        wrong.append(f"{table}: cannot be read: {why(error)}")
        return []
    except (ValueError, csv.Error) as error:
        wrong.append(f"{table}: is no table of comma-separated values: {error}")
        return []
    header = found[0][1] if found else []
    shown = f"(its header: {','.join(header)})"
    missing = [name for name in needed if name not in header]
    if either and not any(name in header for name in either):
        missing.append(" or ".join(either))
    if missing:
        wrong.append(f"{table}: has no column {', '.join(missing)} {shown}")
        return []
    if twice := [name for name in (*needed, *either) if header.count(name) > 1]:
        wrong.append(f"{table}: has more than one column {', '.join(twice)} {shown}")
        return []
    uneven = [(line, len(cells)) for line, cells in found if len(cells) != len(header)]
    for line, count in uneven[:MOST_MESSAGES]:
        wrong.append(f"{table}:{line}: has {count} cells, and the header {len(header)}: is a comma a decimal point?")
    return [] if uneven else [(line, dict(zip(header, cells, strict=True))) for line, cells in found[1:]]


def number(text: str) -> float:
    """A finite number, or nan."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
