"""The force behind each sample of the image; the samples sum to the whole force."""

from typing import TYPE_CHECKING

from tacgen.outputs import traction
from tacgen.outputs.base import MAP, Datasets, Entry, Output

if TYPE_CHECKING:
    from tacgen.outputs.scene_data import FrameData

UNSEEN = "/frames/quality/unseen_force"


def _frame(frame: "FrameData") -> Datasets:
    from tacgen.outputs.contact_maps import over_force

    missing = frame.maps.force.sum((0, 1)) - frame.state.traction_force.sum((0, 1))
    return {
        "/frames/force_map": frame.maps.force,
        "/frames/area": frame.maps.area,
        "/frames/quality/force_map_resultant": over_force(missing, frame.state),
        UNSEEN: frame.maps.unseen,
    }


OUTPUT = Output(
    "force and area behind each sample",
    {
        "/frames/force_map": Entry("<f4", "N h w 3", "N", "force on the gel behind each sample", MAP + " xyz", bits=17),
        "/frames/area": Entry(
            "<f4", "N h w", "mm^2", "area of the deformed coated face behind each sample", MAP, bits=13
        ),
        "/frames/quality/force_map_resultant": Entry(
            "<f8", "N", "1", "sum of force_map less force, over force", "frame"
        ),
        UNSEEN: traction.OUTPUT.rows[UNSEEN],
    },
    _frame,
)
