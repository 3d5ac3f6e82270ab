"""Captions: a scene described in words, from its recipe and its contact events.

A sphere, radius 4 mm, on gelsight_mini: pressed 1 mm deep, slid 1 mm along x. Touching from frame 0, partly slipping
from frame 5, sliding from frame 9. The largest force is 3.31 N, in frame 4.
"""

from typing import Any, NamedTuple

import numpy as np

from tacgen.bundle.bundle import Bundle
from tacgen.bundle.scene_words import finger_text, rounded, shape_text
from tacgen.outputs.contact_modes import CONTACT_MODES

EVENT_MODE_PATH = "/frames/events/mode"
SEGMENT_VERBS = {  # of an instruction, after the first contact
    "hold": "hold",
    "slide": "slide",
    "twist": "twist",
    "tilt": "tilt",
    "lift": "lift",
    "release": "release",
    "replay": "move",
}


class Change(NamedTuple):
    """A change of the contact mode: its first frame, the mode, and the time [s] if frames have one."""

    frame: int
    mode: str
    time: float | None


def caption(bundle: Bundle) -> str:
    """The scene in a few sentences, with its contact events if they are among the outputs."""
    said = [scene_text(bundle)]
    if events := changes(bundle):
        text = ", ".join(f"{change.mode} from frame {change.frame}{_at(change.time)}" for change in events)
        said.append(text[0].upper() + text[1:])
    if bundle.frames:
        force = np.linalg.norm(bundle["/frames/force"], axis=1)
        said.append(f"The largest force is {force.max():.3g} N, in frame {force.argmax()}")
    return ". ".join(said) + "."


def scene_text(bundle: Bundle) -> str:
    """`A sphere, radius 4 mm, on digit: pressed 1 mm deep, slid 1 mm along x`"""
    moves = ", ".join(filter(None, map(move_text, bundle.recipe.get("trajectory", ()))))
    text = indenter_text(bundle)
    article = "An" if text[:1].lower() in "aeiou" else "A"
    what = f"{article} {text}, on {finger_text(bundle.attrs)}"
    return f"{what}: {moves}" if moves else what


def task(bundle: Bundle) -> str:
    """An instruction for the scene: its movements without amounts or the object, none of the labels: `Press the object
    into the sensor, slide and lift it.`"""
    kinds = [next((kind for kind, keys in move.items() if keys), "") for move in bundle.recipe.get("trajectory", ())]
    verbs = [SEGMENT_VERBS[kind] for kind in dict.fromkeys(kinds) if kind in SEGMENT_VERBS]
    first = "Close the fingers on the object" if "close" in kinds else "Press the object into the sensor"
    if not verbs:
        return f"{first}."
    *others, last = verbs
    return f"{first}, then {', '.join(others)}{' and ' * bool(others)}{last} it."


def modes(bundle: Bundle) -> list[str]:
    """The contact mode of each frame, by its name in CONTACT_MODES. Raises Missing: `events` is not in the bundle."""
    return [CONTACT_MODES[k] if 0 <= k < len(CONTACT_MODES) else "unknown" for k in bundle[EVENT_MODE_PATH]]


def changes(bundle: Bundle) -> list[Change]:
    """The first frame, and each frame whose contact mode differs from that of the frame before."""
    if EVENT_MODE_PATH not in bundle:
        return []
    named = modes(bundle)
    times = bundle["/frames/time"].tolist() if "/frames/time" in bundle else [None] * len(named)
    return [Change(k, mode, times[k]) for k, mode in enumerate(named) if k == 0 or mode != named[k - 1]]


def indenter_text(bundle: Bundle) -> str:
    """`sphere, radius 4 mm`, `letters`"""
    return shape_text(bundle.recipe.get("indenter", {}))


def _at(time: float | None) -> str:
    return "" if time is None else f" ({time:.3g} s)"


def move_text(segment: dict[str, Any]) -> str:
    """A movement of a recipe in words, such as `pressed 1 mm deep`; empty for an unknown one."""
    kind, keys = next(((kind, keys) for kind, keys in segment.items() if isinstance(keys, dict)), ("", {}))
    number = {key: value for key, value in keys.items() if isinstance(value, int | float)}
    said = {key: rounded(value) for key, value in number.items()}
    force = f" under {said['force_n']} N" if "force_n" in said else ""
    match kind:
        case "press" if force:
            return f"pressed with {said['force_n']} N"
        case "press" if "depth_mm" in said:
            return f"pressed {said['depth_mm']} mm deep"
        case "slide":
            ways = [f"{said[f'{axis}_mm']} mm along {axis}" for axis in "xy" if number.get(f"{axis}_mm")]
            return f"slid {' and '.join(ways) or '0 mm'}{force}"
        case "twist" | "tilt":
            return f"{'turned' if kind == 'twist' else 'tilted'} by {said.get('angle_deg', 0)} degrees{force}"
        case "close":
            return f"gripped with {said['force_n']} N" if force else f"gripped {said.get('width_mm', '?')} mm wide"
        case "lift" if number.get("height_mm", 0) < 0:
            return f"lowered {rounded(-number['height_mm'])} mm"
        case "lift":
            return f"lifted {said.get('height_mm', '?')} mm"
        case "replay":
            return f"moved through {keys.get('file', 'a table of poses')}"
    return {"hold": "held", "release": "lifted"}.get(kind, "")
