"""Positions on the untouched face of the samples of all maps: stored where there is a map."""

from tacgen.outputs.base import Datasets, Output, SceneData, seen

PLACE = "in the sensor frame of the untouched face behind each sample"


def _reference(scene: SceneData) -> Datasets:
    places = scene.outer.places()
    return {"/reference/x_mm": places[..., 0], "/reference/y_mm": places[..., 1]}


OUTPUT = Output(
    "with every map: where its samples lie on the untouched face",
    {f"/reference/{axis}_mm": seen("h w", "mm", f"{axis} {PLACE}", -12) for axis in "xy"},
    lambda frame: {},
    _reference,
)
