"""The values of a sensor, each with its unit and where it comes from: for `tacgen sensor show`."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from tacgen.sensor.base_model import NO_SOURCE, Part
from tacgen.sensor.model import Sensor
from tacgen.sensor.yaml_source import KeyPath, format_path

# Ends of keys, longest first, and their units
KEY_UNITS = {"mm_per_px": "mm/px", "_per_mm": "1/mm", "_mpa": "MPa", "_deg": "deg", "_mm": "mm"}
KEY_UNITS |= {"_px": "px", "_s": "s"}


class Value(NamedTuple):
    """One number, word or list of a sensor file."""

    path: KeyPath
    value: Any
    unit: str  # "" if it has none, or several
    source: str  # of the part that it is in
    default: bool  # the file does not give it


def name_and_unit(key: str) -> tuple[str, str]:
    """The words of a key, and the unit that it names at its end: `size x`, `mm` of size_x_mm; "" where it has none."""
    end = next((end for end in KEY_UNITS if key.endswith(end)), "")
    return key.removesuffix(end).strip("_").replace("_", " "), KEY_UNITS.get(end, "")


def values(part: Part, path: KeyPath = ()) -> Iterator[Value]:
    """Every value of a sensor, defaults too, in the order of the file format; what is absent is left out."""
    source = getattr(part, "source", "")
    inner: list[tuple[KeyPath, Part]] = []
    for name, value in part:
        items = value if isinstance(value, tuple) else ()
        parts = [((*path, name, i), item) for i, item in enumerate(items) if isinstance(item, Part)]
        inner += [((*path, name), value)] if isinstance(value, Part) else parts
        if name == "source" or value is None or isinstance(value, Part) or parts:
            continue
        yield Value((*path, name), value, name_and_unit(name)[1], source, name not in part.model_fields_set)
    for where, other in inner:
        yield from values(other, where)


def as_plain(sensor: Sensor) -> dict[str, Any]:
    """The sensor's name and values as JSON values."""
    rows = [
        {"path": format_path(v.path), "value": v.value, "unit": v.unit, "source": v.source, "default": v.default}
        for v in values(sensor)
    ]
    return {"name": sensor.name, "description": sensor.description, "values": rows}


def as_text(sensor: Sensor) -> str:
    """A block of lines for each part: its path and source, then its values with units; `*` marks defaults."""
    rows = list(values(sensor))
    width = max(len(str(row.path[-1])) for row in rows)
    lines, last = [], None
    for row in rows:
        where = row.path[:-1]
        if where != last and where:
            said = row.source or NO_SOURCE
            lines += ["", f"{format_path(where)}: {' '.join(said.split())}" if row.source else format_path(where)]
        last = where
        text = f"{_text(row.value)} {row.unit}".rstrip()
        lines.append(f"  {row.path[-1]:<{width}}  {text}{'  *' if row.default else ''}")
    return "\n".join([*lines, "", "Each part is followed by the source of its numbers. *: default, not in the file."])


def _text(value: Any) -> str:
    """`4`, `[0.45, 0.45, 0.45]`, `true`"""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)
