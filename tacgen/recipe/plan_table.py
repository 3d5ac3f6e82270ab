"""A plan as a table: aligned text, CSV or JSON."""

import csv
import io
import json
from collections.abc import Iterator, Sequence
from typing import Any

from tacgen.recipe.plan import Plan
from tacgen.recipe.row import Row

MAX_PLAN_TABLE_ROWS = 40  # of the aligned text


def as_text(plan: Plan) -> str:
    """Aligned columns; for a long plan the first rows alone."""
    table = [*_cells(plan, plan.rows[:MAX_PLAN_TABLE_ROWS], short=True)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = ["  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]
    if len(plan.rows) > MAX_PLAN_TABLE_ROWS:
        lines.append(f"... {len(plan.rows) - MAX_PLAN_TABLE_ROWS} more (--csv prints all)")
    return "\n".join(lines) + "\n"


def as_csv(plan: Plan) -> str:
    """All rows with all digits."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(_cells(plan, plan.rows, short=False))
    return text.getvalue()


def as_json(plan: Plan) -> str:
    """All bundles, one a line, with seed, key and values; with several sensors also the number of the pair."""
    rows = (
        {"scene": r.name, "frames": r.frames, "seed": r.seed, "key": r.key, "values": r.values}
        | ({} if r.pair is None else {"pair": r.pair})
        for scene in plan.rows
        for r in scene.bundles
    )
    return f'{{"name": {json.dumps(plan.name)}, "scenes": [\n' + ",\n".join(map(json.dumps, rows)) + "\n]}\n"


def _cells(plan: Plan, rows: Sequence[Row], *, short: bool) -> Iterator[list[str]]:
    paired = any(row.pair is not None for row in rows[:1])
    yield ["scene", *["pair"] * paired, "frames", "seed", *plan.paths]
    for row in rows:
        known = [row.name, *[str(row.pair)] * paired, str(row.frames), str(row.seed)]
        yield [*known, *(_cell(row.values[path], short) for path in plan.paths)]


def _cell(value: Any, short: bool) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if short else repr(value)
    return value if isinstance(value, str) else json.dumps(value)
