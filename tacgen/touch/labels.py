"""The touch of a finger in every row of an episode, from the bundles of its intervals."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tacgen.bundle import bundle as bundles
from tacgen.bundle import frame_notes
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.force_error import FORCE_ERROR_PATH
from tacgen.bundle.resume import SceneResult
from tacgen.outputs.contact_modes import CONTACT_MODES
from tacgen.replay.comparison import MIN_CONTACT_FORCE_N
from tacgen.touch import intervals
from tacgen.touch.episode import EpisodeLog, Thing, Touch
from tacgen.touch.intervals import AtFinger, Interval
from tacgen.touch.scenes import TouchScenes

Array = np.ndarray
CORRECTION_PATH, ASKED_FORCE_PATH = "/frames/match/correction_mm", "/frames/match/asked_force"
SLIPPING_MODES = tuple(CONTACT_MODES.index(mode) for mode in ("sliding", "turning"))
MIN_BORNE_SHARE = 0.5  # of an object's weight, that fingers bear when they lift it [-]
MIN_LIFTED_MM = 1.0  # over its height in the first row, of an object that fingers lift [mm]
MAX_NAMED_LENGTH = 200  # characters of a reason in a note


def felt(prepared: TouchScenes, results: Sequence[SceneResult]) -> list[list[Touch]]:
    """The touch of each finger in each episode, in the order of `prepared`.

    Args:
        results: of all scenes of the plan, in order.
    """
    untouched = {name: bundles.read(results[scene].path) for name, scene in prepared.untouched.items()}
    per_finger: dict[tuple[int, str], list[tuple[Interval, SceneResult, Path]]] = {}
    for scene, interval in prepared.scenes.items():
        result = results[scene]
        pair = [result.path.with_name(f"{result.name}-{side}.h5") for side in "LR"]
        sides = [result.path] if interval.other is None else pair
        for finger, path in zip(interval.fingers, sides, strict=True):
            per_finger.setdefault((interval.episode, finger.name), []).append((interval, result, path))
    found = []
    for episode, contacts in zip(prepared.episodes, prepared.contacts, strict=True):
        each = []
        for at in contacts:
            rows = _Rows(at, len(episode), untouched[at.finger.name])
            for interval, why in prepared.refused:
                if interval.episode == episode.index and at.finger in interval.fingers:
                    rows.fail(interval.log.row, interval.thing.body, why)
            for interval, result, path in per_finger.get((episode.index, at.finger.name), []):
                rows.take(interval, result, path)
            each.append(rows.record())
        found.append(_lifted(episode, each, prepared))
    return found


class _Rows:
    """The rows of one finger in one episode, as its intervals fill them."""

    def __init__(self, contacts: AtFinger, n: int, untouched: Bundle) -> None:
        self.contacts, self.untouched = contacts, untouched
        self.touched, self.note = [""] * n, list(contacts.note)
        self.force, self.torque = np.zeros((n, 3)), np.zeros((n, 3))
        self.markers: Array | None = None
        if "/reference/markers" in untouched:
            self.markers = np.tile(untouched["/reference/markers"], (n, 1, 1))
        self.error, self.correction, self.moved = np.zeros(n), np.zeros(n), np.zeros(n, bool)
        self.engine = contacts.engine.copy()
        self.frames: dict[int, tuple[Bundle, int] | None] = {}  # of rows that are not untouched; None: not known
        for row in np.flatnonzero([bool(text) for text in contacts.note]):
            if not contacts.note[row].startswith("the engine"):
                self._unknown(int(row))
                self.touched[row] = contacts.near[row]

    def fail(self, rows: Array, name: str, why: str) -> None:
        """Rows (k,) at which the touch by an object is not known, with the reason."""
        for row in rows[rows >= 0].tolist():
            self._unknown(row)
            self.touched[row] = self.contacts.near[row] and name
            self.note[row] = self.note[row] or " ".join(why.split())[:MAX_NAMED_LENGTH]

    def _unknown(self, row: int) -> None:
        self.force[row] = self.torque[row] = np.nan
        self.error[row] = self.correction[row] = np.nan
        if self.markers is not None:
            self.markers[row] = np.nan
        self.frames[row] = None

    def take(self, interval: Interval, result: SceneResult, path: Path) -> None:
        """The frames of a scene; those that it does not have are unknown."""
        log, name = interval.log, interval.thing.body
        if result.status == "failed":
            self.fail(np.arange(log.row[0], log.row[-1] + 1), name, f"not solved: {result.reason}")
            return
        bundle = bundles.read(path)
        done = bundle.frames
        solved, where = log.some(np.arange(done)), np.flatnonzero(log.row[:done] >= 0)
        if not len(where):
            self.fail(np.arange(log.row[0], log.row[-1] + 1), name, f"not solved: {bundle.attrs['reason']}")
            return
        first, last = int(solved.row[where[0]]), int(solved.row[where[-1]])
        rows = np.arange(first, last + 1)
        place = np.interp(rows, solved.row[where], where)  # a frame, or between two
        self._fill(interval, bundle, rows, place)
        self.fail(np.arange(last + 1, log.row[-1] + 1), name, f"not solved: {bundle.attrs['reason']}")

    def _fill(self, interval: Interval, bundle: Bundle, rows: Array, place: Array) -> None:
        """Labels at rows (k,), whose places among the frames are (k,)."""
        nearest, frames = np.round(place).astype(int), np.arange(bundle.frames)
        said = frame_notes.of(bundle)

        def at(values: Array) -> Array:
            flat = [np.interp(place, frames, part) for part in values.reshape(len(values), -1).T]
            return np.column_stack(flat).reshape((len(place), *values.shape[1:]))

        self.force[rows], self.torque[rows] = at(bundle["/frames/force"]), at(bundle["/frames/torque"])
        if self.markers is not None:
            self.markers[rows] = at(bundle["/frames/markers"])
        touches = np.linalg.norm(self.force[rows], axis=1) > MIN_CONTACT_FORCE_N
        self.error[rows] = np.where(touches, bundle[FORCE_ERROR_PATH][nearest], 0.0)
        self.moved[rows] = np.isin(bundle["/frames/events/mode"][nearest], SLIPPING_MODES)
        if CORRECTION_PATH in bundle:
            self.correction[rows] = np.where(touches, np.nan_to_num(bundle[CORRECTION_PATH][nearest]), 0.0)
            self.engine[rows] = bundle[ASKED_FORCE_PATH][nearest]
        for row, frame, touching in zip(rows.tolist(), nearest.tolist(), touches.tolist(), strict=True):
            self.frames[row] = (bundle, frame)
            self.note[row] = self.note[row] or said[frame][:MAX_NAMED_LENGTH]
            self.touched[row] = interval.thing.body if touching else ""
            force = self.engine[row]
            if not touching and abs(force) > MIN_CONTACT_FORCE_N:
                self.note[row] = self.note[row] or f"nothing touches, and the engine has {force:.3g} N"

    def record(self) -> Touch:
        """The record of all rows."""
        return Touch(
            self.contacts.finger.name, self.touched, self.force, self.torque, self.markers, self.error,
            self.correction, self.engine, self.moved, np.zeros(len(self.touched), bool), self.note,
            _pictures(self.frames, self.untouched),
        )  # fmt: skip


def _pictures(frames: Mapping[int, tuple[Bundle, int] | None], untouched: Bundle) -> Callable[[int], Array]:
    """Pictures of rows, read when they are asked for: black where the touch is not known."""

    def picture(row: int) -> Array:
        known = frames.get(row, (untouched, row % untouched.frames))
        if known is None:
            return np.zeros_like(untouched["/reference/rgb"])
        return known[0].frame("/frames/rgb", known[1])

    return picture


def _lifted(episode: EpisodeLog, touches: Sequence[Touch], prepared: TouchScenes) -> list[Touch]:
    """Touches of all fingers, with the rows in which they together bear the object."""
    down = np.asarray(episode.gravity, float)
    if not (strength := float(np.linalg.norm(down))):
        return list(touches)
    down = down / strength
    things = {one.thing.body: one.thing for one in prepared.scenes.values()}
    borne = {name: np.zeros(len(episode)) for name in things}  # force on the object against gravity [N]
    fingers = {at.finger.name: at.finger for each in prepared.contacts for at in each}
    for touch in touches:
        finger = fingers[touch.finger]
        frames = intervals.mounted(finger, episode.bodies[finger.body])  # the force on the gel, the other way, in these
        up = np.einsum("nij,nj,i->n", frames[:, :3, :3], touch.force, down)
        for name, force in borne.items():
            force += np.where([one == name for one in touch.touched], np.nan_to_num(up), 0.0)
    lifted = {name: _is_lifted(episode, things[name], force, down, strength) for name, force in borne.items()}
    return [
        replace(touch, lifted=np.array([bool(name) and bool(lifted[name][k]) if name in lifted else False
                                        for k, name in enumerate(touch.touched)]))
        for touch in touches
    ]  # fmt: skip


def _is_lifted(episode: EpisodeLog, thing: Thing, borne: Array, down: Array, strength: float) -> Array:
    height = -episode.bodies[thing.body][:, :3, 3] @ down
    known = height[np.isfinite(height)]
    higher = height > (known[0] if len(known) else 0.0) + MIN_LIFTED_MM
    if thing.mass is None:
        return np.asarray(higher)
    return np.asarray(higher | (borne > MIN_BORNE_SHARE * thing.mass * strength))
