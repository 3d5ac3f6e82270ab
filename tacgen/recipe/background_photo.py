"""A photograph of an untouched real sensor as the background of rendered images."""

from pathlib import Path

from tacgen.base.errors import UserError
from tacgen.outputs import IMAGE_OUTPUTS
from tacgen.recipe import assets
from tacgen.recipe.model import Recipe
from tacgen.render import photograph
from tacgen.sensor.model import Sensor
from tacgen.sensor.validation_messages import Issue
from tacgen.sensor.yaml_source import KeyPath

BACKGROUND_KEY: KeyPath = ("render", "background")


def problems(recipe: Recipe, sensor: Sensor, folder: Path | None) -> list[Issue]:
    """Why the recipe's photograph cannot be the background of this sensor's images."""
    name, expected, camera = recipe.render.background, recipe.render.background_sha256, sensor.camera
    if name is None:
        return []
    if not recipe.outputs & IMAGE_OUTPUTS:
        text = "has no effect: outputs do not ask for rgb or radiance: add rgb to them, or leave background out"
        return [Issue(BACKGROUND_KEY, text, at_key=True)]
    path = assets.beside(name, folder)
    try:
        sha256 = assets.sha256(path)
        height, width = photograph.read(path).shape[:2]
    except UserError as error:
        return [Issue(BACKGROUND_KEY, error.lines[0])]
    if expected not in (None, sha256):
        return [Issue(("render", "background_sha256"), f"{name} {assets.changed(sha256)}")]
    if (width, height) != (camera.width_px, camera.height_px):
        pictures = f"{camera.width_px} x {camera.height_px}"
        return [
            Issue(
                BACKGROUND_KEY, f"is {width} x {height}, and the camera's pictures are {pictures}: crop and resize it"
            )
        ]
    return []
