"""The rows of a contact log that are worth solving: those near contact."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tacgen.base.errors import UserError
from tacgen.geometry import mesh_file, mesh_import
from tacgen.geometry.first_touch import closest
from tacgen.geometry.gel import GelBody
from tacgen.geometry.pose import Pose
from tacgen.recipe import assets, indenters, pose_table
from tacgen.recipe.indenters import Indenter
from tacgen.recipe.pose_table import TimedPose
from tacgen.recipe.trajectory import Placement
from tacgen.recipe.trajectory_checks import MAX_SEGMENT_FRAMES
from tacgen.replay.contact_log import ContactLog

Array = np.ndarray
FACE_SPACING_MM = 1.0  # of the points of the face at which distances are looked at [mm]
MAX_FACE_POINT_DISTANCE_MM = FACE_SPACING_MM / np.sqrt(2)  # largest distance of a point of the face from these [mm]
MAX_EXAMINED_ROWS = 2000  # rows of a log without contact, most of which are far away
MAX_DISTANCE_POINTS = 100_000  # points for which distances are computed together
UP_AXES = ("+z", "-z", "+x", "-x", "+y", "-y")
# height of the centre, where a simulator has the origin
CENTRE_HEIGHT_KEYS = {"sphere": "radius_mm", "torus": "tube_radius_mm"}


@dataclass(frozen=True)
class RecordedBody:
    """An object as it was recorded: how its surface is placed in the recorded body's frame."""

    indenter: Indenter
    pose: Placement  # of the indenter in the recorded body
    distance: Callable[[Array], Array]  # signed, from the surface, of points (n, 3) in the indenter's frame [mm]
    lowest: Callable[[Array], float]  # z of the lowest point [mm] at a pose (4, 4)


@dataclass(frozen=True)
class Choice:
    """Which rows of a log are solved."""

    near_mm: float = 1.0  # those that bring the object so near to the gel
    every: int = 1  # of these, each n-th
    first: int = 0  # row of the file
    last: int | None = None  # row of the file; None: to its end

    def __post_init__(self) -> None:
        if not self.near_mm > 0:
            raise UserError(f"--near-mm {self.near_mm:g}: must be more than 0")


def relative(log: ContactLog, sensor_pose: Placement, indenter_pose: Placement) -> Array:
    """Poses (n, 4, 4) of the indenter in the sensor's frame; arguments as of `pose_table.relative`."""
    sensors = [None] * len(log) if log.sensor is None else list(log.sensor)
    each = zip(log.row, log.time, log.body, sensors, strict=True)
    return pose_table.relative([TimedPose(*row) for row in each], sensor_pose, indenter_pose)


def body_of(indenter: Indenter, given: Placement | None, turns: Array) -> RecordedBody:
    """The object of a log.

    Args:
        indenter: of the recipe; the file of a mesh is absolute.
        given: pose of the indenter in the recorded body. None: the body's frame is that of the mesh's file, or the
            centre of a ball or ring.
        turns: rotations (n, 3, 3) of the recorded body in the sensor's frame, from which the axis of a mesh that points
            away from the gel is chosen.

    Raises:
        UserError: the mesh cannot be read; nothing says where a shape is in the recorded body.
    """
    if indenter.shape == "mesh":
        solid = mesh_file.read(assets.mesh_path(indenter.file))
        scale, size = indenter.scale, indenter.size_mm
        if given is None:
            up = max(UP_AXES, key=lambda axis: _height(axis, turns))
            indenter = indenter.model_copy(update={"up": up})
            given = placement(mesh_import.placement(solid, up=up, scale=scale, size=size))
        placed = mesh_import.placed(solid, up=indenter.up, scale=scale, size=size)
        corners = placed.vertices

        def low(pose: Array) -> float:
            return float((corners @ pose[2, :3]).min() + pose[2, 3])

        return RecordedBody(indenter, given, lambda p: mesh_import.signed_distance(placed, p), low)
    if given is None:
        if indenter.shape not in CENTRE_HEIGHT_KEYS:
            raise UserError(
                f"indenter: where is the {indenter.shape} in the recorded body? Say it in the recipe, by"
                " trajectory: [{replay: {file: log.csv, indenter_pose: {position_mm: [0, 0, 0]}}}], or use a mesh"
            )
        given = Placement(position_mm=(0.0, 0.0, -getattr(indenter, CENTRE_HEIGHT_KEYS[indenter.shape])))
    shape = indenters.analytic(indenter)
    assert shape is not None
    return RecordedBody(indenter, given, shape.value, lambda pose: float(pose[2, 3] - shape.support(-pose[2, :3])))


