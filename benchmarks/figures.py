"""Figures in the prose of README.md and docs: each stands between two marks, and comes from docs/results/*.json.

    python -m benchmarks.figures          # `make bench` runs it, and a test compares

A mark is `<!--=NAME-->value<!--/-->`; docs/results/figures.yaml has the names, and where their values are.
"""

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

from tacgen.sensor.yaml_source import load

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
MARK = re.compile(r"(<!--=(\w+)-->)(.*?)(<!--/-->)", re.S)


@cache
def figures() -> dict[str, Any]:
    """The entries of figures.yaml by their names."""
    data = load(RESULTS / "figures.yaml").data
    assert isinstance(data, dict)
    return data


@cache
def rows(bench: str, title: str) -> list[dict[str, Any]]:
    """The rows of a table of a bench."""
    tables = {table["title"]: table for table in json.loads((RESULTS / f"{bench}.json").read_text())["tables"]}
    return [dict(zip(tables[title]["columns"], row, strict=True)) for row in tables[title]["rows"]]


def value(name: str) -> str:
    """The text of a figure: "4.0 deg", or "0.5 to 0.7 %".

    Raises:
        KeyError: there is no figure of that name, or no value of it.
    """
    figure = figures()[name]
    found = [
        row[figure["column"]]
        for row in rows(figure["bench"], figure["table"])
        if all(row[key] == cell for key, cell in figure["where"].items()) and row[figure["column"]] is not None
    ]
    if not found:
        raise KeyError(name)
    unit, digits = figure.get("unit", ""), figure.get("digits")
    scale = 100 if unit == "%" else 1
    texts = [str(end) if digits is None else f"{end * scale:.{digits}f}" for end in (min(found), max(found))]
    return " to ".join(dict.fromkeys(texts)) + (f" {unit}" if unit else "")


def marked(text: str) -> str:
    """A page with its figures as docs/results has them."""
    return MARK.sub(lambda found: f"{found[1]}{value(found[2])}{found[4]}", text)


def main() -> None:
    """Write the figures of docs/results into README.md and the pages of docs."""
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        page.write_text(marked(page.read_text()))


if __name__ == "__main__":
    main()
