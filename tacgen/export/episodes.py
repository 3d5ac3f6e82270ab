"""Bundles as episodes of a robot's data set: one for each scene, or for each contact on several sensors or fingers."""

import json
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tacgen.base.errors import LeftOut
from tacgen.base.output_file import add
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.caption import task
from tacgen.bundle.dataset import contacts, some
from tacgen.bundle.dataset import role as role_of
from tacgen.bundle.schema import entry
from tacgen.bundle.splits import SPLITS, assigned
from tacgen.export import names, poses

SINGLE_SENSOR = "tactile"  # stands for the sensor in names of episodes with a single sensor


class Episode(NamedTuple):
    """A contact with its frames on every sensor."""

    name: str  # of its first scene
    split: str  # train, val or test
    scenes: dict[str, Bundle]  # by the sensor's name or the finger, or SINGLE_SENSOR
    sources: dict[str, str]  # names of the scenes, by the same keys

    @property
    def frames(self) -> int:
        """Number of frames that all sensors have: one may end early, before a fold of the gel."""
        return min(bundle.frames for bundle in self.scenes.values())

    @property
    def first(self) -> Bundle:
        """The scene on the first sensor."""
        return next(iter(self.scenes.values()))

    @property
    def task(self) -> str:
        """The instruction of the contact."""
        return task(self.first)


def episodes(bundles: Sequence[Bundle]) -> list[Episode]:
    """All contacts, those for training first, then those for validation and test.

    A contact that one of the sensors or fingers lacks is left out with a LeftOut warning.
    """
    parts, named = assigned(bundles), names(bundles)
    groups = [{role_of(bundles[i]): i for i in together} for together in contacts(bundles)]
    most = max(groups, key=len)
    if len(most) == 1:
        groups = [{SINGLE_SENSOR: i} for i in range(len(bundles))]
    made, lacking = [], list[str]()
    for group in groups:
        if len(most) == 1 or group.keys() == most.keys():
            first = next(iter(group.values()))
            scenes = {role: bundles[i] for role, i in group.items()}
            sources = {role: named[i] for role, i in group.items()}
            made.append(Episode(named[first], parts[first], scenes, sources))
        else:
            lacking += [named[i] for i in group.values()]
    if lacking:
        where = bundles[0].path.parent
        warnings.warn(f"{where}: left out {some(lacking)}: not on all of {', '.join(most)}", LeftOut, stacklevel=2)
    return sorted(made, key=lambda episode: SPLITS.index(episode.split))


def split_ranges(all_episodes: Sequence[Episode]) -> dict[str, tuple[int, int]]:
    """The first episode of each split that has any, and the one after its last."""
    ends, start = dict[str, tuple[int, int]](), 0
    for name in SPLITS:
        if count := sum(episode.split == name for episode in all_episodes):
            ends[name] = (start, start + count)
            start += count
    return ends


def common(bundles: Sequence[Bundle], kept: Callable[[str], bool]) -> dict[str, tuple[tuple[int, ...], str]]:
    """Datasets of a frame that all bundles have with one shape and that are `kept`: path -> shape of a frame, type."""
    first, *others = bundles
    alike = {}
    for path, shape in first.shapes.items():
        same = all(other.shapes.get(path, ())[1:] == shape[1:] and path in other for other in others)
        if path.startswith("/frames/") and kept(path) and same:
            alike[path] = (shape[1:], entry(path).dtype)
    return alike


def state_and_action(bundle: Bundle, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """The indenter's pose (frames, 7) as of `poses`, and that of the next frame, which for the last is its own."""
    state = poses(bundle["/frames/pose"][:frames])
    return state, np.vstack([state[1:], state[-1:]])


def write_splits(all_episodes: Sequence[Episode], out: Path) -> Path:
    """`out/splits.json`: split -> episode's name -> the names of its scenes by sensor or finger."""
    listed = {
        split: {episode.name: episode.sources for episode in all_episodes[first:end]}
        for split, (first, end) in split_ranges(all_episodes).items()
    }
    return add(out / "splits.json", json.dumps(listed, indent=1) + "\n")
