"""Figures in prose come from docs/results and stand between marks, none of a bench by hand; pages are short."""

import re
from pathlib import Path

import pytest

from benchmarks import figures

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
WORDS = 35_000  # of all pages in docs
SHORT = {"MECHANICS.md": 2500, "OPTICS.md": 2500, "GPU.md": 2500}  # words, four pages
OF_A_BENCH = (  # what benches measure, and hands once copied
    re.compile(r"\d[\d.,]*(?: to [\d.,]+)? ?(?:dB|frames a second|core-hours|(?:m?s|seconds) a frame)\b"),
    re.compile(r"normals\b[^.|]{0,80}?\d[\d.]* deg"),
)


def by_hand(text: str) -> list[str]:
    """The figures of benches that stand outside of marks."""
    bare = re.sub(r"^```.*?^```$", "", figures.MARK.sub("", text), flags=re.M | re.S)
    return [found for kind in OF_A_BENCH for found in kind.findall(" ".join(bare.split()))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_figures_are_those_of_the_results(page: Path) -> None:
    text = page.read_text()
    assert text == figures.marked(text), "run python -m benchmarks.figures"
    if page.name != "RESULTS.md":  # written from the results itself
        assert by_hand(text) == []


def test_the_checks_see_another_figure_and_one_by_hand() -> None:
    assert figures.marked("<!--=digit_normals-->13.9 deg<!--/-->") != "<!--=digit_normals-->13.9 deg<!--/-->"
    assert by_hand("normals of DIGIT are off by 13.9 deg, at 101 frames a second") == [
        "101 frames a second", "normals of DIGIT are off by 13.9 deg",
    ]  # fmt: skip
    assert by_hand("<!--=gpu_cores-->16 frames a second<!--/-->") == []
    with pytest.raises(KeyError):
        figures.marked("<!--=no_such_figure--><!--/-->")


def test_every_figure_is_used() -> None:
    used = {found[2] for page in PAGES for found in figures.MARK.finditer(page.read_text())}
    assert used == figures.figures().keys()


def words(page: Path) -> int:
    """Words and numbers; not the bars and rules of tables."""
    return sum(bool(re.search(r"\w", word)) for word in page.read_text().split())


def test_the_pages_are_short() -> None:
    assert len(PAGES[0].read_text().splitlines()) < 120
    assert sum(words(page) for page in PAGES[1:]) <= WORDS
    assert [name for name, most in SHORT.items() if words(ROOT / "docs" / name) > most] == []
