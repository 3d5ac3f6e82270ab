"""Print docs/BUNDLE.md, generated from tacgen/outputs: python scripts/bundle_page.py > docs/BUNDLE.md"""

from pathlib import Path

import numpy as np

from tacgen.bundle.schema import BUNDLE_ATTRS, BUNDLE_FORMAT, OPTIONAL_ATTRS, UNIT_SYSTEM
from tacgen.outputs import OUTPUTS
from tacgen.outputs.base import Entry

PROSE = Path(__file__).with_suffix(".md")  # the page's first part


def _line(path: str, row: Entry) -> str:
    shape = ", ".join(str(d).replace("*", "\\*").replace("|", " or ") for d in row.dims)
    kind = ", ".join(filter(None, [np.dtype(row.dtype).name.replace("float64", ""), row.rounding]))
    return f"| `{path}` | ({shape}) | {kind} | {'' if row.units == '1' else row.units} | {row.long_name} |"


def page() -> str:
    """The text of docs/BUNDLE.md."""
    lines = [PROSE.read_text().rstrip().replace("{FORMAT}", str(BUNDLE_FORMAT)).replace("{UNITS}", UNIT_SYSTEM)]
    told: set[str] = set()
    for name, output in OUTPUTS.items():
        lines += ["", f"### `{name}`", "", f"{output.text[0].upper()}{output.text[1:]}.", ""]
        lines += ["| path | shape | type | unit | what |", "|---|---|---|---|---|"]
        lines += [_line(path, row) for path, row in output.rows.items() if path not in told]
        told |= output.rows.keys()
    lines += ["", "## Attributes of the file", "", "| name | type | what |", "|---|---|---|"]
    lines += [f"| `{name}` | {kind.__name__} | {text} |" for name, (kind, text) in BUNDLE_ATTRS.items()]
    lines += [f"| `{name}` (optional) | {kind.__name__} | {text} |" for name, (kind, text) in OPTIONAL_ATTRS.items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
