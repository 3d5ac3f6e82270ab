"""The 8-bit camera image."""

from tacgen.outputs.base import Entry, Output

OUTPUT = Output(
    "camera image",
    {
        "/frames/rgb": Entry("|u1", "N H W 3", "1", "camera image, sRGB", axes="frame row column rgb"),
        "/reference/rgb": Entry("|u1", "H W 3", "1", "camera image of the untouched sensor", axes="row column rgb"),
    },
    lambda frame: {"/frames/rgb": frame.shot.rgb},
    lambda scene: {"/reference/rgb": scene.pictures.developed(scene.pictures.flat)},
    needs="light",
)
