"""Centres of the printed markers in the image."""

from tacgen.outputs.base import Datasets, Entry, FrameData, Output


def _frame(frame: FrameData) -> Datasets:
    undisturbed, at = frame.scene.markers
    pixels, shown = at(frame)
    return {"/frames/markers": pixels, "/frames/marker_flow": pixels - undisturbed, "/frames/marker_visible": shown}


OUTPUT = Output(
    "pixels of the dots, and their motion",
    {
        "/frames/markers": Entry("<f4", "N M 2", "px", "marker centres through the optics"),
        "/frames/marker_flow": Entry("<f4", "N M 2", "px", "markers less their reference"),
        "/frames/marker_visible": Entry("|b1", "N M", "1", "in the picture, no gel before it"),
        "/reference/markers": Entry("<f4", "M 2", "px", "marker centres on the untouched sensor"),
    },
    _frame,
    lambda scene: {"/reference/markers": scene.markers[0]},
    needs="markers",
)
