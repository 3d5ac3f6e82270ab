"""Write the figures of docs/results into README.md, between its two marker lines.

    python -m benchmarks.readme_figures

`make bench` runs it; a test compares README.md with RESULTS.md.
"""

from pathlib import Path

from benchmarks import summary

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- figures: written by make bench -->\n", "<!-- end of figures -->"


def main() -> None:
    readme = ROOT / "README.md"
    text = readme.read_text()
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    if not tail:
        raise SystemExit("README.md has no place for figures")
    readme.write_text(f"{head}{BEGIN}{summary.short(ROOT / 'docs' / 'results')}\n{END}{tail}")


if __name__ == "__main__":
    main()
