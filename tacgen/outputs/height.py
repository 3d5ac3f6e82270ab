"""Height of the deformed coated face, as the camera sees it."""

from tacgen.outputs.base import DrawnMap, Entry, Output

OUTPUT = Output(
    "z of the deformed face",
    {
        "/frames/height": Entry(
            "<f4", "N h w", "mm", "z of the deformed coated face, negative in a dent", nan=True, power=-16
        ),
        "/reference/height": Entry("<f4", "h w", "mm", "z of the untouched coated face", nan=True),
    },
    lambda frame: {"/frames/height": frame.outer.height()},
    lambda scene: {"/reference/height": scene.outer.height()},
    maps={"height": DrawnMap("change of z [mm]", "cividis", "/frames/height", less="/reference/height")},
)
