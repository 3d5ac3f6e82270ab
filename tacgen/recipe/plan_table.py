"""A plan as a table: aligned text, CSV or JSON."""

import csv
import io
import json
from collections.abc import Iterator, Sequence
from typing import Any

from tacgen.recipe.plan import Plan
from tacgen.recipe.row import Row
from tacgen.sensor.yaml_source import shortest_ends

MAX_PLAN_TABLE_ROWS = 40  # of the aligned text, in all its blocks
MIN_PLAN_TABLE_ROWS = 8  # of each block


def as_text(plan: Plan, width: int) -> str:
    """Aligned columns, in blocks of at most `width` characters below each other; for a long plan the first rows alone.

    A varied path is headed by as much of its end as makes it unique.
    """
    known, *rows = _cells(plan, plan.rows[:MAX_PLAN_TABLE_ROWS], short=True)
    heads = [*known[: len(known) - len(plan.paths)], *shortest_ends(plan.paths).values()]
    columns = [[_cut(cell, width // 2) for cell in column] for column in zip(heads, *rows, strict=True)]
    widths = [max(map(len, column)) for column in columns]
    blocks, left = [[0]], width - widths[0]
    for i in range(1, len(columns)):
        if (left := left - 2 - widths[i]) < 0 and len(blocks[-1]) > 1:
            blocks.append([0])
            left = width - widths[0] - 2 - widths[i]
        blocks[-1].append(i)
    shown = min(len(rows), max(MIN_PLAN_TABLE_ROWS, MAX_PLAN_TABLE_ROWS // len(blocks)))
    tables = [
        "\n".join("  ".join(columns[i][k].rjust(widths[i]) for i in block) for k in range(shown + 1))
        for block in blocks
    ]
    if len(plan.rows) > shown:
        tables[-1] += f"\n... {len(plan.rows) - shown} more (--csv prints all)"
    return "\n\n".join(tables) + "\n"


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 3] + "..."


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
    if short and isinstance(value, dict):
        parts = ((key, _cell(part, short), isinstance(part, dict)) for key, part in value.items())
        return " ".join(f"{key} ({cell})" if inner else f"{key}={cell}" for key, cell, inner in parts)
    return value if isinstance(value, str) else json.dumps(value)
