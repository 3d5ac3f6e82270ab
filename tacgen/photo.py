"""A photograph of one's own untouched sensor, behind rendered pictures; the home of what reads it, imported late."""

from pathlib import Path
from typing import TYPE_CHECKING

from tacgen import assets
from tacgen.errors import UserError
from tacgen.explain import Problem
from tacgen.recipe import IMAGES, Recipe
from tacgen.sensor import Camera, Sensor
from tacgen.yamlfile import KeyPath

if TYPE_CHECKING:
    import numpy as np

WHERE: KeyPath = ("render", "background")


def place(name: str, folder: Path | None) -> Path:
    """The file of a photograph, a path that starts at `folder` (the recipe's)."""
    return (folder or Path()) / Path(name).expanduser()


def problems(recipe: Recipe, sensor: Sensor, folder: Path | None) -> list[Problem]:
    """Why a recipe's photograph cannot stand behind this sensor's pictures."""
    name, said, eye = recipe.render.background, recipe.render.background_sha256, sensor.camera
    if name is None:
        return []
    if not recipe.outputs & IMAGES:
        return [Problem(WHERE, "has no effect: outputs do not ask for rgb or radiance", at_key=True)]
    path = place(name, folder)
    try:
        found = assets.sha256(path)
        height, width = read(path).shape[:2]
    except UserError as error:
        return [Problem(WHERE, error.lines[0])]
    if said not in (None, found):
        return [Problem(("render", "background_sha256"), f"{name} is another file now ({found[:12]}...)")]
    if (width, height) != (eye.width_px, eye.height_px):
        text = (
            f"is {width} x {height}, and the camera's pictures are {eye.width_px} x {eye.height_px}: crop and resize it"
        )
        return [Problem(WHERE, text)]
    return []


def read(path: Path) -> "np.ndarray":
    """The picture (H, W, 3), 8 bit. Raises UserError: no picture can be read from the file."""
    import numpy as np
    from PIL import Image

    try:
        with Image.open(path) as picture:
            return np.asarray(picture.convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        reason = "is no picture that can be read" if path.is_file() else "cannot be read: no such file"
        raise UserError(f"{path}: {reason}") from error


def shrunk(light: "np.ndarray", width: int, height: int) -> "np.ndarray":
    """A picture of linear light (H, W, 3) averaged over larger pixels (height, width, 3)."""
    import numpy as np
    from PIL import Image

    channels = [Image.fromarray(c) for c in np.moveaxis(light.astype(np.float32), -1, 0)]
    return np.stack([np.asarray(c.resize((width, height), Image.Resampling.BOX), dtype=float) for c in channels], -1)


def gain(path: Path, flat: "np.ndarray", camera: Camera) -> "np.ndarray":
    """What rendered radiance (H, W, 3) is multiplied by to be as photographed, `flat` being rendered untouched.

    The picture is then photo x (deformed render / flat render), in linear light.
    """
    import numpy as np

    from tacgen.optics import response

    shown = response.expose(flat.astype(float), camera)
    light = response.linear(read(path) / 255.0)
    return np.divide(light, shown, out=np.zeros_like(light), where=shown > 0)
