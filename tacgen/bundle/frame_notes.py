"""Lines among a bundle's notes that say why a frame is not as its table asks: `frame 7: ...`, counted from 1."""

import json
import re
from collections.abc import Sequence

from tacgen.bundle.bundle import Bundle

FRAME_NOTE = re.compile(r"frame (\d+): (.+)", re.DOTALL)


def line(index: int, note: str) -> str:
    """The line on a frame, whose index counts from 0."""
    return f"frame {index + 1}: {note}"


def of(bundle: Bundle) -> list[str]:
    """What the notes say of each stored frame, "" where it is as asked."""
    found = [""] * bundle.frames
    for note in json.loads(bundle.attrs.get("notes", "[]")):
        if (said := FRAME_NOTE.fullmatch(note)) and 0 < int(said[1]) <= len(found):
            found[int(said[1]) - 1] = said[2]
    return found


def summary(lines: Sequence[str], frames: int) -> list[str]:
    """One line for all of them, with the first; none if there are none."""
    if not lines:
        return []
    return [f"{len(lines)} of {frames} frames are not as the table asks; the first: {lines[0]}"]
