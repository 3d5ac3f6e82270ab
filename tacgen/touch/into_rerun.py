"""Touch to look at in Rerun: an .rrd file an episode, on the timelines `frame` and `time`.

    world/<body>             pose [mm]; objects with their surface, other bodies as axes
    touch/<finger>           the sensor's picture
    force/<finger>           normal and tangential force on the gel, and what was asked for or the engine reported [N]
    marks/<finger>           contact, slip and lift, 0 or 1
    note/<finger>            why a row is not as asked

The viewer opens with the scene on the left, and the fingers' pictures above their forces on the right.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.export.rerun import SUFFIX, curves, image_of, new_recording
from tacgen.recipe.indenters import Indenter
from tacgen.report.field_figure import surface_of
from tacgen.touch.episode import EpisodeLog, Thing, Touch
from tacgen.touch.label_columns import Felt, file_of, title
from tacgen.touch.recording import Recording

MAX_SHOWN_MM = 150.0  # of shapes without an end
AXIS_LENGTH_MM = 20.0  # of the axes of a body [mm]


def write(source: Recording, felt: Felt, out: Path, *, overwrite: bool) -> list[Path]:
    """One file an episode: `out` itself, otherwise <name>.rrd in it. Raises UserError: no Rerun, or one is there."""
    refuse()
    made = {file_of(episode, out, SUFFIX): (episode, fingers) for episode, fingers in felt.values()}
    for path, episode in made.items():
        output_file.refuse(path, [source.path], overwrite=overwrite)
        content = recording(source, *episode)  # Rerun's own files say nothing when the disk is full
        output_file.put(path, content, [source.path], overwrite=overwrite)
    return [*made]


def refuse() -> None:
    """UserError if Rerun is not installed; to be called before long work, too."""
    try:
        import rerun  # noqa: F401
    except ImportError:
        raise UserError("touch into Rerun needs Rerun: pip install 'tacgen[rerun]'") from None


def recording(source: Recording, episode: EpisodeLog, fingers: Sequence[Touch]) -> bytes:
    """The episode as the bytes of a recording."""
    import rerun as rr

    record, stream = new_recording(title(episode))
    record.send_blueprint(_blueprint(fingers))
    for body in episode.bodies:
        if body in source.things:
            _surface(record, source.things[body])
        record.log(_place(body), rr.TransformAxes3D(axis_length=AXIS_LENGTH_MM), static=True)
    for k, time in enumerate(episode.time.tolist()):
        record.set_time("frame", sequence=k)
        record.set_time("time", duration=time)
        for body, poses in episode.bodies.items():
            if np.isfinite(poses[k]).all():
                record.log(_place(body), rr.Transform3D(translation=poses[k, :3, 3], mat3x3=poses[k, :3, :3]))
        for touch in fingers:
            record.log(f"touch/{touch.finger}", image_of(touch.image(k)))
            if touch.note[k] != (touch.note[k - 1] if k else ""):
                record.log(f"note/{touch.finger}", rr.TextLog(touch.note[k] or "as asked"))
    for touch in fingers:
        forces = np.column_stack([-touch.force[:, 2], np.linalg.norm(touch.force[:, :2], axis=1), touch.engine])
        curves(record, f"force/{touch.finger}", forces, ["normal", "tangential", "asked or engine"], episode.time)
        marks = np.column_stack([touch.contact, touch.moved, touch.lifted]).astype(float)
        curves(record, f"marks/{touch.finger}", marks, ["contact", "slip", "lifted"], episode.time)
    record.flush()
    return bytes(stream.read() or b"")


def _place(body: str) -> str:
    return f"world/{body.replace('/', '-')}"


def _surface(record: Any, thing: Thing) -> None:
    """The triangles of an object in its body's frame; the viewer shows its axes alone where they cannot be made."""
    import rerun as rr

    try:
        indenter: Indenter = TypeAdapter(Indenter).validate_python(dict(thing.surface.indenter))
        found = surface_of(indenter, MAX_SHOWN_MM)
    except (UserError, ValidationError):
        return
    points = found.vertices @ thing.surface.pose[:3, :3].T + thing.surface.pose[:3, 3]
    record.log(
        f"{_place(thing.body)}/surface", rr.Mesh3D(vertex_positions=points, triangle_indices=found.triangles),
        static=True,
    )  # fmt: skip


def _blueprint(fingers: Sequence[Touch]) -> Any:
    """The scene on the left; pictures side by side, forces and notes on the right."""
    import rerun.blueprint as views

    names = [touch.finger for touch in fingers]
    pictures = views.Horizontal(*(views.Spatial2DView(origin=f"touch/{name}", name=name) for name in names))
    forces = views.Horizontal(*(views.TimeSeriesView(origin=f"force/{name}", name=f"{name} [N]") for name in names))
    marks = views.Horizontal(*(views.TimeSeriesView(origin=f"marks/{name}", name=name) for name in names))
    right = views.Vertical(pictures, forces, marks, row_shares=[3, 2, 1])
    return views.Blueprint(views.Horizontal(views.Spatial3DView(origin="world"), right, column_shares=[2, 3]))
