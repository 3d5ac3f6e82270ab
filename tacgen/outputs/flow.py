"""Motion in the image of the coating's points."""

from tacgen.outputs.base import DrawnMap, Output, seen

OUTPUT = Output(
    "dense motion of the coating in pixels",
    {"/frames/flow": seen("N h w 2", "px", "shift of the coating's point that was here untouched", -11)},
    lambda frame: {"/frames/flow": frame.scene.flow.at(frame.seen)},
    maps={"flow": DrawnMap("flow [px]", "viridis", "/frames/flow")},
)
