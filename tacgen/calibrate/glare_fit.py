"""The glare of a camera from a photograph of an untouched unit: what it shows beyond the light of the sensor file."""

import numpy as np

from tacgen.optics import camera_response
from tacgen.render import photograph
from tacgen.render.images import Renderer
from tacgen.sensor.imperfections import MAX_GLARE_CELLS, MIN_GLARE_CELLS, Glare
from tacgen.sensor.model import LitSensor

GLARE_CELL_MM = 1.0  # side of a cell, about: wider than grain and dust, which move with the gel [mm]
GLARE_SPP = 64  # samples a pixel, as fits to gels that scatter have


def glare(sensor: LitSensor, untouched: np.ndarray) -> Glare:
    """The glare with which a sensor, whose own is left out, has an untouched picture (H, W, 3) of 8 bit, in cells of
    about GLARE_CELL_MM."""
    camera = sensor.camera.model_copy(update={"glare": None})
    bare = Renderer(sensor.model_copy(update={"camera": camera}), GLARE_SPP, 0, markers=False)
    beyond = camera_response.linear(untouched / 255.0, camera) - camera_response.expose(
        bare.flat().astype(float), camera
    )
    sides = camera.width_px * camera.pixel_mm[0], camera.height_px * camera.pixel_mm[1]
    columns, rows = (int(np.clip(round(side / GLARE_CELL_MM), MIN_GLARE_CELLS, MAX_GLARE_CELLS)) for side in sides)
    cells = np.clip(photograph.shrunk(beyond, columns, rows), -1.0, 1.0).round(3)
    red, green, blue = (tuple(map(tuple, cells[..., k].tolist())) for k in range(3))
    return Glare(red=red, green=green, blue=blue, source="the untouched picture less the rendered one")
