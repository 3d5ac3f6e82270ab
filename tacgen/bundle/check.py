"""Checks of finished bundles: complete, in the right layout, finite, in range, and physically possible."""

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tacgen.base import atomic_file
from tacgen.base.errors import UserError
from tacgen.bundle import dataset, frame_notes, kept_files
from tacgen.bundle.bundle import Bundle, Dataset, Unfinished, read
from tacgen.bundle.schema import attributes, finite_problem
from tacgen.recipe import matching, scene_checks
from tacgen.sensor.yaml_source import KeyPath, at, describe, format_path, parents_first, parse_path, put

MAX_IMBALANCE = 1e-3  # largest force imbalance, and residual, over the contact force [-]
IMBALANCE_IN_FOLD = 5e-2  # the same in a frame with damped steps, which ends before it is in balance [-]
MAX_TENSION = 1e-3  # largest negative pressure by interpolation, over the frame's peak [-]
MIN_PRESSURE_SCALE = 0.01  # smallest pressure scale of a frame, over the scene's peak pressure [-]
MAX_COULOMB_EXCESS = 1e-3  # over friction x peak pressure [-]: four times the rounding of both maps to 13 bits
FLOAT32_ERROR = 1e-6  # rounding error of maps, over the frame's peak [-]
VISIBLE_CHANGE = {"/frames/height": 0.02, "/frames/marker_flow": 0.5}  # changes that a camera image must show [mm, px]
VISIBLE_FORCE_CHANGE = 0.05  # the same of the force, over the largest [-]
MAX_MISFIT = 0.05  # largest difference of a map's resultant from the force, over the force, and unseen share [-]
MISFIT_ROWS = {  # rows under /frames/quality, and what they mean
    "pressure_resultant": "/frames/pressure does not add up to the force, by {} of it",
    "traction_resultant": "/frames/traction does not add up to the force, by {} of it",
    "force_map_resultant": "/frames/force_map does not add up to the force, by {} of it",
    "unseen_force": "pressure and traction do not show gel that is hidden or outside the picture: {} of the normal"
    " forces",
}
UNIQUE_PATH, RESIDUAL_PATH = "/frames/quality/unique", "/frames/quality/residual"
DAMPED_STEPS_PATH = "/frames/quality/damped_steps"
FOLDED_NOTE = "forces may depend on the step size: the gel has folded, wrinkled or slipped suddenly"
NO_CONTACT_NOTE = f"the indenter {scene_checks.NO_CONTACT_MESSAGE}"  # beginning of a bundle's note
MAX_MATCH_ERROR = 1e-2  # largest difference of a force from the one that a table asks for, over that [-]
MAX_FLAT_RANGE = 2.0  # range of values of an image that counts as a single flat colour [counts of 255]
# (folder, digest) -> name of the scene. The digest covers the number and seed of a scene, not its name.
Seen = dict[tuple[Path, str], str]
ANY_PLANNED_KEYS = dataset.PlannedKeys(None)  # of a bundle that is in no folder with a plan


@dataclass(frozen=True)
class Finding:
    """A line about a file.

    `rejected` is a scene whose status says so, `error` is a file not to be trusted, `stray` is a bundle that is not of
    the plan in its folder, and which readers leave out; `note` is nothing wrong, but what a reader should know.
    """

    path: Path
    level: Literal["error", "incomplete", "rejected", "stray", "note"]
    message: str

    def __str__(self) -> str:
        return f"{self.path}: {self.level}: {self.message}"


def check(path: Path) -> list[Finding]:
    """Findings about a bundle, or about all bundles and part files in and below a folder; empty if there are none.

    Raises:
        UserError: `path` does not exist, or is a folder without a single bundle.
    """
    path = Path(path)
    if not path.is_dir():
        if not path.exists():
            raise UserError(f"{path}: no such file or folder")
        return _leftover(path) if atomic_file.is_part(path) else _file(path, {}, ANY_PLANNED_KEYS)
    if dataset.is_packed(path):
        return _packed(path)
    files, packs = dataset.files(path), dataset.packs(path)
    parts = [part for part in path.rglob("*") if atomic_file.is_part(part)]
    if not (files or packs or parts):
        raise UserError(f"{path}: no bundles (*.h5) in this folder")
    seen: Seen = {}
    keys = {folder: dataset.planned_keys(folder) for folder in {file.parent for file in files}}
    findings = []
    for file in sorted([*files, *parts]):
        findings += _leftover(file) if atomic_file.is_part(file) else _file(file, seen, keys[file.parent])
    return findings + [f for folder in packs for f in _packed(folder)]


def _leftover(path: Path) -> list[Finding]:
    return [Finding(path, "incomplete", "part file of a writer that was stopped or is still running")]


