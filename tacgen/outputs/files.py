"""Files that the scene's recipe names: the pipeline reads them, see bundle/kept_files."""

from tacgen.outputs.base import Entry, Output

FILE_TEXT = "bytes of the file at this path of the recipe: `indenter.file`, or `trajectory[i].replay.file`"
OUTPUT = Output(
    "files that are not shipped with tacgen and that the recipe names, to draw the scene or to make it again",
    {"/files/*": Entry("|u1", "*", "1", FILE_TEXT, axes="byte")},
    lambda frame: {},
)
