"""From logs and a recipe to a recipe that replays the logs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base.errors import UserError
from tacgen.recipe import assets, loading, plan, scene_of_row
from tacgen.recipe.row import Row
from tacgen.recipe.trajectory import Placement, Replay, Start
from tacgen.replay import log_file, selection, written_recipe
from tacgen.replay.contact_log import ContactLog, Conventions
from tacgen.replay.written_recipe import RECIPE_FILE
from tacgen.sensor.validation_messages import validate
from tacgen.sensor.yaml_source import Tree, at

WRITTEN_KEYS = ("trajectory", "vary", "start")  # keys of the recipe that is written, which no override may change


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
    choice: selection.Choice,
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
    logs = [log for path in paths for log in log_file.read(path, how, environments)]
    indenter = row.recipe.indenter
    if indenter.shape == "mesh":
        indenter = indenter.model_copy(update={"file": str(row.mesh_path.resolve())})
    gel = scene_of_row.gel_of(row.sensor, row.solid_path)
    body = selection.body_of(indenter, given, np.eye(3)[None])
    chosen = [selection.chosen(log, body, gel, template.sensor_pose, choice) for log in logs]
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
    files = {f"log-{k:05d}.csv": written_recipe.table(log) for k, log in enumerate(touching)}
    up = {"indenter": {"up": body.indenter.up}} if body.indenter.shape == "mesh" else {}
    source = Path(recipe) if base == assets.folder("recipes") / f"{recipe}.yaml" else base.resolve()
    start = {"start": Start().model_dump()} if "start" in tree.data else {}
    left = tuple(text for text in sets if not text.strip().startswith(WRITTEN_KEYS))
    grazes = {"may_miss": True}  # a log whose closest row may touch nothing
    files[RECIPE_FILE] = written_recipe.text(source, left, move, list(files), start | up | extra | grazes)
    written_recipe.write(files, out, [base, *paths], overwrite)
    return Prepared(out / RECIPE_FILE, template.sensor_pose, tuple(touching), left, tuple(notes))


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


def _without_movements(tree: Tree) -> Row:
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


def _notes(logs: list[ContactLog]) -> list[str]:
    notes = []
    if silent := [log.name for log in logs if log.force is None]:
        notes.append(f"{', '.join(silent)}: no force in the log: there is nothing to compare")
    if smooth := [log.name for log in logs if not log.friction]:
        notes.append(f"{', '.join(smooth)}: its forces are without friction: tangential forces are not compared")
    return notes


def _uncertainty(row: Row, notes: list[str]) -> dict[str, Any]:
    """The uncertainty by the mesh, where the recipe has none and it can be computed."""
    recipe = row.recipe
    if recipe.uncertainty is not None:
        return {}
    if recipe.dynamics or row.sensor.gel.viscous:
        notes.append("no error bar: uncertainty is not possible with dynamics or viscoelasticity")
        return {}
    return {"uncertainty": {"mesh": True}}
