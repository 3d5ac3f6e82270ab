"""The state of the contact as a whole, one mode and five numbers a frame."""

from tacgen.outputs.base import Datasets, FrameData, Output, count, number, vector
from tacgen.outputs.contact_modes import CONTACT_MODES as CONTACT_MODES


def _frame(frame: FrameData) -> Datasets:
    from tacgen.outputs.contact_events import events

    values = events(frame.scene.problem, frame.state, frame.before)
    return {f"/frames/events/{name}": value for name, value in vars(values).items()}


OUTPUT = Output(
    "the contact as a whole: mode, stick ratio, friction used, centre of pressure, area, patches",
    {
        "/frames/events/mode": count(", ".join(f"{k} {mode}" for k, mode in enumerate(CONTACT_MODES))),
        "/frames/events/stick_ratio": number("share of the normal force that does not slide"),
        "/frames/events/friction_used": number(
            "load along the face over what friction can bear; 1 where all of it slides"
        ),
        "/frames/events/center_of_pressure": vector("centre of pressure in the sensor frame", "mm"),
        "/frames/events/contact_area": number("area of the deformed face in contact, in view or not", "mm^2"),
        "/frames/events/patches": count("pieces that the contact consists of, in view or not"),
    },
    _frame,
)
