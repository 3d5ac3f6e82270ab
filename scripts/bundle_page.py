"""Print docs/BUNDLE.md, generated from tacgen/outputs: python scripts/bundle_page.py > docs/BUNDLE.md"""

import numpy as np

from tacgen.bundle.schema import ATTRS, FORMAT, OPTIONAL, UNITS
from tacgen.outputs import OUTPUTS
from tacgen.outputs.base import Entry


def _line(path: str, row: Entry) -> str:
    shape = ", ".join(str(d).replace("*", "\\*").replace("|", " or ") for d in row.dims)
    kind = ", ".join(filter(None, [np.dtype(row.dtype).name, row.rounding]))
    return f"| `{path}` | ({shape}) | {kind} | {row.units} | {row.long_name} | {row.axes} |"


def page() -> str:
    """The text of docs/BUNDLE.md."""
    lines = [
        f"# The bundle, format {FORMAT}",
        "",
        "Generated from `tacgen/outputs` by `python scripts/bundle_page.py > docs/BUNDLE.md`; do not edit.",
        "",
        "A bundle is one HDF5 file for one scene. Sensor frame: x right and y down in the image, z out of the gel",
        "towards the object; the origin is the centre of the untouched coated face (a dome's crown). Units:",
        f"{UNITS}. Outputs that the recipe did not ask for have no dataset. All data are shuffled and deflated",
        "(HDF5's gzip), which HDF5 since 1.10 reads without plugins; each component of a map has its own chunk. The",
        "same inputs give the same bytes; the run times are in `<name>.timing.json` next to the bundle, by stages that",
        "add up to the scene's time. A map (`h` x `w`) covers the image (`H` x `W`): its sample (i, j) is at image row",
        "(i + 1/2) H/h and column (j + 1/2) W/w, where the centre of the first pixel is (1/2, 1/2). It shows the point",
        "`/reference/x_mm`, `/reference/y_mm` of the untouched face, by refraction, tilt of the camera and dome.",
        "",
        "Signs: forces, torques and tractions act on the gel; torques are about the sensor's origin. Pressure is",
        "positive in compression, stress in tension. Pressure, traction and area are per area of the deformed face.",
        "Traction is in the face's tangent plane: its first component is along the projection of the sensor's x",
        "onto it, its second along outward normal x first direction. Nodal stress is that of the node's outermost",
        "layer; `tacgen.bundle.postprocess` gives the stress of all layers, von Mises and principal stresses, strain",
        "energy, stick and slip.",
        "",
        "`force_map` sums to the force, without what is outside the picture; gel that other gel hides is in it at the",
        "pixel behind which it is, and the other maps show only the outermost gel: `/frames/quality/unseen_force` is",
        "the share of the normal forces that they lack. The integral of traction - pressure n over the deformed face",
        "(`tacgen.bundle.postprocess.map_force`) misses the force by `pressure_resultant` and `traction_resultant`: by",
        "a few percent, and more where the mesh does not resolve a tip or an edge, whose sides have other normals than",
        "the face that is meshed. The sum of pressure x area is that of the normal forces without their directions,",
        "which cancel in part: under a cone of half angle a that is resolved and has no friction it is 1/sin(a) times",
        "the force.",
        "",
        "Friction follows Coulomb's law: the magnitude of the traction is at most friction x pressure, within 1e-3",
        "of its peak, and equal to it within the same where `sliding` is 1. Between sticking and sliding gel there",
        "is a zone about as wide as a cell of the mesh in which samples contain both: `sliding` is between 0 and 1,",
        "`slip` is true from a half on, and the traction may be below friction x pressure, at `default` by up to a",
        "third of its peak (for 95 % of the samples in `slip`: less than a quarter).",
        "The law holds point by point, not for the resultant: an indenter that slides in a dent pushes gel before it,",
        "and the pressure on that side has a part along the face. A ball with friction 0.2 is so held back by 0.22 to",
        "0.24 of its normal force, and more in a deeper dent. `/frames/friction_force` is the part of `/frames/force`",
        "that is friction, `/frames/normal_force` the rest; the former is at most friction x the sum of pressure x",
        "area. Both are stored in scenes with friction alone. `/frames/events` is of all of the face, in view or not.",
        "",
        "A grasp is two files, `-L` and `-R`, each in its own sensor's frame. `/frames/grasp/sensor` transforms it",
        "to the world frame: x from the left finger to the right one, z up, origin midway between their faces at",
        "the start. `/frames/grasp/object` is `/frames/grasp/sensor` times `/frames/pose`, the same in both files.",
        "",
        "Flow and markers are in pixels, with refraction in all layers, x right and y down. `flow` at a sample is",
        "the displacement of the coating's point that is behind this sample on the untouched sensor. It is nan",
        "where there was no gel, and where the point is now outside the image or hidden by other gel.",
        "`marker_visible` is false in the latter two cases. Where the camera looks past the gel, `height`,",
        "`normals`, `gap` and `material` are nan, and the other maps are 0.",
        "",
        "`/frames/rgb` has the camera's noise (unless `render: {noise: false}`), and the drift of its colours if the",
        "sensor has one; `/reference/rgb` has neither: it represents the mean of many images of the untouched sensor.",
        "",
        "Maps are rounded, as their attribute `rounding` and the column `type` say: to multiples of a power of two",
        "in the dataset's unit, or to a number of significant bits. This halves the size of a frame. The rounding",
        "error is at most a hundredth of the map's discretisation error (rms of a ball pressed and slid at",
        "`default`, against `reference`). Images, forces, poses, markers, meshes and `/fields` are not rounded.",
        "",
        "## Outputs",
        "",
        "`N` frames, `H` x `W` image, `h` x `w` map, `M` markers, `n` nodes, `m` cells, `*` any size. Each dataset has",
        "the attributes `units`, `long_name` and `axes`.",
    ]
    told: set[str] = set()
    for name, output in OUTPUTS.items():
        lines += ["", f"### `{name}`", "", f"{output.text[0].upper()}{output.text[1:]}.", ""]
        lines += ["| path | shape | type | unit | what | axes |", "|---|---|---|---|---|---|"]
        lines += [_line(path, row) for path, row in output.rows.items() if path not in told]
        told |= output.rows.keys()
    lines += ["", "## Attributes of the file", "", "| name | type | what |", "|---|---|---|"]
    lines += [f"| `{name}` | {kind.__name__} | {text} |" for name, (kind, text) in ATTRS.items()]
    lines += [f"| `{name}` (optional) | {kind.__name__} | {text} |" for name, (kind, text) in OPTIONAL.items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
