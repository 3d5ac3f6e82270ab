"""Points of the coating behind the samples of the image."""

from tacgen.outputs.base import Output, seen

OUTPUT = Output(
    "the point of the coating behind each sample, by its rest position",
    {"/frames/material": seen("N h w 2", "mm", "where the coating's point behind the sample rests", -15)},
    lambda frame: {"/frames/material": frame.seen.behind(frame.seen.sheet.rest)},
)
