"""Numbers of a sensor file that differ from the shipped file it was copied from: their source becomes `assumed`."""

from functools import cache

from tacgen.recipe import assets
from tacgen.sensor.base_model import Part
from tacgen.sensor.model import Sensor
from tacgen.sensor.usual_values import COPIED_SOURCE
from tacgen.sensor.validation_messages import Issue, suggest, validate
from tacgen.sensor.yaml_source import load

TEXT_KEYS = ("name", "source", "description", "base")  # keys that are no numbers


def problems(sensor: Sensor) -> list[Issue]:
    """A problem of `base`, which must be the name of a shipped sensor."""
    known = assets.list_sensors()
    if sensor.base is None or sensor.base in known:
        return []
    text = f"no shipped sensor is called {sensor.base!r}{suggest(sensor.base, known)}; there are: {', '.join(known)}"
    return [Issue(("base",), text)]


def marked(sensor: Sensor) -> Sensor:
    """The sensor, in which a part whose numbers differ from those of `base`, and which still names the source that they
    have there, has the source `assumed` followed by the keys that differ; a sensor without `base` as it is."""
    if sensor.base is None:
        return sensor
    made = _marked(sensor, _shipped(sensor.base), sensor.base)
    assert isinstance(made, Sensor)
    return made


@cache
def _shipped(name: str) -> Sensor:
    sensor, _ = validate(Sensor, load(assets.sensor_path(name)).data)
    assert sensor is not None, "a test reads every shipped sensor"
    return sensor


def _marked(part: Part, other: Part, base: str) -> Part:
    """A part, and all parts in it, beside the same part of another sensor."""
    new: dict[str, object] = {}
    differ = []
    for name, value in part:
        theirs = getattr(other, name, None)
        if isinstance(value, Part) and isinstance(theirs, Part):
            new[name] = _marked(value, theirs, base)
        elif isinstance(value, tuple) and any(isinstance(item, Part) for item in value):
            pairs = zip(value, [*(theirs or ()), *(len(value) * [None])], strict=False)
            new[name] = tuple(a if b is None else _marked(a, b, base) for a, b in pairs)
        elif value != theirs and name not in TEXT_KEYS:
            differ.append(name)
    if differ and getattr(part, "source", "") == getattr(other, "source", None):
        new["source"] = f"assumed: {', '.join(differ)}{COPIED_SOURCE}{base}"
    return part.model_copy(update=new)
