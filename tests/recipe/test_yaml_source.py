"""Positions and plain values; malformed files become one line, never a traceback."""

from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacgen.base.errors import UserError
from tacgen.sensor.yaml_source import Mark, Source, Tree, edited, format_path, load, parse, parse_path

TEXT = """\
a: 1
b:
  - press: {depth_mm: -1, frames: 5}
  - x
c: &k {q: 1e5, r: no, t: true}
d: {<<: *k, q: 2}
e:
"""


def read(text: str) -> Tree:
    return parse(text, Source("r.yaml", tuple(text.splitlines()) or ("",)))


def test_a_file_is_parsed_once_and_each_reader_has_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: {b: 1}")
    load(path).data["a"]["b"] = 2
    monkeypatch.setattr("tacgen.sensor.yaml_source.parse", None)
    assert load(path).data == {"a": {"b": 1}}
    path.write_text("a: {b: 3}")
    with pytest.raises(TypeError):
        load(path)


def test_values_are_those_of_yaml_1_2():
    assert read(TEXT).data == {
        "a": 1,
        "b": [{"press": {"depth_mm": -1, "frames": 5}}, "x"],
        "c": {"q": 1e5, "r": "no", "t": True},
        "d": {"q": 2, "r": "no", "t": True},
        "e": None,
    }


@pytest.mark.parametrize(
    ("path", "key", "value"),
    [
        ("a", (0, 0), (0, 3)),
        ("b", (1, 0), (2, 2)),
        ("b[0].press", (2, 4), (2, 11)),
        ("b[0].press.depth_mm", (2, 12), (2, 22)),
        ("b[1]", (3, 4), (3, 4)),
        ("c.r", (4, 15), (4, 18)),
        ("e", (6, 0), (6, 0)),
        ("b[0].press.nothing", (2, 4), (2, 11)),  # not written: what is around it
    ],
)
def test_every_key_and_value_knows_its_place(path, key, value):
    spot = read(TEXT).spot(parse_path(path))
    assert (spot.key.line, spot.key.column) == key
    assert (spot.value.line, spot.value.column) == value


def test_a_mark_shows_the_line_and_a_caret_below_the_place():
    spot = read(TEXT).spot(parse_path("b[0].press.depth_mm"))
    head, line, caret = spot.value.point("no").split("\n")
    assert head == "r.yaml:3:23: no"
    assert line.endswith("- press: {depth_mm: -1, frames: 5}")
    assert line[caret.index("^") :].startswith("-1")
    assert Mark(Source("--set a=1")).point("no") == "--set a=1: no", "a source without lines is named only"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: 1\na: 2\n", "r.yaml:2:1: a: this key is there twice"),
        ("a: [1,2\nb: 2", "r.yaml:2:2: expected"),
        ("\t- a", "r.yaml:1:1: found character"),
        ("a: *x", "r.yaml:1:4: found undefined alias 'x'"),
        ("&a [*a]", "an alias refers to the mapping or list around it"),
        ("{1: 2}", "r.yaml:1:2: a key must be a word (got 1)"),
        ("--- 1\n--- 2\n", "r.yaml:2:1: a second document starts here"),
        ("a: !foo bar", "r.yaml:1:4: a TaggedScalar cannot stand here"),
        ("a: \x07", "r.yaml: is not YAML"),
        ("a: !!int x", "r.yaml: is not YAML that can be read here"),
        ("[" * 800, "r.yaml"),
    ],
)
def test_invalid_yaml_is_reported_in_one_line(text, says):
    with pytest.raises(UserError) as caught:
        read(text)
    assert caught.value.lines[0].startswith(says) or says in caught.value.lines[0]
    assert [line for line in caught.value.lines if not line.startswith("    ")] == [caught.value.lines[0]]


def test_aliases_cannot_fill_the_memory():
    text = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
    for this, last in zip("bcdefgh", "abcdefg", strict=True):
        text += f"{this}: &{this} [{', '.join([f'*{last}'] * 10)}]\n"
    with pytest.raises(UserError, match="too many values"):
        read(text)


@pytest.mark.parametrize(
    ("content", "says"),
    [(None, "no such file"), (b"\x80\x81\xff\x00", "is not a text file"), (b"a\0b", "is not a text file"),
     ("folder", "is a folder")],
)  # fmt: skip
def test_a_file_that_is_no_text_is_one_line(tmp_path: Path, content: bytes | str | None, says: str):
    path = tmp_path / "r.yaml"
    if content == "folder":
        path.mkdir()
    elif isinstance(content, bytes):
        path.write_bytes(content)
    with pytest.raises(UserError) as caught:
        load(path)
    assert len(caught.value.lines) == 1
    assert says in caught.value.lines[0]


@given(st.text(max_size=60))
def test_no_text_breaks_the_reader(text: str):
    with suppress(UserError):
        read(text)


@given(st.lists(st.one_of(st.integers(0, 99), st.from_regex(r"[a-z_]{1,8}", fullmatch=True)), max_size=6))
def test_paths_survive_being_written(steps: list):
    path = ("root", *steps)
    assert parse_path(format_path(path)) == path


@pytest.mark.parametrize("text", ["", "a.", ".a", "a[b]", "a b", "a[-1]", "[0]", "a..b", "ä"])
def test_an_invalid_path_is_refused(text: str):
    with pytest.raises(ValueError, match="is not a path"):
        parse_path(text)


def test_merging_keeps_the_place_of_what_won():
    base, over = read("a: {x: 1, y: 2}\nb: [1, 2]\n"), read("\na: {y: 3}\nb: [4]\n")
    merged = base.merged(over)
    assert merged.data == {"a": {"x": 1, "y": 3}, "b": [4]}
    assert merged.spot(("a", "x")).value.line == 0
    assert merged.spot(("a", "y")).value.line == 1
    assert ("b", 1) not in merged.spots
    assert base.data["a"]["y"] == 2, "the original was edited"
    base = read("vary: {samples: 3, over: {a.b: {uniform: [1, 2]}, c: {choice: [1]}}}")
    merged = base.merged(read("vary: {over: {a.b: {choice: [5]}}}")).data["vary"]  # another distribution, as a whole
    assert merged == {"samples": 3, "over": {"a.b": {"choice": [5]}, "c": {"choice": [1]}}}


def test_values_are_replaced_in_place_and_comments_stay(tmp_path: Path):
    path = tmp_path / "a.yaml"
    path.write_text("# top\nleds:\n  - name: red  # one\n    size: [1, 2]\n    source: x\n    old: 3\n# end\n")
    led = {("leds", 0, "size"): [0.5, 4], ("leds", 0, "old"): None, ("leds", 0, "new"): 1.5}
    text = edited(path, led | {("rows",): [[1, 2], [3]]})
    assert text.startswith("# top\nleds:\n  - name: red  # one\n    size: [0.5, 4]\n    new: 1.5\n    source: x\n")
    path.write_text(text)
    assert load(path).data["rows"] == [[1, 2], [3]]
    assert "old" not in load(path).data["leds"][0]
    assert "- [1, 2]" in text