def _packed(folder: Path) -> list[Finding]:
    """Check every scene of a packed folder; if a shard is missing, only that is reported."""
    try:
        scenes = dataset.packed(folder)
    except UserError as error:
        return [Finding(folder, "error", line.removeprefix(f"{folder}: ")) for line in error.lines]
    seen: Seen = {}
    return [f for path, group in scenes for f in _file(path, seen, ANY_PLANNED_KEYS, group)]


def _file(path: Path, seen: Seen, keys: dataset.PlannedKeys, group: str = "/") -> list[Finding]:
    """Findings about a bundle in a folder with these planned keys."""
    if not keys.names(path):
        return [Finding(path, "stray", "is not of the plan in its folder: readers leave it out")]
    try:
        bundle = read(path, group)
        datasets = bundle.verify()
        name = path.name if group == "/" else group[1:]
        first = seen.setdefault((path.parent, bundle.attrs["digest"]), name)
        if first != name:
            return [Finding(path, "error", f"{name} is a copy of {first}: one of them was replaced")]
        findings = [Finding(path, "error", message) for message in _layout(bundle, datasets)]
        if not findings:  # the checks below rely on the layout
            findings = [Finding(path, "error", message) for rule in CHECK_RULES for message in rule(bundle)]
    except UserError as error:
        level: Literal["error", "incomplete"] = "incomplete" if isinstance(error, Unfinished) else "error"
        return [Finding(path, level, line.removeprefix(f"{path}: ")) for line in error.lines]
    if not findings and not keys.hold(bundle):
        return [Finding(path, "stray", "was made from other inputs than those of the plan: readers leave it out")]
    if bundle.attrs["status"] != "ok":
        findings.append(Finding(path, "rejected", bundle.attrs["reason"]))
    if all(finding.level == "rejected" for finding in findings):
        findings += [Finding(path, "note", message) for rule in NOTE_RULES for message in rule(bundle)]
    return findings


def _layout(bundle: Bundle, datasets: dict[str, Dataset]) -> Iterator[str]:
    """Compare the attributes of datasets with the table in schema.py; `read` has checked types and shapes."""
    for path, data in datasets.items():
        for name, wanted in attributes(path).items():
            if data.attrs.get(name) != wanted and (name != "rounding" or name in data.attrs):  # earlier ones have none
                yield f"{path} has {name} {data.attrs.get(name)!r}, expected {wanted!r}"


def _finite(bundle: Bundle) -> Iterator[str]:
    yield from filter(None, (finite_problem(path, bundle[path]) for path in bundle.shapes))


def _pose(bundle: Bundle) -> Iterator[str]:
    """A pose must be a rigid motion."""
    if "/frames/pose" in bundle:
        pose = bundle["/frames/pose"]
        turn = pose[:, :3, :3]
        error = np.abs(turn @ turn.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2)) + np.abs(np.linalg.det(turn) - 1)
        error += np.abs(pose[:, 3] - [0, 0, 0, 1]).max(axis=1)
        yield from _say_frames(error > 1e-9, "/frames/pose is no rigid motion")


def _images(bundle: Bundle) -> Iterator[str]:
    if "/frames/rgb" in bundle:
        rgb = bundle["/frames/rgb"]
        flat = np.ptp(rgb.reshape(len(rgb), -1, 3), axis=1).max(axis=1) <= MAX_FLAT_RANGE
        yield from _say_frames(flat, "/frames/rgb is one flat colour")


def _pressure(bundle: Bundle) -> Iterator[str]:
    if "/frames/pressure" in bundle:
        pressure = bundle["/frames/pressure"]
        low = pressure.min(axis=(1, 2))
        yield from _say_frames(low < -MAX_TENSION * pressure.max(axis=(1, 2)), "/frames/pressure pulls:", low, "MPa")


def _friction(bundle: Bundle) -> Iterator[str]:
    """Coulomb's limit at each sample; slip only where there is contact."""
    if "/frames/traction" in bundle and "/frames/pressure" in bundle:
        friction = float(bundle.recipe.get("contact", {}).get("friction", 0.0))
        pressure, size = bundle["/frames/pressure"], np.linalg.norm(bundle["/frames/traction"], axis=-1)
        excess = (size - friction * np.maximum(pressure, 0)).max(axis=(1, 2))
        peak = pressure.max(axis=(1, 2))
        peak = np.maximum(peak, MIN_PRESSURE_SCALE * peak.max(initial=0.0))  # light contact: relative to the scene
        allowed = (MAX_COULOMB_EXCESS * friction + FLOAT32_ERROR) * peak
        yield from _say_frames(excess > allowed, f"/frames/traction exceeds {friction:g} x pressure by", excess, "MPa")
    if "/frames/slip" in bundle and "/frames/contact" in bundle:
        outside = (bundle["/frames/slip"] & ~bundle["/frames/contact"]).any(axis=(1, 2))
        yield from _say_frames(outside, "/frames/slip is set where there is no contact")


