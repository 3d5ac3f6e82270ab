"""Contacts of other simulators solved again: their logs become a recipe, whose frames are compared with their forces.

read the logs -> select the rows near contact -> write tables and a recipe -> run it -> compare the forces
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacgen import atomic_file, output_file, regular_file
from tacgen.bundle.bundle import read
from tacgen.bundle.resume import SceneResult
from tacgen.errors import UserError
from tacgen.recipe import assets, loading, plan, scene_of_row
from tacgen.recipe.trajectory import Placement, Replay, Start
from tacgen.recipe.trajectory_checks import MAX_FRAMES
from tacgen.replay import comparison, contact_log, selection
from tacgen.replay.comparison import Compared
from tacgen.replay.contact_log import ContactLog, Conventions
from tacgen.sensor.validation_messages import validate
from tacgen.sensor.yaml_source import Tree, at

Array = np.ndarray
RECIPE = "recipe.yaml"
LOOKED_AT = 2000  # rows of a log without contact, most of which are far away
LARGEST = 2**28  # of the files that an earlier call wrote [bytes]
TITLES = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")


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


@dataclass(frozen=True)
class Prepared:
    """A recipe that replays logs, one scene each."""

    recipe: Path
    sensor_pose: Placement  # in the recorded sensor body or, without that, in the world
    logs: tuple[ContactLog, ...]  # the rows that are solved, in the order of the scenes
    sets: tuple[str, ...]  # overrides to run it with
    notes: tuple[str, ...]


def prepare(
    paths: Sequence[Path],
    recipe: str,
    out: Path,
    how: Conventions,
    choice: Choice,
    *,
    environments: Sequence[int] = (),
    sets: Sequence[str] = (),
    overwrite: bool = False,
) -> Prepared:
    """Read logs, and write a recipe with a table of poses for each of them into the folder `out`.

    Args:
        recipe: file or name of a recipe, of which all but the movements is used; of a single `replay`, sensor_pose,
            indenter_pose, units and columns.
        environments: of simulators that run many at once: each is a log.
        sets: overrides as on the command line.
        overwrite: replace other files of these names.

    Raises:
        UserError: a log or the recipe is not valid; no row comes near contact; files of these names are in the way.
    """
    base = assets.recipe_path(recipe)
    tree = loading.merged(base, sets)
    template, given = _template(tree)
    row = _without_movements(tree)
    how = replace(how, units=how.units or template.units or "", columns=template.columns)
    logs = [log for path in paths for log in contact_log.read(path, how, environments)]
    indenter = row.recipe.indenter
    if indenter.shape == "mesh":
        indenter = indenter.model_copy(update={"file": str(row.mesh_path.resolve())})
    gel = scene_of_row.gel_of(row.sensor, row.solid_path if row.sensor.gel.solid else None)
    body = selection.body_of(indenter, given, np.eye(3)[None])
    chosen = [_chosen(log, body, gel, template.sensor_pose, choice) for log in logs]
    touching = [log for log in chosen if isinstance(log, ContactLog)]
    notes = [text for text in chosen if isinstance(text, str)]
    if not touching:
        raise UserError(notes)
    turns = [selection.relative(log, template.sensor_pose, Placement())[:, :3, :3] for log in touching]
    body = selection.body_of(indenter, given, np.concatenate(turns))
    notes += _notes(touching)
    extra = _uncertainty(row, notes)
    move = {
        "sensor_pose": template.sensor_pose.model_dump(mode="json"),
        "indenter_pose": body.pose.model_dump(mode="json"),
    }
    files = {f"log-{k:05d}.csv": _table(log) for k, log in enumerate(touching)}
    up = {"indenter": {"up": body.indenter.up}} if body.indenter.shape == "mesh" else {}
    source = recipe if base == assets.folder("recipes") / f"{recipe}.yaml" else str(base.resolve())
    start = {"start": Start().model_dump()} if "start" in tree.data else {}
    left = tuple(text for text in sets if not text.strip().startswith("trajectory"))  # that is in the recipe now
    files[RECIPE] = _recipe(source, left, move, list(files), start | up | extra)
    _write(files, out, [base, *paths], overwrite)
    return Prepared(out / RECIPE, template.sensor_pose, tuple(touching), left, tuple(notes))


def _template(tree: Tree) -> tuple[Replay, Placement | None]:
    """The replay in the recipe with its defaults, and the indenter's pose in the recorded body if it says that."""
    steps = at(tree.data, ("trajectory",))
    first = steps[0] if isinstance(steps, list) and len(steps) == 1 and isinstance(steps[0], dict) else {}
    said = first.get("replay") or {}
    if not isinstance(said, dict):
        said = {}
    asked = {key: said[key] for key in ("sensor_pose", "indenter_pose", "units", "columns") if key in said}
    found, wrong = validate(Replay, {"file": "log.csv", **asked})
    if found is None:
        here = ("trajectory", 0, "replay")
        raise UserError(replace(issue, path=(*here, *issue.path)).point(tree) for issue in wrong)
    return found, found.indenter_pose if "indenter_pose" in said else None


def _without_movements(tree: Tree) -> Any:
    """The scene of a recipe before anything moves. Raises UserError: it is not valid, or of a kind that has no log."""
    for key in ("vary", "sensors", "grasp"):
        if tree.data.get(key) is not None:
            raise UserError(
                f"{key}: a log is of one sensor and one object as they were: leave it out, or --set {key}=null"
            )
    hold = {"frames": 1, **({"duration_s": 1.0} if tree.data.get("dynamics") else {})}
    still = tree.replaced(("trajectory",), Tree([{"hold": hold}])).without("start")
    (row,) = plan.expand(loading.read(still)).rows
    return row


