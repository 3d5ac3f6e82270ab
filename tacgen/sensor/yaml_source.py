"""YAML 1.2 as plain values, with the position of every key and value in the file.

PyYAML is not used: it reads 1e5 as a string and `no` as False, and takes duplicate keys silently.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from tacgen.base import regular_file
from tacgen.base.errors import UserError, why

KeyPath = tuple[str | int, ...]
MAX_YAML_BYTES = 10_000_000  # largest file [bytes]
MAX_INTEGER_BITS = 1024  # of an integer; a larger one does not fit into a float
MAX_YAML_VALUES = 100_000  # in a file; aliases can expand a small file without bound
# keys that choose a mapping's other keys; their defaults
CHOICE_KEYS = {"shape": None, "law": "neo_hooke", "layout": "grid"}


@dataclass(frozen=True)
class Source:
    """Where values are written: a file, or one `--set` of the command line."""

    name: str
    lines: tuple[str, ...] = ()
    folder: Path | None = None  # to which paths in it are relative; None: the working directory


@dataclass(frozen=True)
class Mark:
    """A position in a source; line and column count from 0."""

    source: Source
    line: int = 0
    column: int = 0

    def point(self, message: str) -> str:
        """`file:line:column: message`, then the line itself and a caret under the place."""
        if not self.source.lines:
            return f"{self.source.name}: {message}"
        head = f"{self.source.name}:{self.line + 1}:{self.column + 1}: {message}"
        if self.line >= len(self.source.lines):
            return head
        text = self.source.lines[self.line].rstrip()
        before = "".join(c if c == "\t" else " " for c in text[: self.column].ljust(self.column))
        return f"{head}\n    {text}\n    {before}^" if text.strip() else head


@dataclass(frozen=True)
class Spot:
    """Positions of a key and its value; an item of a list has no key of its own."""

    key: Mark
    value: Mark


@dataclass(frozen=True)
class Tree:
    """Plain values (dict, list, str, int, float, bool, None), and the spot of each path in the file."""

    data: Any
    spots: dict[KeyPath, Spot] = field(default_factory=dict)

    def spot(self, path: KeyPath) -> Spot:
        """The spot of `path`; if it was not written, that of the nearest mapping or list around it."""
        for length in range(len(path), -1, -1):
            if path[:length] in self.spots:
                return self.spots[path[:length]]
        return Spot(*[Mark(Source("recipe"))] * 2)

    def replaced(self, path: KeyPath, other: "Tree") -> "Tree":
        """A copy with `other` at `path`; missing mappings are created, lists must be long enough.

        Raises:
            LookupError: the path leads through a scalar or past the end of a list.
        """
        data = put(self.data, path, other.data)
        spots = {p: s for p, s in self.spots.items() if p[: len(path)] != path}
        created = [path[:n] for n in range(1, len(path)) if at(self.data, path[:n]) is None]
        spots.update({up: other.spot(()) for up in created})
        spots.update({path + p: s for p, s in other.spots.items()})
        return Tree(data, spots)

    def merged(self, other: "Tree", path: KeyPath = ()) -> "Tree":
        """A copy with `other` laid over `path`: mappings merge key by key, anything else is replaced.

        Two mappings are replaced as a whole: one with another value of CHOICE_KEYS, and the distribution of a varied
        path.
        """
        mine = at(self.data, path)
        choice = len(path) == 3 and path[:2] in (("vary", "over"), ("vary", "grid"))
        if choice or _other_kind(mine, other.data) or not isinstance(mine, dict) or not isinstance(other.data, dict):
            return self.replaced(path, other)
        result = self
        for key in other.data:
            result = result.merged(other.under((key,)), (*path, key))
        return result

    def under(self, path: KeyPath) -> "Tree":
        """The part of the tree at `path`."""
        n = len(path)
        return Tree(at(self.data, path), {p[n:]: s for p, s in self.spots.items() if p[:n] == path})

    def without(self, key: str) -> "Tree":
        """A copy without one top-level key."""
        data = {k: v for k, v in self.data.items() if k != key}
        return Tree(data, {p: s for p, s in self.spots.items() if p[:1] != (key,)})


def _other_kind(mine: Any, other: Any) -> bool:
    """Whether two mappings differ in one of CHOICE_KEYS that `other` gives."""
    if not isinstance(mine, dict) or not isinstance(other, dict):
        return False
    return any(tag in other and other[tag] != mine.get(tag, usual) for tag, usual in CHOICE_KEYS.items())


def at(data: Any, path: KeyPath) -> Any:
    """The value at `path`, or None."""
    for step in path:
        there = isinstance(data, list) and isinstance(step, int) and 0 <= step < len(data)
        if there or (isinstance(data, dict) and step in data):
            data = data[step]
        else:
            return None
    return data


def put(data: Any, path: KeyPath, value: Any) -> Any:
    """A copy of plain `data` with `value` at `path`. Raises LookupError: a step of the path does not exist."""
    if not path:
        return value
    step, rest = path[0], path[1:]
    if isinstance(step, int):
        if not isinstance(data, list):
            raise LookupError(f"[{step}] needs a list, and there is {describe(data)}")
        if not 0 <= step < len(data):
            raise LookupError(f"[{step}] is past the end: there are {len(data)} entries, counted from 0")
        return [put(item, rest, value) if i == step else item for i, item in enumerate(data)]
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise LookupError(f"{step} needs a mapping, and there is {describe(data)}")
    return {**data, step: put(data.get(step), rest, value)}


def branches(data: Any) -> Iterable[tuple[str | int, Any]]:
    """The steps from a mapping or list and what is there; nothing for any other value."""
    return data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list | tuple) else ()


def leaves(data: Any, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Any]]:
    """Path and value of every number and text, and of every empty mapping and list."""
    inside = [leaf for step, value in branches(data) for leaf in leaves(value, (*path, step))]
    yield from inside or [(path, data)]


def describe(value: Any) -> str:
    """A value for an error message, short and in YAML's notation."""
    if value is None:
        return "nothing"
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return repr(value if len(value) <= 40 else value[:37] + "...")
    return format(value, ".10g") if isinstance(value, float) else str(value)