def _quality(bundle: Bundle) -> Iterator[str]:
    """The quality figures that the solver recorded."""
    if "/frames/quality/force_balance" in bundle:
        balance = bundle["/frames/quality/force_balance"]
        folding = bundle[DAMPED_STEPS_PATH] > 0 if DAMPED_STEPS_PATH in bundle else np.zeros(len(balance), bool)
        most = np.where(folding, IMBALANCE_IN_FOLD, MAX_IMBALANCE)
        yield from _say_frames(balance > most, "forces do not balance:", balance, "of the force")
    if "/frames/quality/min_gap_mm" in bundle:
        gap = bundle["/frames/quality/min_gap_mm"]
        yield from _say_frames(gap <= 0, "the gel is inside the indenter: smallest gap", gap, "mm")
    if "/frames/grasp/balance" in bundle:
        balance = bundle["/frames/grasp/balance"]
        yield from _say_frames(balance > MAX_IMBALANCE, "both fingers do not balance:", balance, "of the grip force")


def _repeats(bundle: Bundle) -> Iterator[str]:
    """No frame repeats pose and force of the one before, except in holds, replays, grasps, and movements
    that go nowhere: a release of what is released, or whole turns. No image repeats while the gel moves.

    An image may repeat without contact, or when a ball without friction rotates about its own axis.
    """
    if bundle.frames < 2:
        return
    if all(path in bundle for path in ("/frames/pose", "/frames/force", "/frames/segment")):
        same = ~_changed(bundle["/frames/pose"]) & ~_changed(bundle["/frames/force"])
        still = ("hold", "replay", *(("lift", "tilt") if "/frames/grasp/object" in bundle else ()))
        held = np.array([kind in still for kind in bundle.segments[1:]])
        segment = bundle["/frames/segment"][1:]
        moves = np.isin(segment, segment[~same])
        yield from _say_frames(np.append(False, same & moves & ~held), "pose and force repeat the frame before")
    if "/frames/rgb" in bundle:
        moved = np.zeros(bundle.frames - 1, bool)
        for path, threshold in VISIBLE_CHANGE.items():
            if path in bundle:
                moved |= _changed(bundle[path], threshold)
        if "/frames/force" in bundle:
            force = bundle["/frames/force"]
            moved |= _changed(force, VISIBLE_FORCE_CHANGE * float(np.abs(force).max()))
        stale = ~_changed(bundle["/frames/rgb"].astype(np.int16)) & moved
        yield from _say_frames(np.append(False, stale), "/frames/rgb repeats the frame before although the gel moved")


def _markers(bundle: Bundle) -> Iterator[str]:
    """Marker flow must be position minus reference."""
    paths = ("/frames/markers", "/frames/marker_flow", "/reference/markers")
    if all(path in bundle for path in paths):
        markers, flow, reference = (bundle[path].astype(float) for path in paths)
        error = np.abs(markers - reference - flow).max(axis=(1, 2), initial=0.0)
        yield from _say_frames(error > 1e-3, "/frames/marker_flow is not markers less reference, off by", error, "px")


def _values(bundle: Bundle) -> Iterator[str]:
    """Varied values stand in the resolved recipe and sensor, where children are laid over their parents."""
    values: dict[str, Any] = json.loads(bundle.attrs.get("values", "{}"))
    recipe, known = bundle.recipe, "sensor_document" in bundle.attrs
    if (drawn := values.pop("sensor", sensor := recipe.get("sensor"))) != sensor:
        yield _told("sensor", drawn, sensor)
    document = {**recipe, "sensor": json.loads(bundle.attrs["sensor_document"]) if known else None}
    wanted, paths = document, dict[str, KeyPath]()
    for name in parents_first(name for name in values if known or not name.startswith("sensor.")):
        try:
            wanted = put(wanted, parse_path(name), values[name])
            paths[name] = parse_path(name)
        except (LookupError, ValueError):
            yield _told(name, values[name], None)
    for name, path in paths.items():
        if not _holds(at(document, path), at(wanted, path)):
            yield _told(name, values[name], at(document, path))


def _files(bundle: Bundle) -> Iterator[str]:
    """Files in the bundle are those whose hashes the recipe gives."""
    for where, content in kept_files.contents(bundle).items():
        named = *where[:-1], "sha256"
        if at(bundle.recipe, named) != hashlib.sha256(content).hexdigest():
            yield f"/files/{format_path(where)} is not the file of the recipe's {format_path(named)}"