def _chosen(
    log: ContactLog, body: selection.RecordedBody, gel: Any, sensor_pose: Placement, choice: Choice
) -> ContactLog | str:
    """The rows of a log that are solved, or a line that says that there are none."""
    some = log.some(np.arange(len(log))[choice.first : None if choice.last is None else choice.last + 1])
    if not len(some):
        return f"{log.name}: has {len(log)} rows, and none of those that --rows names"
    poses = selection.relative(some, sensor_pose, body.pose)
    gaps = selection.gaps(body, gel, poses, choice.near_mm)
    if selection.least(body, gel, gaps.min(), poses[gaps.argmin()]) > 0:
        return _missed(some, body, gel, poses)
    solved = some.some(selection.runs(gaps <= choice.near_mm + selection.BETWEEN, gaps <= 0, choice.every))
    if len(solved) > MAX_FRAMES:
        raise UserError(
            f"{log.name}: {len(solved)} rows are near contact, at most {MAX_FRAMES} can be: --every takes some"
        )
    return solved


def _missed(log: ContactLog, body: selection.RecordedBody, gel: Any, poses: Array) -> str:
    """A line about a log without contact: how close it comes, in one of LOOKED_AT of its rows."""
    rows = np.arange(len(log))[:: -(-len(log) // LOOKED_AT)]
    gaps = selection.gaps(body, gel, poses[rows], np.inf)
    nearest = rows[gaps.argmin()]
    gap = selection.least(body, gel, gaps.min(), poses[nearest])
    felt = 0.0 if log.force is None else float(np.linalg.norm(log.force, axis=1).max())
    theirs = f", though its simulator has up to {felt:.3g} N" if felt else ""
    where = f"closest approach {gap:.3g} mm, in row {log.row[nearest]}"
    return f"{log.name}: no contact{theirs}: {where}: check units, sensor_pose and indenter_pose"


def _notes(logs: list[ContactLog]) -> list[str]:
    notes = []
    if silent := [log.name for log in logs if log.force is None]:
        notes.append(f"{', '.join(silent)}: no force in the log: there is nothing to compare")
    if smooth := [log.name for log in logs if not log.friction]:
        notes.append(f"{', '.join(smooth)}: its forces are without friction: tangential forces are not compared")
    return notes


def _uncertainty(row: Any, notes: list[str]) -> dict[str, Any]:
    """The uncertainty by the mesh, where the recipe has none and it can be computed."""
    recipe = row.recipe
    if recipe.uncertainty is not None:
        return {}
    if recipe.dynamics or recipe.contact.formulation == "ipctk" or row.sensor.gel.viscous:
        notes.append("no error bar: uncertainty is not possible with dynamics, viscoelasticity or ipctk")
        return {}
    return {"uncertainty": {"mesh": True}}


def _table(log: ContactLog) -> str:
    """The rows of a log as a table of poses."""
    from scipy.spatial.transform import Rotation

    def columns(poses: Array) -> Array:
        return np.hstack([poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat(scalar_first=True)])

    titles, parts = [*TITLES], [columns(log.body)]
    if log.sensor is not None:
        titles += [f"sensor_{title}" for title in TITLES]
        parts.append(columns(log.sensor))
    if log.force is not None:
        titles += [f"force_{axis}_n" for axis in "xyz"]
        parts.append(log.force)
    lines = [f"# {log.name}: poses in the world frame, force on the sensor", ",".join(["row", "time_s", *titles])]
    for row, time, values in zip(log.row.tolist(), log.time.tolist(), np.hstack(parts).tolist(), strict=True):
        lines.append(",".join(map(repr, (row, time, *values))))
    return "\n".join(lines) + "\n"


def _recipe(base: str, sets: Sequence[str], move: dict[str, Any], tables: list[str], more: dict[str, Any]) -> str:
    """The text of a recipe that replays tables, each in a scene of its own."""
    overrides = "".join(f" --set {json.dumps(text)}" for text in sets)
    vary = {"method": "grid", "over": {"trajectory[0].replay.file": {"choice": tables}}} if len(tables) > 1 else None
    keys = {"trajectory": [{"replay": {"file": tables[0], **move}}], **more}
    lines = [f"# tacgen run {RECIPE} -o OTHER_FOLDER{overrides}", f"extends: {json.dumps(base)}"]
    lines += [f"{key}: {json.dumps(value)}" for key, value in {**keys, "vary": vary}.items()]
    return "\n".join(lines) + "\n"


def _write(files: dict[str, str], out: Path, inputs: Sequence[Path], overwrite: bool) -> None:
    """Write text files into a folder. One that is there with other contents, an input, or the results' name in a folder
    of something else is in the way."""
    if not (out / RECIPE).exists():
        for name in comparison.FILES:
            output_file.refuse(out / name, overwrite=overwrite)
    out.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        if not (out / name).is_file() or regular_file.read_bytes(out / name, LARGEST) != text.encode():
            output_file.refuse(out / name, inputs, overwrite=overwrite)
    for name, text in files.items():
        atomic_file.write(out / name, text.encode())


def compared(prepared: Prepared, results: Sequence[SceneResult]) -> list[Compared]:
    """The frames of each finished scene beside the log's rows; a scene that failed has no bundle and is left out."""
    found = []
    for log, result in zip(prepared.logs, results, strict=True):
        if result.status != "failed":
            found.append(comparison.compare(log, read(result.path), prepared.sensor_pose))
    return found
