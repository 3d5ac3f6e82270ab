"""Where objects come near the gel of a finger, by distance alone: the rows of an episode that are worth solving."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import TypeAdapter, ValidationError

from tacgen.base.errors import UserError
from tacgen.geometry.gel import GelBody
from tacgen.geometry.pose import Pose
from tacgen.recipe import pose_table
from tacgen.recipe.indenters import Indenter
from tacgen.replay import selection
from tacgen.replay.comparison import MIN_CONTACT_FORCE_N
from tacgen.replay.contact_log import ContactLog
from tacgen.replay.selection import MAX_FACE_POINT_DISTANCE_MM, RecordedBody
from tacgen.touch.episode import EpisodeLog, Finger, Thing
from tacgen.touch.label_columns import title

Array = np.ndarray
ROWS_BEFORE, ROWS_AFTER = 2, 1  # of an interval, in which nothing is near: from there the object comes and goes
NOBODY, SEVERAL = -1, -2  # in the place of the number of the object that is near
BETWEEN_ROWS = -1  # number of a frame that is no row of the episode
FEW_FACE_POINTS = 16  # of a face, from which an object's distance is told that comes near nowhere
INTERVAL_ROUNDING = 1e-6  # of a number of time steps between two rows [-]


@dataclass(frozen=True)
class Rate:
    """How often the gel is solved [1/s]; None: at the rows of the episode. In windows (from, to [s], rate) more often,
    or less."""

    usual: float | None = None
    windows: tuple[tuple[float, float, float], ...] = ()

    def at(self, time: float) -> float | None:
        """The rate at a time [s]; the last window that holds it is meant."""
        return next((rate for start, end, rate in reversed(self.windows) if start <= time <= end), self.usual)


@dataclass(frozen=True)
class Interval:
    """Frames in which one object is near a finger, in order; in a grasp, near the `other` finger too. The `row` of a
    frame of the log is that of the episode, or BETWEEN_ROWS."""

    episode: int
    finger: Finger
    thing: Thing
    log: ContactLog
    other: Finger | None = None

    @property
    def fingers(self) -> tuple[Finger, ...]:
        """The finger, or both of a grasp."""
        return (self.finger,) if self.other is None else (self.finger, self.other)

    @property
    def place(self) -> str:
        """The object and where: `box at left`."""
        return f"{self.thing.body} at {' and '.join(finger.name for finger in self.fingers)}"

    @property
    def rows(self) -> tuple[int, int]:
        """The first row and the last one."""
        return int(self.log.row[0]), int(self.log.row[-1])


@dataclass(frozen=True)
class AtFinger:
    """The n rows of an episode at one finger.

    near: name of the object whose rigid shape touches the gel, or that presses on the finger by the engine; names of
    several; or "". engine (n,): the engine's normal force on the gel by all objects [N], nan where none is recorded.
    note: why a row cannot be labelled, "" where it can.
    """

    finger: Finger
    intervals: tuple[Interval, ...]
    near: list[str]
    engine: Array
    note: list[str]


def body_of(thing: Thing) -> RecordedBody:
    """The surface of an object, for distances. Raises UserError: it is no indenter, or its mesh cannot be read."""
    try:
        indenter: Indenter = TypeAdapter(Indenter).validate_python(dict(thing.surface.indenter))
    except ValidationError as error:
        raise UserError(f"{thing.body}: its surface is no indenter: {error.errors()[0]['msg']}") from None
    return selection.body_of(indenter, selection.placement(thing.surface.pose), np.eye(3)[None])


def contacts(
    episode: EpisodeLog, finger: Finger, things: Mapping[str, tuple[Thing, RecordedBody]], gel: GelBody, near_mm: float
) -> AtFinger:
    """The intervals of an episode in which an object comes within `near_mm` of the gel of a finger.

    Where two objects touch at once the rows are left out, with a note; so are rows without a pose.

    Raises:
        UserError: the episode has no such finger.
    """
    if finger.body not in episode.bodies:
        known = ", ".join(sorted(episode.bodies)) or "none"
        raise UserError(f"{title(episode)}: has no body {finger.body} for --sensor {finger.name} (it has: {known})")
    n, note = len(episode), [""] * len(episode)
    here = [pair for name, pair in things.items() if name != finger.body and recorded(episode, name)]
    logs = [log_of(episode, finger, thing) for thing, _ in here]
    gap = np.full((len(here), n), np.inf)
    for k, ((thing, body), log) in enumerate(zip(here, logs, strict=True)):
        there = _known(log)
        for row in np.flatnonzero(~there):
            note[row] = f"the pose of {finger.body} or of {thing.body} is not recorded"
        gap[k, there] = distances(body, gel, _relative(log.some(there), finger, body), near_mm)
    pressed = [_normal(log, finger) for log in logs]
    felt = np.array([np.nan_to_num(np.abs(force)) for force in pressed]).reshape(gap.shape) > MIN_CONTACT_FORCE_N
    near = gap <= near_mm + MAX_FACE_POINT_DISTANCE_MM
    touching = near & ((gap <= 0) | felt)
    owner = _owners(near, touching, gap)
    names = [thing.body for thing, _ in here]
    held = [names[owner[row]] if owner[row] >= 0 and touching[owner[row], row] else "" for row in range(n)]
    for row in np.flatnonzero(owner == SEVERAL):
        held[row] = " and ".join(names[k] for k in np.flatnonzero(touching[:, row]))
        note[row] = note[row] or f"{held[row]} touch at once: one object at a time is solved"
    for k, row in zip(*np.nonzero(felt & ~near), strict=True):
        note[row] = note[row] or f"the engine has {names[k]} press on {finger.body}, but not on its gel"
    found = []
    for k, (thing, _) in enumerate(here):
        possible = (gap[k] <= MAX_FACE_POINT_DISTANCE_MM) | felt[k]
        free = _known(logs[k]) & np.isin(owner, (k, NOBODY))
        for rows in runs(owner == k, free):
            if possible[rows].any():
                found.append(Interval(episode.index, finger, thing, logs[k].some(rows)))
    found.sort(key=lambda one: one.rows)
    engine = np.full(n, np.nan)
    for force in pressed:
        engine = np.where(np.isnan(force), engine, np.nan_to_num(engine) + force)
    return AtFinger(finger, tuple(found), held, engine, note)


def approach(
    episode: EpisodeLog, finger: Finger, things: Mapping[str, tuple[Thing, RecordedBody]], gel: GelBody
) -> tuple[float, int, str] | None:
    """About how close an object comes to a finger [mm], the row and the object; None where there is no object."""
    face, found = selection.face_points(gel), list[tuple[float, int, str]]()
    face = face[:: -(-len(face) // FEW_FACE_POINTS)]
    for thing, body in (pair for name, pair in things.items() if name != finger.body and recorded(episode, name)):
        log = log_of(episode, finger, thing)
        rows = np.flatnonzero(_known(log))
        for row, pose in zip(rows.tolist(), _relative(log.some(rows), finger, body), strict=True):
            found.append((float(body.distance(Pose.of(pose).local(face)).min()), row, thing.body))
    return min(found, default=None)


def recorded(episode: EpisodeLog, body: str) -> bool:
    """Whether an episode has a pose of a body in any row."""
    return body in episode.bodies and bool(np.isfinite(episode.bodies[body]).all((1, 2)).any())


def log_of(episode: EpisodeLog, finger: Finger, thing: Thing) -> ContactLog:
    """All rows of an object and of a finger's body; the force is that on the finger by the object, where it is
    recorded."""
    force = episode.forces.get((finger.body, thing.body))
    if force is None and (other := episode.forces.get((thing.body, finger.body))) is not None:
        force = -other
    body, sensor = episode.bodies[thing.body], episode.bodies[finger.body]
    name = f"{finger.name} {thing.body} {episode.name}"
    return ContactLog(name, np.arange(len(episode)), episode.time, body, sensor, force, True)


def _known(log: ContactLog) -> Array:
    """Whether both poses of each row are known (n,)."""
    assert log.sensor is not None
    return np.asarray(np.isfinite(log.body).all((1, 2)) & np.isfinite(log.sensor).all((1, 2)))


def _relative(log: ContactLog, finger: Finger, body: RecordedBody) -> Array:
    return selection.relative(log, finger.mount, body.pose) if len(log) else np.empty((0, 4, 4))


def mounted(finger: Finger, bodies: Array) -> Array:
    """Poses (n, 4, 4) of a finger's sensor frame in the world, from those of its body."""
    (mount,) = pose_table.matrices([finger.mount.position_mm], [finger.mount.quaternion])
    return np.asarray(bodies @ mount)


