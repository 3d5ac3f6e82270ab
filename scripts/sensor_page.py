"""Print docs/SENSOR.md, generated from tacgen/sensor: python scripts/sensor_page.py > docs/SENSOR.md"""

from typing import Any

from tacgen.recipe.schema import sensor_schema
from tacgen.report.sensor_sheet import unit_of
from tacgen.sensor.model import Sensor

HEAD = """# The sensor file

Generated from `tacgen/sensor` by `python scripts/sensor_page.py > docs/SENSOR.md`; do not edit.

A sensor file is YAML 1.2; [Your own sensor](cookbook/own_sensor.md) leads through one. Lengths are in mm, moduli in
MPa, angles in degrees. Frame: x right and y down in the image, z out of the gel toward the object; the origin is the
centre of the untouched coated face, its highest point. `source`, in each part, says where its numbers come from, or
`assumed`; without it there is a warning. An unknown key is an error. A colour may be one number, which stands for three
equal ones.

`tacgen sensor show NAME` prints the values of a shipped sensor or of a file, `tacgen schema --sensor` the JSON Schema.
"""
UNIT = """## A file for your own unit

`tacgen calibrate unit` writes a copy of a sensor file with the gel thickness, moduli and lights of your unit, from
photographs of ball presses with forces. Half an hour in a laboratory is enough: put the sensor on a scale or into a
gripper, press one or two steel balls of known radius into it at several places, lightly and hard, and take a picture and
the reading of each press.

```sh
tacgen calibrate unit --sensor gelsight_mini --images presses -o my_unit.yaml --plot forces.png
```

The folder holds `background.png`, the untouched sensor, and `presses.csv`:

| column | what |
|---|---|
| `file`, `ball_radius_mm`, `force_n` | picture, radius of the ball, reading of the gauge; pressed into the gel is positive |
| `recording`, optional | presses of one video or of one mount: they are held out together. Without it each press stands alone |
| `time_s`, optional | time of the picture: the lag of the gauge is then fitted in each recording, from at least three pictures |
| `untouched`, optional | an untouched picture of its own, instead of `background.png` |

At least four presses must show; ten or more, with two radii, at places all over the gel, are better. The contact must be
wider than the gel is thick in some of them: thickness shows in how the face bulges around the contact. With
`--keep-thickness` the file's thickness holds. Depths need not be measured, and contact circles need not be marked.

| number | comes from |
|---|---|
| depth and place of each press, contrast | the picture: the ball's radius is the slope inside the contact, and so the scale of the colours |
| `thickness_mm` | the face around the contact, in solved presses of 0.5 to 2 times the file's thickness |
| moduli, zero and lag of the gauge | the forces, as the solved presses have them at these depths |
| lights | as by [`calibrate optics`](OPTICS.md), from some of the presses at their found depths; not with `--no-lights` |

The same presses are then rendered with the file and fitted once more, and the estimates are corrected by what comes out
wrong there. Friction (`--friction`) is assumed; where the contact is as wide as the gel is thick, a gel that sticks needs
more force. All numbers stand with their 95 % intervals in comments at the head of the file, and in `source`. A press that
no fit can use, and a number that the presses do not determine, are told in one line, with exit code 2, and nothing is
written.

The command judges itself: recordings (or every third press) are left out of a fit, their forces are found from the
pictures alone, and the mean error in newtons is printed beside that of the mean of the other forces (the floor) and that of
the best rising curve through the judged forces themselves (what the found depths could give at best). With times, the lag
of a judged recording is one number fitted to its own forces; the error without that stands beside it. The error counts for
balls on this unit. Solving takes minutes; it is kept in the cache.

COVERAGE
"""
PLACES = {
    "Sensor": "the file",
    "Gel": "`gel`",
    "StadiumEnd": "`gel.outline`",
    "Dome": "`gel.dome`",
    "Solid": "`gel.solid`",
}
PLACES |= {
    "NeoHookeLayer": "`gel.layers[i]`, law `neo_hooke`",
    "StableNeoHookeLayer": "`gel.layers[i]`, law `stable_neo_hooke`",
    "MooneyRivlinLayer": "`gel.layers[i]`, law `mooney_rivlin`",
    "YeohLayer": "`gel.layers[i]`, law `yeoh`",
    "PronyTerm": "`gel.layers[i].prony[j]`",
    "Scattering": "`gel.layers[i].scattering`",
    "Plate": "`plate`",
    "Coating": "`coating`",
    "Walls": "`walls`",
    "Led": "`leds[i]`",
    "Camera": "`camera`",
    "Noise": "`camera.noise`",
    "GridMarkers": "`markers`, layout `grid`",
    "HexagonalMarkers": "`markers`, layout `hexagonal`",
    "Motion": "`markers.motion`",
    "ThicknessResponse": "`thickness_response`",
}
BOUNDS = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below"}
WORDS = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}


def page() -> str:
    """The text of docs/SENSOR.md."""
    schema = sensor_schema()
    parts = {"Sensor": schema, **schema["$defs"]}
    lines = [HEAD]
    for name, place in PLACES.items():
        part = parts.pop(name)
        about = part.get("description", Sensor.__doc__).split("\n\n")
        lines += [f"## {place[0].upper()}{place[1:]}", "", " ".join(" ".join(about).split()), ""]
        lines += ["| key | value | unit | default | what |", "|---|---|---|---|---|"]
        for key, info in part["properties"].items():
            if key != "source":
                lines.append(row(key, info, key in part.get("required", ())))
        lines.append("")
    assert not parts, f"no place is known of {', '.join(parts)}"
    return "\n".join([*lines, UNIT])


def row(key: str, info: dict[str, Any], required: bool) -> str:
    """A line of a part's table."""
    default = (
        "required" if required else "none" if info.get("default") in (None, "") else f"`{_plain(info['default'])}`"
    )
    return f"| `{key}` | {allowed(info)} | {unit_of(key)} | {default} | {_what(info)} |"


def allowed(info: dict[str, Any]) -> str:
    """What a value may be, from its JSON schema: `number above 0`, `3 numbers`."""
    if "anyOf" in info:
        return " or ".join(allowed(each) for each in info["anyOf"] if each.get("type") != "null")
    if "$ref" in info or "oneOf" in info:
        return "a mapping, below"
    if "const" in info or "enum" in info:
        return ", ".join(f"`{_plain(each)}`" for each in info.get("enum", [info.get("const")]))
    if info["type"] == "array":
        return _several(info)
    bounds = [f"{word} {info[key]:g}" for key, word in BOUNDS.items() if key in info]
    return f"{WORDS[info['type']]} {' and '.join(bounds)}".strip()


def _several(info: dict[str, Any]) -> str:
    """A list: `3 times: number at least 0`, `a list of numbers`."""
    if "prefixItems" not in info:
        return f"a list, each {allowed(info['items'])}"
    each = list(dict.fromkeys(map(allowed, info["prefixItems"])))
    return f"{len(info['prefixItems'])} times: {each[0]}" if len(each) == 1 else f"a list: {'; '.join(each)}"


def _plain(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def _what(info: dict[str, Any]) -> str:
    return str(info["description"]).rstrip(".").replace("|", "\\|").replace("\n", " ")


if __name__ == "__main__":
    print(page(), end="")