def _told(name: str, value: Any, found: Any) -> str:
    return f"{name} is {describe(value)} among its values, and {describe(found)} in its recipe"


def _holds(found: Any, wanted: Any) -> bool:
    """Whether a value of a resolved document is one that was drawn: mappings are completed, `outputs` sorted, and one
    number may stand for three."""
    if isinstance(wanted, dict):
        return isinstance(found, dict) and all(_holds(found.get(key), value) for key, value in wanted.items())
    if not isinstance(found, list):
        return bool(found == wanted)
    if not isinstance(wanted, list):
        return all(each == wanted for each in found)
    same = len(found) == len(wanted) and all(map(_holds, found, wanted))
    return same or (all(isinstance(each, str) for each in wanted) and set(found) == set(wanted))


def misfits(bundle: Bundle) -> dict[str, np.ndarray]:
    """Rows of MISFIT_ROWS that a bundle has, each (N,), scaled down in light contact."""
    rows = {name: path for name in MISFIT_ROWS if (path := f"/frames/quality/{name}") in bundle}
    if not rows or "/frames/force" not in bundle:
        return {}
    force = np.linalg.norm(bundle["/frames/force"], axis=1)
    scale = force / np.maximum(np.maximum(force, MIN_PRESSURE_SCALE * force.max(initial=0.0)), np.finfo(float).tiny)
    return {name: scale * bundle[path] for name, path in rows.items()}


def _maps(bundle: Bundle) -> Iterator[str]:
    """Whether maps add up to the force."""
    for name, value in misfits(bundle).items():
        yield from _say_frames(value > MAX_MISFIT, MISFIT_ROWS[name].format(f"{value.max(initial=0.0):.2g}"))


def _contact(bundle: Bundle) -> Iterator[str]:
    """Whether the scene touches at all, as its run has found."""
    yield from (note for note in json.loads(bundle.attrs.get("notes", "[]")) if note.startswith(NO_CONTACT_NOTE))


def _folds(bundle: Bundle) -> Iterator[str]:
    """Frames whose forces may depend on the step size."""
    if UNIQUE_PATH in bundle:
        folded = ~bundle[UNIQUE_PATH]
        off = bundle[RESIDUAL_PATH][folded].max(initial=0.0)
        more = f", by {off:.1%} out of balance at most" if off > MAX_IMBALANCE else ""
        yield from _say_frames(folded, FOLDED_NOTE + more)


def _match(bundle: Bundle) -> Iterator[str]:
    """A frame whose force is matched has it, or a note that says why not."""
    paths = [f"/frames/match/{name}" for name in ("asked_force", "reached_force", "met")]
    if all(path in bundle for path in paths):
        asked, reached, met = (bundle[path] for path in paths)
        off = np.abs(reached - asked)
        wrong = met & (asked >= matching.MIN_MATCHED_FORCE_N) & (off > MAX_MATCH_ERROR * np.abs(asked))
        yield from _say_frames(wrong, "the force is not the one that the table asks for: off by", off, "N")
        yield from _say_frames(~met & ~np.array([*map(bool, frame_notes.of(bundle))]), "no note says why it is not met")


def _unmet(bundle: Bundle) -> Iterator[str]:
    """Frames that are not as a table asks."""
    yield from frame_notes.summary([*filter(None, frame_notes.of(bundle))], bundle.frames)


Rule = Callable[[Bundle], Iterator[str]]
CHECK_RULES: tuple[Rule, ...] = (
    *(_finite, _pose, _images, _pressure, _friction, _quality, _repeats, _markers, _values, _files, _match),
)
NOTE_RULES: tuple[Rule, ...] = (_maps, _contact, _folds, _unmet)


def _changed(values: np.ndarray, threshold: float = 0.0) -> np.ndarray:
    """(N - 1,) whether any number of frame k + 1 differs from frame k by more than the threshold."""
    return np.array([np.abs(b - a).max(initial=0) > threshold for a, b in pairwise(values)], bool)


def _say_frames(bad: np.ndarray, what: str, values: np.ndarray | None = None, unit: str = "") -> Iterator[str]:
    """One line for all bad frames (N,), with the worst value if there are values."""
    frames = np.flatnonzero(bad)
    if len(frames):
        worst = "" if values is None else f" {values[frames][np.abs(values[frames]).argmax()]:.3g} {unit}"
        names = ", ".join(map(str, frames[:6])) + (f" and {len(frames) - 6} more" if len(frames) > 6 else "")
        yield f"{what}{worst} (frame{'s' if len(frames) > 1 else ''} {names})"
