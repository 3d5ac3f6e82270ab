"""The outputs that a recipe can ask for, by name; each is a module here that holds its description as OUTPUT.

Only what is asked for is computed, and imports numerics. What several outputs need is in scene_data.
"""

from importlib import import_module

from tacgen.outputs.base import DrawnMap, Entry, Output

OUTPUT_NAMES = (  # in the order in which recipes are stored
    "force",
    "traction",
    "events",
    "force_map",
    "height",
    "normals",
    "gap",
    "stress",
    "surface_stress",
    "markers",
    "flow",
    "material",
    "radiance",
    "rgb",
)
# not asked for by name, but by the block of that name in the recipe, or by `match` of a replay
BLOCK_OUTPUTS = ("uncertainty", "grasp", "match")
POSITIONS_OUTPUT = "positions"  # made wherever another output has a map
OUTPUTS: dict[str, Output] = {
    name: import_module(f"tacgen.outputs.{name}").OUTPUT
    for name in (*OUTPUT_NAMES, *BLOCK_OUTPUTS, POSITIONS_OUTPUT, "files")
}
MAP_OUTPUTS = frozenset(name for name in OUTPUT_NAMES if any("h" in row.dims for row in OUTPUTS[name].rows.values()))
IMAGE_OUTPUTS = frozenset(name for name, output in OUTPUTS.items() if output.needs == "light")
STRESS_OUTPUTS = frozenset({"stress", "surface_stress"})  # they need the gel's elements
LAYOUT: dict[str, Entry] = {path: row for output in OUTPUTS.values() for path, row in output.rows.items()}
DRAWN_MAPS: dict[str, DrawnMap] = {name: layer for output in OUTPUTS.values() for name, layer in output.maps.items()}