def format_path(path: KeyPath) -> str:
    """('trajectory', 0, 'press') -> trajectory[0].press; a key that contains dots is put in brackets."""
    text = ""
    for step in path:
        if isinstance(step, int) or not re.fullmatch(r"[^.\[\]]+", step):
            text += f"[{step}]"
        else:
            text += f".{step}" if text else step
    return text


@cache
def parse_path(text: str) -> KeyPath:
    """trajectory[0].press -> ('trajectory', 0, 'press'). Raises ValueError, in words, for anything else."""
    if not re.fullmatch(r"\w+(\[\d+\])*(\.\w+(\[\d+\])*)*", text, re.ASCII):
        raise ValueError(f"{text!r} is not a path such as trajectory[0].press.depth_mm")
    return tuple(int(n) if n else name for n, name in re.findall(r"\[(\d+)\]|(\w+)", text))


def is_within(path: KeyPath, up: KeyPath) -> bool:
    """Whether a path is another one, or lies in it."""
    return path[: len(up)] == up


def parents_first(paths: Iterable[str]) -> list[str]:
    """Paths in an order in which values can be put in: one that lies in another one after that, otherwise as given."""
    return sorted(paths, key=lambda text: text.count(".") + text.count("["))


def shortest_ends(paths: Iterable[str]) -> dict[str, str]:
    """Path -> its shortest end, from a key on, that no other path has: `depth_mm`, `leds[0].power`."""
    ends = {path: [path.split(".")[-n:] for n in range(1, path.count(".") + 2)] for path in paths}
    every = [end for own in ends.values() for end in own]
    return {path: ".".join(next((end for end in own if every.count(end) == 1), own[-1])) for path, own in ends.items()}


def load(path: Path) -> Tree:
    """Read a YAML file. Raises UserError: it cannot be read, is not text or not YAML, or has a key twice."""
    kept = _parsed(text_of(path), str(path), path.parent)
    return Tree(deepcopy(kept.data), kept.spots)


def text_of(path: Path) -> str:
    """The text of a YAML file. Raises UserError: it cannot be read, or is not text."""
    try:
        text = regular_file.read_bytes(path, MAX_YAML_BYTES).decode("utf-8-sig").replace("\r\n", "\n")
    except FileNotFoundError:
        raise UserError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise UserError(f"{path}: is a folder, not a file") from None
    except UnicodeDecodeError:
        text = "\0"
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read: {why(error)}") from None
    if "\0" in text:
        raise UserError(f"{path}: is not a text file (UTF-8)")
    return text


@lru_cache(maxsize=16)
def _parsed(text: str, name: str, folder: Path) -> Tree:
    """The tree of a file's text. It is kept: parsing a sensor file takes 60 ms, and each plan reads one."""
    return parse(text, Source(name, tuple(text.splitlines()) or ("",), folder))


def edited(path: Path, changes: Mapping[KeyPath, Any]) -> str:
    """The text of a YAML file with other values at some paths and its comments kept; None removes a key."""
    from io import StringIO

    from ruamel.yaml import YAML
    from ruamel.yaml.comments import CommentedSeq

    yaml = YAML(typ="rt")
    yaml.indent(mapping=2, sequence=4, offset=2)
    yaml.width = 4096  # no line is wrapped
    root = yaml.load(text_of(path))

    def written(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: written(item) for key, item in value.items()}
        if not isinstance(value, list):
            return value
        rows = any(isinstance(item, list) for item in value)
        made = CommentedSeq([written(item) for item in value])
        (made.fa.set_block_style if rows else made.fa.set_flow_style)()
        return made

    for (*way, last), value in changes.items():
        node: Any = root
        for step in way:
            node = node[step]
        if value is None:
            node.pop(last, None)
        elif isinstance(last, int) or last in node or "source" not in node:
            node[last] = written(value)
        else:  # a new key goes before `source`, which is last
            node.insert([*node].index("source"), last, written(value))
    out = StringIO()
    yaml.dump(root, out)
    return out.getvalue()


