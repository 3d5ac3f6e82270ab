"""Motion in the image of the coating's points."""

from tacgen.outputs.base import DrawnMap, Entry, Output

OUTPUT = Output(
    "dense motion of the coating in pixels",
    {
        "/frames/flow": Entry(
            "<f4", "N h w 2", "px", "shift of the coating's point that was here untouched", nan=True, power=-11
        )
    },
    lambda frame: {"/frames/flow": frame.scene.flow.at(frame.seen)},
    maps={"flow": DrawnMap("flow [px]", "viridis", "/frames/flow")},
)
