"""Linear light of the rendered camera."""

from tacgen.outputs.base import Entry, Output

OUTPUT = Output(
    "linear light before exposure",
    {"/frames/radiance": Entry("<f4", "N H W 3", "1", "linear light, before exposure", axes="frame row column rgb")},
    lambda frame: {"/frames/radiance": frame.shot.radiance},
    needs="light",
)
