"""Rerun: a scene as a recording for its viewer, one .rrd file each.

    https://rerun.io (rerun name.rrd)

On the timelines `frame` and, if frames have one, `time`:

    camera             image
    camera/untouched   image of the untouched sensor
    maps/<name>        pressure and height (row, column), traction (row, column, xy): those that the bundle holds
    force, torque      x, y and z [N], [N mm]
    wrench             force and torque together, six numbers
    contact_mode       of `events`, a number
    face               mesh of the coated face [mm]: its finite elements if they are stored, else its height behind each
                       sample of the map

Rerun numbers rows by the clock: two exports of a scene hold the same data in different bytes (`rerun rrd compare`).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tacgen.base.output_file import add
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.caption import EVENT_MODE_PATH, task
from tacgen.bundle.image_file import encoded
from tacgen.export import names, needs_package

SUFFIX = ".rrd"
MAP_DIMENSIONS = {"pressure": ["row", "column"], "traction": ["row", "column", "xy"], "height": ["row", "column"]}
AXIS_NAMES = ("x", "y", "z")
FACE_DATASETS = (  # rest points, facets and displacement of the face, in the order in which they are looked for
    ("/mesh/surface/points", "/mesh/surface/facets", "/fields/surface_displacement"),
    ("/mesh/points", "/mesh/facets/coated", "/fields/displacement"),
)


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """One file a bundle: `out` itself if it ends in SUFFIX, otherwise <name>.rrd in it. Raises UserError: no Rerun."""
    needs_package("rerun", "Rerun")
    named = names(bundles)
    made = [out] if out.suffix == SUFFIX else [out / f"{name}{SUFFIX}" for name in named]
    for bundle, name, path in zip(bundles, named, made, strict=True):
        add(path, recording(bundle, name))  # Rerun's own files say nothing when the disk is full
    return made


def recording(bundle: Bundle, name: str) -> bytes:
    """The scene as the bytes of a recording of this name."""
    import rerun as rr

    record, stream = new_recording(name)
    record.log("task", rr.TextDocument(task(bundle)), static=True)
    if "/reference/rgb" in bundle:
        record.log("camera/untouched", image_of(bundle["/reference/rgb"]), static=True)
    _vectors(record, bundle)
    surface = face(bundle)
    for k in range(bundle.frames):
        record.set_time("frame", sequence=k)
        if "/frames/time" in bundle:
            record.set_time("time", duration=float(bundle["/frames/time"][k]))
        if "/frames/rgb" in bundle:
            record.log("camera", image_of(bundle.frame("/frames/rgb", k)))
        for field, axes in MAP_DIMENSIONS.items():
            if f"/frames/{field}" in bundle:
                record.log(f"maps/{field}", rr.Tensor(bundle.frame(f"/frames/{field}", k), dim_names=axes))
        if surface:
            record.log("face", rr.Mesh3D(vertex_positions=surface.points(k), triangle_indices=surface.triangles))
    record.flush()
    return bytes(stream.read() or b"")


def new_recording(name: str) -> tuple[Any, Any]:
    """A recording without the clock's times, and the stream that gives its bytes."""
    import rerun as rr

    record = rr.RecordingStream("tacgen", recording_id=name, send_properties=False)
    rr.set_log_time_enabled(False, recording=record)
    rr.set_log_tick_enabled(False, recording=record)
    return record, record.binary_stream()


def _vectors(record: Any, bundle: Bundle) -> None:
    """Force, torque, wrench and contact mode over the frames."""
    series = {name: bundle[f"/frames/{name}"] for name in ("force", "torque") if f"/frames/{name}" in bundle}
    labels = {name: [f"{name[0].upper()}{axis}" for axis in AXIS_NAMES] for name in series}
    if len(series) == 2:
        series["wrench"] = np.hstack([series["force"], series["torque"]])
        labels["wrench"] = [*labels["force"], *labels["torque"]]
    if EVENT_MODE_PATH in bundle:
        series["contact_mode"], labels["contact_mode"] = bundle[EVENT_MODE_PATH][:, None].astype(float), ["mode"]
    timed = "/frames/time" in bundle
    for name, values in series.items():
        curves(record, name, values, labels[name], bundle["/frames/time"] if timed else None)


def curves(record: Any, name: str, values: np.ndarray, labels: Sequence[str], time: np.ndarray | None) -> None:
    """Numbers (n, k) over the frames as k curves, and over the times (n,) [s] where they have some."""
    import rerun as rr

    times = [rr.TimeColumn("frame", sequence=np.arange(len(values)))]
    if time is not None:
        times.append(rr.TimeColumn("time", duration=time))
    record.log(name, rr.SeriesLines(names=labels), static=True)
    record.send_columns(name, indexes=times, columns=rr.Scalars.columns(scalars=values))


def image_of(pixels: np.ndarray) -> Any:
    """Pixels (h, w, 3) as a PNG file that Rerun shows."""
    import rerun as rr

    return rr.EncodedImage(contents=encoded(pixels, "PNG"), media_type="image/png")


class FaceMesh(NamedTuple):
    """The coated face of a scene as triangles."""

    bundle: Bundle
    triangles: np.ndarray  # (t, 3) of its points
    rest: np.ndarray  # (n, 3) nodes at rest [mm], or points on the rays behind the samples
    rays: np.ndarray  # (n, 3) along them, of length 1 in z; empty: the nodes move by `displacement`
    displacement: str
    nodes: np.ndarray  # (n,) of the dataset `displacement`

    def points(self, k: int) -> np.ndarray:
        """Points (n, 3) of frame k in the sensor's frame [mm], at z = 0 where the camera sees no gel."""
        if len(self.rays):
            height = np.nan_to_num(self.bundle.frame("/frames/height", k)).reshape(-1, 1)
            return np.asarray(self.rest + self.rays * (height - self.rest[:, 2:]))
        return np.asarray(self.rest + self.bundle.frame(self.displacement, k)[self.nodes])


def face(bundle: Bundle) -> FaceMesh | None:
    """The face from finite elements or, without them, from its height and the camera; None without either."""
    for points, facets, displacement in FACE_DATASETS:
        if all(path in bundle for path in (points, facets, displacement)):
            corners = bundle[facets]
            parts = [corners[:, [0, 1, 2]]] + ([corners[:, [0, 2, 3]]] if corners.shape[1] == 4 else [])
            nodes, triangles = np.unique(np.vstack(parts), return_inverse=True)
            triangles, rest = triangles.reshape(-1, 3), bundle[points][nodes]
            return FaceMesh(bundle, triangles, rest, np.zeros((0, 3)), displacement, nodes)
    if "/frames/height" not in bundle or "sensor_document" not in bundle.attrs:
        return None
    from tacgen.optics.camera import PinholeCamera

    camera, (rows, columns) = PinholeCamera.from_sensor(bundle.sensor), bundle.shapes["/frames/height"][1:]
    down, right = np.indices((rows, columns)).reshape(2, -1) + 0.5
    pixels = np.column_stack([right * camera.shape[1] / columns, down * camera.shape[0] / rows])
    origins, directions = camera.rays(pixels)
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    triangles = np.vstack([np.stack(part, -1).reshape(-1, 3) for part in ((a, b, c), (a, c, d))])
    return FaceMesh(bundle, triangles, origins, directions / directions[:, 2:], "", number.ravel())
