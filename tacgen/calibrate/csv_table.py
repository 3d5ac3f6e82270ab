"""Reading of small CSV tables with a header; problems are reported by line."""

import csv
import math
from pathlib import Path

from tacgen import regular_file
from tacgen.errors import why

LARGEST = 10_000_000  # [bytes]
Rows = list[tuple[int, dict[str, str]]]


def rows(table: Path, needed: tuple[str, ...], either: tuple[str, ...], wrong: list[str]) -> Rows:
    """Rows with their line numbers. Without all columns `needed` and one of `either` there are none, and the problem
    is added to `wrong`."""
    try:
        text = regular_file.read_bytes(table, LARGEST).decode("utf-8-sig")
        reader = csv.DictReader(text.splitlines(), strict=True)
        header = [name.strip() for name in reader.fieldnames or ()]
        reader.fieldnames = header
        found = [(reader.line_num, row) for row in reader]
    except OSError as error:
        wrong.append(f"{table}: cannot be read: {why(error)}")
        return []
    except (ValueError, csv.Error) as error:
        wrong.append(f"{table}: is no table of comma-separated values: {error}")
        return []
    missing = [name for name in needed if name not in header]
    if either and not any(name in header for name in either):
        missing.append(" or ".join(either))
    if missing:
        wrong.append(f"{table}: has no column {', '.join(missing)} (its header: {','.join(header)})")
        return []
    return found


def number(text: str | None) -> float:
    """A finite number, or nan."""
    try:
        value = float(text or "")
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
