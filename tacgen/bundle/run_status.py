"""How far a dataset's folder is: each planned scene by its bundle, and where there is none by the journal."""

import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tacgen import atomic_file
from tacgen.bundle.bundle import read
from tacgen.bundle.journal import read_journal, read_plan
from tacgen.errors import UserError

STATES = ("ok", "rejected", "failed", "damaged", "at work", "waiting")


@dataclass(frozen=True)
class Scene:
    """One planned scene. `damaged` has a file that `run` will make again."""

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
    scenes: tuple[Scene, ...]

    def count(self) -> dict[str, int]:
        """Scenes by state; states that no scene is in are left out."""
        found = Counter(scene.state for scene in self.scenes)
        return {state: found[state] for state in STATES if found[state]}


def survey(folder: Path) -> Survey:
    """Look at a folder that `run` wrote; bundles are opened but not read through, which is `check`'s work.

    Raises:
        UserError: there is no plan in it.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: no such folder")
    plan = read_plan(folder)
    if plan is None:
        raise UserError(f"{folder}: holds no plan.json: `tacgen run` writes one beside its bundles")
    failures: dict[str, str] = {}
    for event in read_journal(folder):
        if event.get("event") == "scene":
            failures[event["scene"]] = event["reason"] if event["status"] == "failed" else ""
    scenes = (_scene(folder, row, failures.get(row["scene"], "")) for row in plan["scenes"])
    return Survey(plan["name"], folder, tuple(scenes))


def _scene(folder: Path, row: dict[str, Any], failure: str) -> Scene:
    name, path = row["scene"], folder / f"{row['scene']}.h5"

    def found(state: str, reason: str = "", frames: int = row["frames"]) -> Scene:
        return Scene(name, state, reason, frames, path, row["values"], _seconds(path))

    if atomic_file.is_claimed(path):
        return found("at work")
    if path.exists():
        try:
            bundle = read(path)
        except UserError as error:
            return found("damaged", error.lines[0].removeprefix(f"{path}: "))
        if bundle.attrs["input_key"] != row["key"]:
            return found("waiting", "its place is taken by a bundle of other inputs")
        return found(bundle.attrs["status"], bundle.attrs["reason"], bundle.frames)
    return found("failed", failure) if failure else found("waiting")


def _seconds(path: Path) -> dict[str, float]:
    """What each stage took, from the file beside the bundle; empty if there is none."""
    try:
        timing = json.loads(path.with_suffix(".timing.json").read_text(encoding="utf-8"))
        return {str(stage): float(value) for stage, value in timing["seconds"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