def _normal(log: ContactLog, finger: Finger) -> Array:
    """The engine's normal force (n,) [N] on the gel, positive in compression; nan where it is not known."""
    if log.force is None:
        return np.full(len(log), np.nan)
    assert log.sensor is not None
    return np.asarray(-np.einsum("ni,ni->n", mounted(finger, log.sensor)[:, :3, 2], log.force))


def distances(body: RecordedBody, gel: GelBody, poses: Array, near_mm: float) -> Array:
    """As `selection.gaps`, but inf where the boxes around gel and object are farther apart than `near_mm`."""
    found = np.full(len(poses), np.inf)
    reach = near_mm + MAX_FACE_POINT_DISTANCE_MM
    close = np.flatnonzero([not _apart(body, gel, pose, reach) for pose in poses])
    if len(close):
        found[close] = selection.gaps(body, gel, poses[close], reach)
    return found


def _apart(body: RecordedBody, gel: GelBody, pose: Array, reach: float) -> bool:
    for axis, sign, end in (
        *((2, 1, 0.0), (2, -1, gel.thickness), (0, 1, gel.width / 2), (0, -1, gel.width / 2)),
        *((1, 1, gel.height / 2), (1, -1, gel.height / 2)),
    ):
        turned = pose.copy()
        turned[2] = sign * pose[axis]  # `lowest` looks along z alone
        if body.lowest(turned) > end + reach:
            return True
    return False


