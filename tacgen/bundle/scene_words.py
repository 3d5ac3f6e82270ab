"""A scene's indenter and sensor in words, from its recipe and its attributes."""

import re
from collections.abc import Mapping
from typing import Any


def shape_text(indenter: dict[str, Any]) -> str:
    """The indenter of a recipe in words, such as `sphere, radius 4 mm`."""
    fields = dict(indenter)
    shape = fields.pop("shape", "indenter")
    words = [re.split(r"[/\\]", re.sub(r"\.(stl|obj|ply)$", "", str(fields.pop("file", shape)), flags=re.I))[-1]]
    for name in ("sha256", "up"):
        fields.pop(name, None)
    if fields.get("scale") == 1:
        del fields["scale"]
    for name, value in fields.items():
        what, _, unit = name.rpartition("_") if "_" in name else (name, "", "")
        number = f"{what.replace('_', ' ')} {rounded(value)} {unit}".rstrip() if isinstance(value, int | float) else ""
        words.append(number or f"{value}")
    return ", ".join(words)


def finger_text(attrs: Mapping[str, Any]) -> str:
    """The sensor of a bundle by its attributes: `digit`; of a grasp `digit (right finger)`."""
    finger = f" ({attrs['finger']} finger)" if "finger" in attrs else ""
    return f"{attrs['sensor']}{finger}"


def rounded(value: float) -> str:
    """A number with three significant digits, or to the nearest whole one: `0.524`, `1235`."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
