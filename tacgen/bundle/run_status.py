"""Progress of a dataset's folder: the state of each planned scene, from its bundle or from the journal."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import NonNegativeFloat

from tacgen.base import atomic_file
from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle, read
from tacgen.bundle.journal import PlannedScene, read_journal, read_plan
from tacgen.bundle.stored_json import Stored
from tacgen.bundle.stored_json import read as read_json

SCENE_STATES = ("ok", "rejected", "failed", "damaged", "at work", "waiting")


@dataclass(frozen=True)
class SceneStatus:
    """One planned scene. If `damaged`, `run` makes it again."""

    name: str
    state: str
    reason: str
    frames: int  # stored, or planned if there is no bundle
    path: Path
    values: dict[str, Any] = field(default_factory=dict)  # what was varied
    seconds: dict[str, float] = field(default_factory=dict)  # by stage


@dataclass(frozen=True)
class Survey:
    """All scenes of a folder, in the plan's order."""

    name: str
    folder: Path
    scenes: tuple[SceneStatus, ...]

    def count(self) -> dict[str, int]:
        """Scenes by state; states that no scene is in are left out."""
        states = Counter(scene.state for scene in self.scenes)
        return {state: states[state] for state in SCENE_STATES if states[state]}


def survey(folder: Path) -> Survey:
    """The state of a folder that `run` wrote. Bundles are opened, but not verified as by `check`.

    Raises:
        UserError: there is no plan in it.
    """
    name, scenes = opened(folder)
    return Survey(name, folder, tuple(scene for scene, _ in scenes))


def opened(folder: Path, known: Iterable[Bundle] = ()) -> tuple[str, Iterator[tuple[SceneStatus, Bundle | None]]]:
    """The plan's name, and each scene's state with its bundle, if that is ok or rejected; raises as `survey`.

    `known` bundles of the folder are not opened again.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: no such folder")
    plan = read_plan(folder)
    if plan is None:
        raise UserError(f"{folder}: holds no plan.json: `tacgen run` writes one beside its bundles")
    failures: dict[str, str] = {}
    for event in read_journal(folder):
        if event.event == "scene":
            failures[event.scene] = event.reason if event.status == "failed" else ""
    there = {bundle.path.stem: bundle for bundle in known}
    return plan.name, (
        _scene(folder, row, failures.get(row.scene.partition("-L")[0].partition("-R")[0], ""), there.get(row.scene))
        for row in plan.scenes
    )


class Timing(Stored):
    """The contents of `<scene>.timing.json`."""

    seconds: dict[str, NonNegativeFloat]


def _scene(folder: Path, row: PlannedScene, failure: str, known: Bundle | None) -> tuple[SceneStatus, Bundle | None]:
    path = folder / f"{row.scene}.h5"

    def found(state: str, reason: str = "", frames: int = row.frames) -> SceneStatus:
        return SceneStatus(row.scene, state, reason, frames, path, row.values, _seconds(path))

    if atomic_file.is_claimed(path):
        return found("at work"), None
    if path.exists():
        try:
            bundle = known or read(path)
        except UserError as error:
            return found("damaged", error.lines[0].removeprefix(f"{path}: ")), None
        if bundle.attrs["input_key"] != row.key:
            return found("waiting", "its place is taken by a bundle of other inputs"), None
        return found(bundle.attrs["status"], bundle.attrs["reason"], bundle.frames), bundle
    return (found("failed", failure) if failure else found("waiting")), None


def _seconds(path: Path) -> dict[str, float]:
    """Seconds of each stage from the file beside the bundle; empty if it cannot be read."""
    try:
        return read_json(Timing, path.with_suffix(".timing.json")).seconds
    except UserError:
        return {}
