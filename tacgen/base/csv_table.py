"""CSV tables with a header: reading, with problems by line, and numbers of a column as text."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from tacgen.base import regular_file
from tacgen.base.errors import why

MAX_TABLE_BYTES = 10_000_000  # [bytes]
MAX_TABLE_VALUE = 1e100  # what is plotted and summed must not overflow
MAX_TABLE_MESSAGES = 5  # reported for one table
Record = tuple[int, list[str]]  # number of a line from 1, and its cells without spaces around them
Rows = list[tuple[int, dict[str, str]]]


def records(content: bytes, comments: tuple[str, ...] = ()) -> tuple[list[Record], list[tuple[int, str]]]:
    """Header and rows of a table, and what is wrong with other lines: a number and a message each.

    Empty lines and those that begin with one of `comments` are skipped.

    Raises:
        ValueError: it is not a text file, or its header cannot be read.
    """
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        lines = ["\0"]
    if any("\0" in line for line in lines):
        raise ValueError("is not a text file (UTF-8)")
    read: list[Record] = []
    wrong: list[tuple[int, str]] = []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.startswith(comments):
            continue
        try:
            cells = [cell.strip() for cell in next(csv.reader([line], strict=True))]
        except csv.Error as error:
            if not read:
                raise ValueError(f"line {number}: is no line of CSV: {error}") from None
            wrong.append((number, f"is no line of CSV: {error}"))
            continue
        width = len(read[0][1]) if read else len(cells)
        if len(cells) != width:
            wrong.append((number, f"has {len(cells)} cells, and the header {width}: is a comma a decimal point?"))
        else:
            read.append((number, cells))
    return read, wrong


def rows(table: Path, needed: tuple[str, ...], either: tuple[str, ...], wrong: list[str]) -> Rows:
    """Rows with their line numbers, each with one cell for every column.

    There are none, and problems are added to `wrong`, without all columns `needed` and one of `either`, with two
    columns of one name, or with a row of another length than the header: its cells may be in wrong columns.
    """
    try:
        read, uneven = records(regular_file.read_bytes(table, MAX_TABLE_BYTES))
    except OSError as error:
        wrong.append(f"{table}: cannot be read: {why(error)}")
        return []
    except ValueError as error:
        wrong.append(f"{table}: {error}")
        return []
    header = read[0][1] if read else []
    shown = f"(its header: {','.join(header)})"
    missing = [name for name in needed if name not in header]
    if either and not any(name in header for name in either):
        missing.append(" or ".join([", ".join(either[:-1]), either[-1]]) if either[1:] else either[0])
    if missing:
        wrong.append(f"{table}: has no column {', '.join(missing)} {shown}")
        return []
    if twice := [name for name in (*needed, *either) if header.count(name) > 1]:
        wrong.append(f"{table}: has more than one column {', '.join(twice)} {shown}")
        return []
    wrong += few([f"{table}:{line}: {said}" for line, said in uneven])
    return [] if uneven else [(line, dict(zip(header, cells, strict=True))) for line, cells in read[1:]]


def few(messages: list[str]) -> list[str]:
    """The first messages about a table's lines, and how many more there are."""
    more = len(messages) - MAX_TABLE_MESSAGES
    return [*messages[:MAX_TABLE_MESSAGES], f"and {more} more lines"] if more > 0 else messages


def numerals(values: Sequence[float], digits: int) -> list[str]:
    """Numbers of a column with `digits` significant digits, or as many more as keep different ones apart: times may be
    seconds since 1970."""
    count = len(set(values))
    made = ([f"{value:.{n}g}" for value in values] for n in range(digits, 18))
    return next((texts for texts in made if len(set(texts)) == count), [*map(repr, values)])


def number(text: str) -> float:
    """A number below MAX_TABLE_VALUE, or nan."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if abs(value) < MAX_TABLE_VALUE else math.nan
