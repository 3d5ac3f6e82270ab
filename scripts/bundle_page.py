"""Print docs/BUNDLE.md from the tables in tacgen/bundle/schema.py: python scripts/bundle_page.py > docs/BUNDLE.md"""

import numpy as np

from tacgen.bundle.schema import ATTRS, FORMAT, LAYOUT, OPTIONAL, UNITS, attributes


def page() -> str:
    """docs/BUNDLE.md, made from the tables above."""
    lines = [
        f"# The bundle, format {FORMAT}",
        "",
        "From the tables in `tacgen/bundle/schema.py`, by `python scripts/bundle_page.py > docs/BUNDLE.md`; not to be",
        "edited.",
        "",
        "One HDF5 file a scene. Sensor frame: x right and y down in the image, z out of the gel toward the object;",
        "the origin is the centre of the untouched coated face (a dome's crown).",
        f"One unit system: {UNITS}. A dataset that is absent",
        "was not asked for: nothing is filled with zeros. Everything is shuffled and deflated (HDF5's gzip), which any",
        "HDF5 since 1.10 reads without plugins; a map of several components has a chunk for each. The same inputs give",
        "the same bytes; how long the stages took stands beside the bundle in `<name>.timing.json`. A map (`h` x `w`)",
        "covers the image (`H` x `W`): its sample (i, j) lies at image row (i + 1/2) H/h and column (j + 1/2) W/w,",
        "where the centre of the first pixel is (1/2, 1/2).",
        "",
        "Signs: forces, torques and tractions act on the gel; torques are about the sensor's origin. Pressure is",
        "positive in compression, stress in tension. Pressure, traction and area are by area of the deformed face.",
        "Traction lies in the face's tangent plane: its first component along the sensor's x drawn into it, its",
        "second along the outward normal times the first; the resultant is kept by `force_map` alone. Nodal stress",
        "is that of the outermost layer a node belongs to; `tacgen.bundle.postprocess` gives every layer's, and von",
        "Mises, principal stresses, strain energy, stick and slip.",
        "",
        "Friction by Coulomb's law: the size of the traction is at most friction x pressure, to 1e-3 of its peak.",
        "Where `sliding` is 1 it is friction x pressure, to the same. Where sticking gel borders on sliding gel,",
        "about as wide as a cell of the mesh, a sample holds some of both: `sliding` lies between 0 and 1, `slip`",
        "says whether it is half or more, and the traction may fall short of friction x pressure, at `default` by up",
        "to a third of its peak (95 % of the samples in `slip`: less than a quarter).",
        "",
        "A grasp is two files, `-L` and `-R`, each in its own sensor's frame; `/frames/grasp/sensor` takes it to the",
        "world: x from the left finger to the right one, z up, the origin midway between their faces at the start.",
        "`/frames/grasp/object` is `/frames/grasp/sensor` times `/frames/pose`, the same in both files.",
        "",
        "Flow and markers are pixels through the layers' refraction, x right and y down. `flow` at a sample is where",
        "the coating's point that is behind it on the untouched sensor has moved to, less where it was: positive to",
        "the right and down, zero when untouched, nan where there was no gel, and where the point has left the",
        "picture or stands behind other gel. `marker_visible` says the last two of markers.",
        "",
        "`/frames/rgb` has the camera's noise (`render: {noise: false}` leaves it out); `/reference/rgb` has none: it",
        "stands for the mean of many pictures of the untouched sensor.",
        "",
        "Maps are rounded before they are written, as their attribute `rounding` and the column `type` say: to",
        "multiples of a power of two in the dataset's unit, or to so many significant bits. That halves the bytes of a",
        "frame and loses nothing that is right: what rounding changes is a hundredth of the map's own error or less",
        "(rms of a ball pressed and slid at `default`, against `reference`). Images, forces, poses, markers, meshes",
        "and `/fields` are not rounded.",
        "",
        "## Datasets",
        "",
        "`N` frames, `H` x `W` image, `h` x `w` map, `M` markers, `n` nodes, `m` cells, `*` any size. Each dataset",
        "carries `units`, `long_name` and `axes`.",
        "",
        "| path | shape | type | unit | what | axes |",
        "|---|---|---|---|---|---|",
    ]
    for path, row in LAYOUT.items():
        shape = ", ".join(str(d).replace("*", "\\*") for d in row.dims)
        kind = ", ".join(filter(None, [np.dtype(row.dtype).name, attributes(path).get("rounding")]))
        lines.append(f"| `{path}` | ({shape}) | {kind} | {row.units} | {row.long_name} | {row.axes} |")
    lines += ["", "## Attributes of the file", "", "| name | type | what |", "|---|---|---|"]
    lines += [f"| `{name}` | {kind.__name__} | {text} |" for name, (kind, text) in ATTRS.items()]
    lines += [f"| `{name}` (optional) | {kind.__name__} | {text} |" for name, (kind, text) in OPTIONAL.items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