def dumped(data: Any) -> str:
    """Plain values as YAML in block style. Every text is quoted: readers of YAML 1.1 take a plain `no` for False."""
    from io import StringIO

    from ruamel.yaml import YAML
    from ruamel.yaml.scalarstring import DoubleQuotedScalarString

    def quoted(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: quoted(part) for key, part in value.items()}
        if isinstance(value, list):
            return [quoted(part) for part in value]
        return DoubleQuotedScalarString(value) if isinstance(value, str) else value

    yaml, out = YAML(typ="rt"), StringIO()
    yaml.width = 2**16
    yaml.dump(quoted(data), out)
    return out.getvalue()


def quoted(path: Path) -> str:
    """A path as YAML in one line. Raises UserError: it is no text, as the names of files may be."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise UserError(f"{path}: is no text (UTF-8), which a recipe could hold: rename it") from None
    return dumped([str(path)]).removeprefix("- ").rstrip("\n")


def parse(text: str, source: Source) -> Tree:
    """Parse YAML text; marks refer to `source`. Raises UserError as `load` does."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        node = YAML(typ="rt").load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = Mark(source, mark.line, mark.column) if mark else Mark(source)
        raise UserError(place.point(_one_line(error.problem or error.context or "is not YAML"))) from None
    except YAMLError as error:
        raise UserError(f"{source.name}: is not YAML: {_one_line(str(error))}") from None
    except RecursionError:
        raise UserError(f"{source.name}: is nested too deeply") from None
    except (ValueError, TypeError, AssertionError, AttributeError, NotImplementedError, LookupError) as error:
        # ruamel raises these for some malformed scalars and tags
        raise UserError(f"{source.name}: is not YAML that can be read here: {_one_line(str(error))}") from None
    spots: dict[KeyPath, Spot] = {(): Spot(Mark(source), Mark(source))}
    budget = iter(range(MAX_YAML_VALUES))
    return Tree(_plain(node, (), spots, budget, ()), spots)


def _one_line(problem: str) -> str:
    """The parser's error message in one line."""
    first = " ".join(problem.split("\n")[0].split())
    if first == "but found another document":
        return "a second document starts here, and one file holds one"
    match = re.match(r'found duplicate key "(.*?)"', first)
    return f"{match[1]}: this key is there twice" if match else first or "is not YAML"


def _plain(node: Any, path: KeyPath, spots: dict[KeyPath, Spot], budget: Iterator[int], inside: tuple[int, ...]) -> Any:
    """ruamel's round-trip value as plain data; the spots of all paths below `path` are added to `spots`."""
    import datetime

    here = spots[path].value
    if next(budget, None) is None or len(path) > 100:
        raise UserError(here.point("too many values, or nested too deeply"))
    if id(node) in inside:
        raise UserError(here.point("an alias refers to the mapping or list around it"))
    inside = (*inside, id(node))
    if isinstance(node, dict):
        lines = getattr(node, "lc", None)
        for key in node:
            where = ((lines.data or {}) if lines else {}).get(key)
            key_mark = Mark(here.source, where[0], where[1]) if where else here
            value_mark = Mark(here.source, where[2], where[3]) if where and node[key] is not None else key_mark
            if not isinstance(key, str):
                raise UserError(key_mark.point(f"a key must be a word (got {describe(key)})"))
            spots[(*path, str(key))] = Spot(key_mark, value_mark)
        return {str(key): _plain(value, (*path, str(key)), spots, budget, inside) for key, value in node.items()}
    if isinstance(node, list):
        lines = getattr(node, "lc", None)
        for i in range(len(node)):
            where = ((lines.data or {}) if lines else {}).get(i)
            mark = Mark(here.source, where[0], where[1]) if where else here
            spots[(*path, i)] = Spot(mark, mark)
        return [_plain(value, (*path, i), spots, budget, inside) for i, value in enumerate(node)]
    if node is None or isinstance(node, bool):
        return node
    if type(node).__name__ == "ScalarBoolean":
        return bool(node)
    if isinstance(node, int) and node.bit_length() > MAX_INTEGER_BITS:
        raise UserError(here.point("is too large a number"))
    for kind in (int, float, str):
        if isinstance(node, kind):
            return kind(node)
    if isinstance(node, datetime.date):
        return str(node)
    kind_name = type(node).__name__
    raise UserError(here.point(f"a {kind_name} cannot stand here: only text, numbers, lists and mappings can"))