def _owners(near: Array, touching: Array, gap: Array) -> Array:
    """The number (n,) of the object that touches or, where none does, of the nearest one that is near; NOBODY or
    SEVERAL. Arguments are (objects, n)."""
    if not len(near):
        return np.full(near.shape[1], NOBODY)
    count, nearest = touching.sum(0), np.where(near, gap, np.inf).argmin(0)
    alone = np.where(count == 1, touching.argmax(0), nearest)
    return np.where(count > 1, SEVERAL, np.where(near.any(0), alone, NOBODY))


def runs(near: Array, free: Array) -> list[Array]:
    """The numbers of the rows of each interval: those that are `near` (n,), with ROWS_BEFORE and ROWS_AFTER where rows
    are `free` (n,); intervals that meet are one."""
    wanted = near & free
    for _ in range(ROWS_BEFORE):
        wanted[:-1] |= wanted[1:] & free[:-1]
    for _ in range(ROWS_AFTER):
        wanted[1:] |= wanted[:-1] & free[1:]
    rows = np.flatnonzero(wanted)
    return [run for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(run)]


def at_rate(interval: Interval, rate: Rate) -> Interval:
    """The frames at which the gel is solved: rows are left out, or poses put in between, so that they follow each other
    at this rate. Turns are by the shortest way, positions and forces linear. First and last row stay."""
    log, kept = interval.log, [0]
    last = len(log) - 1
    steps = list[int]()  # from each kept row to the next
    for k in range(1, len(log)):
        apart, wanted = float(log.time[k] - log.time[kept[-1]]), rate.at(float(log.time[k]))
        count = 1.0 if wanted is None else apart * wanted
        if k == last or count >= 1 - INTERVAL_ROUNDING:
            kept.append(k)
            beside = k == kept[-2] + 1
            steps.append(max(1, int(np.ceil(count - INTERVAL_ROUNDING)) if beside else int(count + INTERVAL_ROUNDING)))
    if kept == list(range(len(log))) and set(steps) <= {1}:
        return interval
    parts = [k + np.arange(n) / n * (after - k) for k, after, n in zip(kept, kept[1:], steps, strict=False)]
    return replace(interval, log=_between(log, np.concatenate([*parts, [last]]), kept))


def _between(log: ContactLog, place: Array, kept: Sequence[int]) -> ContactLog:
    """A log at places between its rows (k,): 1.5 is in the middle of the rows 1 and 2."""
    time = np.interp(place, np.arange(len(log)), log.time)
    whole = np.isin(place, kept)
    row = np.where(whole, log.row[np.round(place).astype(int)], BETWEEN_ROWS)
    force = None
    if log.force is not None:
        force = np.column_stack([np.interp(time, log.time, axis) for axis in log.force.T])
    assert log.sensor is not None
    return replace(
        log, row=row, time=time, body=_posed(log.body, log.time, time), sensor=_posed(log.sensor, log.time, time),
        force=force,
    )  # fmt: skip


def _posed(poses: Array, known: Array, time: Array) -> Array:
    """Poses at other times, those of times that are known as they are."""
    from scipy.spatial.transform import Rotation, Slerp

    found = np.tile(np.eye(4), (len(time), 1, 1))
    found[:, :3, :3] = Slerp(known, Rotation.from_matrix(poses[:, :3, :3]))(time).as_matrix()
    found[:, :3, 3] = np.column_stack([np.interp(time, known, axis) for axis in poses[:, :3, 3].T])
    same = np.searchsorted(known, time).clip(max=len(known) - 1)
    exact = known[same] == time
    found[exact] = poses[same[exact]]
    return found
