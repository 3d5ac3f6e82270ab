"""A refusal says what to do: a table of recipes and sensor files that are wrong, and how their messages end."""

from pathlib import Path

import pytest

from tacgen.base.errors import UserError
from tacgen.recipe import assets, plan, sensor_checks
from tacgen.sensor.yaml_source import load, parse_path, put

QUICKSTART, GRASP = assets.recipe_path("quickstart"), assets.recipe_path("grasp")
RECIPES = {
    "outputs=[force, markers]|sensor=digit": "leave them out, or add markers to its file",
    "dynamics=null|trajectory=[{press: {depth_mm: 1, frames: 1, duration_s: 1}}]": "leave it out, or add one of them",
    "mesh=hex|sensor=digit_pinki": "leave mesh out",
    "render.method=table|sensor=ninedtact|outputs=[rgb]": "take transport",
    "render.method=path|sensor.camera.pixel_aspect=1.1|outputs=[rgb]": "are not square (camera.pixel_aspect)",
    "markers.method=analytic|sensor=digit|outputs=[force]": "take fem",
    "sensor=no/such.yaml": "a relative path starts at the working folder",
    "outputs=[force]|render.background=a.png": "add rgb to them, or leave background out",
    "vary={method: grid, over: {name: {choice: [a, b]}}}": "write a recipe for each value",
    "uncertainty={material: {modulus: 30}}": "must be at most 1 (got 30)",
    "uncertainty={pose: {depth_mm: 5}}": "must be at most the gel's thickness, 4 mm (got 5)",
    "quality={edge_mm: 2.1}": "ask for quality: {edge_mm: 1} or finer",
    "quality=draft|sensor.gel.layers[0].thickness_mm=1|sensor.plate.thickness_mm=12": "{edge_mm: 0.25} or finer",
    "indenter={shape: sphere, radius_mm: 1e9}": "A flat plate is {shape: box, size_x_mm: 37.9, size_y_mm: 31.1}",
    "indenter={shape: mesh, file: gear, size_mm: 1e9}": "is {shape: box, size_x_mm: 37.9, size_y_mm: 31.1}",
    "uncertainty={mesh: true}|dynamics={density_kg_m3: 1000, frame_s: 0.1}": "or grasp, dynamics and viscosity",
}
GRASPS = {
    "grasp.right=digit_pinki": "take another sensor",
    "quality={force_error: 0.02}": "is not known for a grasp: give edge_mm",
}
SENSORS = {
    "camera.center_mm=[50, 0]": "nearer to 0, 0",
    "camera.tilt_deg=[20, 20]|camera.mm_per_px=0.5": "less tilt, more distance_mm or a smaller picture",
    "markers.diameter_mm=3": "smaller or farther ones",
    "markers.columns=90": "fewer, or closer ones",
    "leds[0].center_mm=[0, -60, -6]": "move it, or raise walls.margin_mm",
    "leds[0].center_mm=[0, -9.9, 0]": "lower, or smaller",
    "leds[0].center_mm=[0, -9.9, -40]": "raise it",
    "camera.colour_matrix=[[1, 0, 0], [1, 0, 0], [0, 0, 1]]": "change a row",
    "gel.dome={radius_x_mm: 12, radius_y_mm: 12, source: x}": "larger radii",
    "gel.outline={shape: stadium_end, end: +y, source: x}|gel.height_mm=9|gel.corner_radius_mm=0": "leave outline out",
}


def ends(text: str, lines: tuple[str, ...]) -> None:
    assert any(line.endswith(text) for line in lines), lines


@pytest.mark.parametrize(
    ("base", "sets", "remedy"),
    [(QUICKSTART, *item) for item in RECIPES.items()] + [(GRASP, *item) for item in GRASPS.items()],
)
def test_a_recipe_that_is_refused_can_be_mended(base: Path, sets: str, remedy: str) -> None:
    with pytest.raises(UserError) as caught:
        plan.load(base, sets.split("|"))
    ends(remedy, caught.value.lines)


@pytest.mark.parametrize(("changes", "remedy"), SENSORS.items())
def test_a_sensor_file_that_is_refused_can_be_mended(changes: str, remedy: str, tmp_path: Path) -> None:
    data = load(assets.sensor_path("gelsight_mini")).data
    for change in changes.split("|"):
        path, _, value = change.partition("=")
        (tmp_path / "value.yaml").write_text(f"v: {value}\n")
        data = put(data, parse_path(path), load(tmp_path / "value.yaml").data["v"])
    _, wrong = sensor_checks.check(data)
    ends(remedy, tuple(problem.message for problem in wrong))
