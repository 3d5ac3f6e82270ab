"""Grasps of two fingers: the rows in which both are near one object, as tables of the gripper's pose and grip."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tacgen.recipe.model import Grasp
from tacgen.replay.written_recipe import POSE_TITLES, pose_columns, table_of
from tacgen.touch import intervals
from tacgen.touch.episode import EpisodeLog, Thing
from tacgen.touch.intervals import AtFinger, Interval

Array = np.ndarray
MAX_FACING_ERROR = 0.035  # sine of the angle between axes of two sensors that face each other [-]
MAX_ASIDE_MM = 1.0  # between the middles of two such sensors, along their faces [mm]
ALONE = "one finger alone touches it, and match: grip needs both: take force"
NO_MASS = "its mass is not known, and match: grip needs it: take force"
NOT_FACING = (
    "the sensors do not face each other, as match: grip needs it: the second one's z and x must be opposite to those of"
    " the first, and y the same: turn them by --mount"
)


def paired(episode: EpisodeLog, at: Sequence[AtFinger]) -> tuple[list[Interval], list[tuple[Interval, str]]]:
    """The intervals in which both fingers are near an object, and the ones that are no grasp, with the reason."""
    left, right = at
    found, refused = list[Interval](), list[tuple[Interval, str]]()
    things = {one.thing.body: one.thing for each in at for one in each.intervals}
    for thing in things.values():
        both = [_covered(each, thing, len(episode)) for each in at]
        rows = np.flatnonzero(both[0] | both[1])
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            log = intervals.log_of(episode, left.finger, thing).some(run)
            whole = Interval(episode.index, left.finger, thing, log, right.finger)
            if not all(covered[run].any() for covered in both):
                refused.append((whole, ALONE))
            elif thing.mass is None:
                refused.append((whole, NO_MASS))
            elif not _facing(episode, whole):
                refused.append((whole, NOT_FACING))
            else:
                found.append(whole)
    return sorted(found, key=lambda one: one.rows), refused


def _covered(at: AtFinger, thing: Thing, n: int) -> Array:
    covered = np.zeros(n, bool)
    for one in at.intervals:
        if one.thing.body == thing.body:
            covered[one.log.row] = True
    return covered


def _sensors(episode: EpisodeLog, interval: Interval) -> tuple[Array, Array]:
    """The poses of both sensors in all rows (n, 4, 4)."""
    assert interval.other is not None
    left, right = (intervals.mounted(one, episode.bodies[one.body]) for one in (interval.finger, interval.other))
    return left, right


def _facing(episode: EpisodeLog, interval: Interval) -> bool:
    left, right = (poses[interval.log.row] for poses in _sensors(episode, interval))
    apart = right[:, :3, 3] - left[:, :3, 3]
    inside = np.einsum("nji,nj->ni", left[:, :3, :3], apart)  # in the frame of the left one
    turned = np.einsum("nji,njk->nik", left[:, :3, :3], right[:, :3, :3]) - np.diag([-1.0, 1.0, -1.0])
    return bool((np.abs(turned) < MAX_FACING_ERROR).all() and (np.abs(inside[:, :2]) < MAX_ASIDE_MM).all())


def _grip(episode: EpisodeLog, interval: Interval, at: Sequence[AtFinger]) -> Array:
    """The grip (n,) [N] of each finger, 0 unless both touch: as it was told or, where that is not known, the mean of
    the engine's normal forces."""
    grip = np.mean([each.engine for each in at], axis=0) if episode.grip is None else episode.grip
    touching = np.all([[name == interval.thing.body for name in each.near] for each in at], axis=0)
    return np.where(touching, grip, 0.0)


def table(interval: Interval, episode: EpisodeLog, at: Sequence[AtFinger]) -> str:
    """The table of a grasp: poses of gripper and object, grip and width."""
    log = interval.log
    assert log.sensor is not None
    left, right = _sensors(episode, interval)
    apart = np.einsum("nij,ni->nj", left[:, :3, :3], right[:, :3, 3] - left[:, :3, 3])
    known = np.isfinite(apart).all(1)
    across = np.column_stack([np.interp(log.time, episode.time[known], part[known]) for part in apart.T])
    mine = intervals.mounted(interval.finger, log.sensor)
    gripper = mine.copy()
    gripper[:, :3, :3] = mine[:, :3, [2, 0, 1]]  # x, from the left to the right, is the left sensor's z
    gripper[:, :3, 3] += np.einsum("nij,nj->ni", mine[:, :3, :3], across / 2)
    grip = np.interp(log.time, episode.time, _grip(episode, interval, at))
    thing = log.body @ interval.thing.surface.pose
    titles = [*POSE_TITLES, "grip_n", "width_mm", *(f"object_{title}" for title in POSE_TITLES)]
    numbers = np.hstack([pose_columns(gripper), grip[:, None], across[:, 2:], pose_columns(thing)])
    return table_of(log, "poses of gripper and object in the world frame", titles, numbers)


def block(interval: Interval, gravity: Sequence[float], right: str) -> dict[str, Any]:
    """The recipe's key `grasp`; right: the other finger's sensor as the recipe names it."""
    thing = interval.thing
    keys: dict[str, Any] = {"mass_kg": thing.mass, "right": right, "gravity": [float(part) for part in gravity]}
    if thing.centre is not None:
        inside = np.linalg.inv(thing.surface.pose) @ np.append(thing.centre, 1.0)
        keys["centre_mm"] = inside[:3].tolist()
    return Grasp.model_validate(keys).model_dump(mode="json", exclude_defaults=True)
