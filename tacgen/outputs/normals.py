"""Normals of the deformed coated face, as the camera sees it."""

from tacgen.outputs.base import Entry, Output

OUTPUT = Output(
    "unit normal of the deformed face",
    {
        "/frames/normals": Entry(
            "<f4", "N h w 3", "1", "unit normal of the deformed face, outward", nan=True, power=-14
        ),
        "/reference/normals": Entry("<f4", "h w 3", "1", "unit normal of the untouched face", nan=True),
    },
    lambda frame: {"/frames/normals": frame.outer.normals()},
    lambda scene: {"/reference/normals": scene.outer.normals()},
)
