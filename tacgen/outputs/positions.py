"""Positions on the untouched face of the samples of all maps: stored where there is a map."""

from tacgen.outputs.base import Datasets, Entry, Output, SceneData


def _reference(scene: SceneData) -> Datasets:
    places = scene.outer.places()
    return {"/reference/x_mm": places[..., 0], "/reference/y_mm": places[..., 1]}


OUTPUT = Output(
    "with every map: where its samples lie on the untouched face",
    {
        "/reference/x_mm": Entry(
            "<f4", "h w", "mm", "x in the sensor frame of the untouched face behind each sample", nan=True, power=-12
        ),
        "/reference/y_mm": Entry(
            "<f4", "h w", "mm", "y in the sensor frame of the untouched face behind each sample", nan=True, power=-12
        ),
    },
    lambda frame: {},
    _reference,
)
