"""Height of the deformed coated face, as the camera sees it."""

from tacgen.outputs.base import DrawnMap, Output, seen

OUTPUT = Output(
    "z of the deformed face",
    {
        "/frames/height": seen("N h w", "mm", "z of the deformed coated face, negative in a dent", -16),
        "/reference/height": seen("h w", "mm", "z of the untouched coated face"),
    },
    lambda frame: {"/frames/height": frame.outer.height()},
    lambda scene: {"/reference/height": scene.outer.height()},
    maps={"height": DrawnMap("change of z [mm]", "cividis", "/frames/height", less="/reference/height")},
)
