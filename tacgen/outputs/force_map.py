"""The force behind each sample of the image; the samples sum to the whole force."""

from tacgen.outputs import traction
from tacgen.outputs.base import Datasets, Entry, FrameData, Output, number

UNSEEN_FORCE_PATH = "/frames/quality/unseen_force"


def _frame(frame: FrameData) -> Datasets:
    from tacgen.outputs.contact_maps import over_force

    missing = frame.maps.force.sum((0, 1)) - frame.state.traction_force.sum((0, 1))
    return {
        "/frames/force_map": frame.maps.force,
        "/frames/area": frame.maps.area,
        "/frames/quality/force_map_resultant": over_force(missing, frame.state),
        UNSEEN_FORCE_PATH: frame.maps.unseen,
    }


OUTPUT = Output(
    "force and area behind each sample",
    {
        "/frames/force_map": Entry("<f4", "N h w 3", "N", "force on the gel behind each sample", bits=17),
        "/frames/area": Entry("<f4", "N h w", "mm^2", "area of the deformed coated face behind each sample", bits=13),
        "/frames/quality/force_map_resultant": number("sum of force_map less force, over force"),
        UNSEEN_FORCE_PATH: traction.OUTPUT.rows[UNSEEN_FORCE_PATH],
    },
    _frame,
)