def placement(pose: Array) -> Placement:
    """A pose (4, 4) [mm] as a recipe has it."""
    from scipy.spatial.transform import Rotation

    x, y, z = pose[:3, 3].tolist()
    w, i, j, k = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True).tolist()
    return Placement(position_mm=(x, y, z), quaternion=(w, i, j, k))


def chosen(
    log: ContactLog, body: RecordedBody, gel: GelBody, sensor_pose: Placement, choice: Choice
) -> ContactLog | str:
    """The rows of a log that are solved, or a line that says that there are none."""
    some = log.some(np.arange(len(log))[choice.first : None if choice.last is None else choice.last + 1])
    if not len(some):
        return f"{log.name}: has {len(log)} rows, and none of those that --rows names"
    poses = relative(some, sensor_pose, body.pose)
    gap = gaps(body, gel, poses, choice.near_mm)
    if least(body, gel, gap.min(), poses[gap.argmin()]) > 0:
        return _missed(some, body, gel, poses)
    solved = some.some(runs(gap <= choice.near_mm + MAX_FACE_POINT_DISTANCE_MM, gap <= 0, choice.every))
    if len(solved) > MAX_SEGMENT_FRAMES:
        raise UserError(
            f"{log.name}: {len(solved)} rows are near contact, at most {MAX_SEGMENT_FRAMES} can be: --every takes some"
        )
    return solved


def _missed(log: ContactLog, body: RecordedBody, gel: GelBody, poses: Array) -> str:
    """A line about a log without contact: how close it comes, in one of MAX_EXAMINED_ROWS of its rows."""
    rows = np.arange(len(log))[:: -(-len(log) // MAX_EXAMINED_ROWS)]
    gap = gaps(body, gel, poses[rows], np.inf)
    nearest = rows[gap.argmin()]
    closest = least(body, gel, gap.min(), poses[nearest])
    felt = 0.0 if log.force is None else float(np.linalg.norm(log.force, axis=1).max())
    theirs = f", though its simulator has up to {felt:.3g} N" if felt else ""
    where = f"closest approach {closest:.3g} mm, in row {log.row[nearest]}"
    return f"{log.name}: no contact{theirs}: {where}: check units, sensor_pose and indenter_pose"


def gaps(body: RecordedBody, gel: GelBody, poses: Array, within: float) -> Array:
    """Distance (n,) [mm] of the object from points of the untouched face at poses (n, 4, 4); negative where it touches.

    It is at most MAX_FACE_POINT_DISTANCE_MM larger than that from the face. For an object higher than `within` [mm] it
    is the height of its lowest point, which is not larger than its distance.
    """
    face = face_points(gel)
    found = np.array([body.lowest(pose) for pose in poses])  # the face is nowhere above z = 0
    low = np.flatnonzero(found <= within)
    step = max(1, MAX_DISTANCE_POINTS // len(face))
    for some in (low[k : k + step] for k in range(0, len(low), step)):
        points = np.concatenate([Pose.of(poses[k]).local(face) for k in some])
        found[some] = body.distance(points).reshape(len(some), -1).min(1)
    return found


def runs(near: Array, touching: Array, every: int) -> Array:
    """The rows that are solved, of those that are `near` (n,) or `touching` (n,): of each run each n-th and the last.

    A run begins and ends with a row that does not touch, if there is one: from its end the object goes to the next run.
    """
    wanted = near.copy()
    wanted[:-1] |= near[1:] & touching[1:]
    wanted[1:] |= near[:-1] & touching[:-1]
    rows = np.flatnonzero(wanted)
    each = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    return np.concatenate([np.union1d(run[::every], run[-1:]) for run in each])


def least(body: RecordedBody, gel: GelBody, gap: float, pose: Array) -> float:
    """The distance [mm] of the object from the untouched face at a pose (4, 4), given the `gap` that `gaps` found."""
    shape = indenters.analytic(body.indenter)
    return gap if gap <= 0 or shape is None else closest(shape, gel, pose[None])


def face_points(gel: GelBody) -> Array:
    """Points (n, 3) of the untouched face [mm]."""
    sides = [np.linspace(-s / 2, s / 2, 2 + int(s / FACE_SPACING_MM)) for s in (gel.width, gel.height)]
    x, y = np.meshgrid(*sides)
    here = gel.contains(x, y)
    return np.column_stack([x[here], y[here], gel.top(x[here], y[here])])


def _height(axis: str, turns: Array) -> float:
    """How much an axis of the body points away from the gel, over all rows."""
    return float((1 if axis[0] == "+" else -1) * turns[:, 2, "xyz".index(axis[1])].mean())
