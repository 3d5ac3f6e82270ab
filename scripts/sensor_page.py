"""Print docs/SENSOR.md, generated from tacgen/sensor: python scripts/sensor_page.py > docs/SENSOR.md"""

from pathlib import Path
from typing import Any

from tacgen.recipe.schema import sensor_schema
from tacgen.sensor.model import Sensor

HEAD = """# The sensor file

Generated from `tacgen/sensor` by `python scripts/sensor_page.py > docs/SENSOR.md`; do not edit.

A sensor file is YAML 1.2; [Your own sensor](cookbook/own_sensor.md) leads through one. Lengths are in mm, moduli in
MPa, angles in degrees. Frame: x right and y down in the image, z out of the gel toward the object; the origin is the
centre of the untouched coated face, its highest point. `source`, in each part, says where its numbers come from, or
`assumed`; without it there is a warning. An unknown key is an error. A colour may be one number, which stands for three
equal ones. Keys name their unit.

`tacgen sensor show NAME` prints the values of a shipped sensor or of a file, `tacgen schema --sensor` the JSON Schema.
"""
UNIT = Path(__file__).with_name("own_unit.md")  # the page's last part
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
    "Grain": "`coating.grain`",
    "Relief": "`coating.relief`",
    "Marks": "`coating.marks`",
    "Wear": "`coating.wear`",
    "Walls": "`walls`",
    "Led": "`leds[i]`",
    "Camera": "`camera`",
    "Glare": "`camera.glare`",
    "Noise": "`camera.noise`",
    "Drift": "`camera.drift`",
    "GridMarkers": "`markers`, layout `grid`",
    "HexagonalMarkers": "`markers`, layout `hexagonal`",
    "Motion": "`markers.motion`",
    "ThicknessResponse": "`thickness_response`",
}
BOUNDS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
WORDS = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}


def page() -> str:
    """The text of docs/SENSOR.md."""
    schema = sensor_schema()
    parts = {"Sensor": schema, **schema["$defs"]}
    lines, told = [HEAD], dict[str, str]()  # rows of laws, by their keys
    for name, place in PLACES.items():
        part = parts.pop(name)
        about = part.get("description", Sensor.__doc__).split("\n\n")
        lines += [f"## {place[0].upper()}{place[1:]}", "", " ".join(" ".join(about).split()), ""]
        lines += ["| key | value | default | what |", "|---|---|---|---|"]
        keys = {key: info for key, info in part["properties"].items() if key != "source"}
        rows = {key: row(key, info, key in part.get("required", ())) for key, info in keys.items()}
        shared = [key for key in rows if "Layer" in name and told.get(key) == rows[key]]
        lines += [text for key, text in rows.items() if key not in shared]
        if shared:
            lines += ["", f"As above: {', '.join(f'`{key}`' for key in shared)}."]
        told |= rows if "Layer" in name else {}
        lines.append("")
    assert not parts, f"no place is known of {', '.join(parts)}"
    return "\n".join([*lines, UNIT.read_text(encoding="utf-8")])


def row(key: str, info: dict[str, Any], required: bool) -> str:
    """A line of a part's table."""
    usual = "none" if info.get("default") in (None, "") else f"`{_plain(info['default'])}`"
    return f"| `{key}` | {allowed(info)} | {'required' if required else usual} | {_what(info)} |"


def allowed(info: dict[str, Any]) -> str:
    """The values that are allowed, from a JSON schema: `number above 0`, `3 numbers`."""
    if "anyOf" in info:
        return " or ".join(allowed(each) for each in info["anyOf"] if each.get("type") != "null")
    if "$ref" in info or "oneOf" in info:
        return "mapping"
    if "const" in info or "enum" in info:
        return ", ".join(f"`{_plain(each)}`" for each in info.get("enum", [info.get("const")]))
    if info["type"] == "array":
        return _several(info)
    bounds = [f"{word} {info[key]:g}" for key, word in BOUNDS.items() if key in info]
    return f"{WORDS[info['type']]} {', '.join(bounds)}".strip()


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
