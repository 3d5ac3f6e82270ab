"""A plan as a table: for a person, a spreadsheet or a program."""

import csv
import io
import json
from typing import Any

from tacgen.recipe.plan import Plan

MAX_ROWS = 40  # of the table for a person


def as_text(plan: Plan) -> str:
    """Aligned columns; of a long plan the first rows."""
    head, *rows = _cells(plan, short=True)
    rows = rows[:MAX_ROWS]
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    lines = ["  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]]
    if len(plan.rows) > MAX_ROWS:
        lines.append(f"... {len(plan.rows) - MAX_ROWS} more (--csv prints all)")
    return "\n".join(lines) + "\n"


def as_csv(plan: Plan) -> str:
    """Every row, every digit."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(_cells(plan, short=False))
    return text.getvalue()


def as_json(plan: Plan) -> str:
    """Every row, of a grasp both bundles, with its seed, key and values; its pair where there are several sensors."""
    rows = [
        {"scene": r.name, "frames": r.frames, "seed": r.seed, "key": r.key, "values": r.values}
        | ({} if r.pair is None else {"pair": r.pair})
        for scene in plan.rows
        for r in scene.bundles
    ]
    return json.dumps({"name": plan.name, "scenes": rows}, indent=1) + "\n"


def _cells(plan: Plan, *, short: bool) -> list[list[str]]:
    paired = any(row.pair is not None for row in plan.rows)
    table = [["scene", *["pair"] * paired, "frames", "seed", *plan.paths]]
    for row in plan.rows:
        known = [row.name, *[str(row.pair)] * paired, str(row.frames), str(row.seed)]
        table.append([*known, *(_cell(row.values[path], short) for path in plan.paths)])
    return table


def _cell(value: Any, short: bool) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if short else repr(value)
    return value if isinstance(value, str) else json.dumps(value)
