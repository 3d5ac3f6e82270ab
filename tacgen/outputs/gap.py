"""Distance between the deformed coated face and the indenter."""

from tacgen.outputs.base import Output, seen

OUTPUT = Output(
    "distance of the deformed face from the indenter",
    {"/frames/gap": seen("N h w", "mm", "distance of the deformed coated face from the indenter", -15)},
    lambda frame: {"/frames/gap": frame.outer.gap(frame.scene.problem.contact.shape, frame.state.pose)},
)
