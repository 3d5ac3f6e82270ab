"""Normals of the deformed coated face, as the camera sees it."""

from tacgen.outputs.base import Output, seen

OUTPUT = Output(
    "unit normal of the deformed face",
    {
        "/frames/normals": seen("N h w 3", "1", "unit normal of the deformed face, outward", -14),
        "/reference/normals": seen("h w 3", "1", "unit normal of the untouched face"),
    },
    lambda frame: {"/frames/normals": frame.outer.normals()},
    lambda scene: {"/reference/normals": scene.outer.normals()},
)
