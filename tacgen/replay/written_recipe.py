"""The files that replay logs: a table of poses for each, and a recipe that `tacgen run` takes."""

import json
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import output_file
from tacgen.base.errors import UserError, printable
from tacgen.replay import comparison
from tacgen.replay.contact_log import ContactLog
from tacgen.sensor.yaml_source import quoted

Array = np.ndarray
RECIPE_FILE = "recipe.yaml"
POSE_TITLES = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")


def table(log: ContactLog) -> str:
    """The rows of a log as a table of poses."""
    titles, parts = [*POSE_TITLES], [pose_columns(log.body)]
    if log.sensor is not None:
        titles += [f"sensor_{title}" for title in POSE_TITLES]
        parts.append(pose_columns(log.sensor))
    if log.force is not None:
        titles += [f"force_{axis}_n" for axis in "xyz"]
        parts.append(log.force)
    return table_of(log, "poses in the world frame, force on the sensor", titles, np.hstack(parts))


def pose_columns(poses: Array) -> Array:
    """Positions and quaternions (n, 7), as of POSE_TITLES, of poses (n, 4, 4)."""
    from scipy.spatial.transform import Rotation

    return np.hstack([poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat(scalar_first=True)])


def table_of(log: ContactLog, what: str, titles: Sequence[str], numbers: Array) -> str:
    """A table of numbers (n, k) in the n rows of a log, with a comment that says what they are."""
    lines = [f"# {log.name}: {what}", ",".join(["row", "time_s", *titles])]
    for row, time, values in zip(log.row.tolist(), log.time.tolist(), numbers.tolist(), strict=True):
        lines.append(",".join(map(repr, (row, time, *values))))
    return "\n".join(lines) + "\n"


def text(base: Path, sets: Sequence[str], move: dict[str, Any], tables: list[str], more: dict[str, Any]) -> str:
    """The text of a recipe that replays tables, each in a scene of its own."""
    overrides = "".join(f" --set {shlex.quote(' '.join(text.split()))}" for text in sets)
    vary = {"method": "grid", "over": {"trajectory[0].replay.file": {"choice": tables}}} if len(tables) > 1 else None
    keys = {"trajectory": [{"replay": {"file": tables[0], **move}}], **more}
    lines = [f"# {printable(f'tacgen run {RECIPE_FILE} -o OTHER_FOLDER{overrides}')}", f"extends: {quoted(base)}"]
    lines += [f"{key}: {json.dumps(value)}" for key, value in {**keys, "vary": vary}.items()]
    return "\n".join(lines) + "\n"


def write(files: dict[str, str], out: Path, inputs: Sequence[Path], overwrite: bool) -> None:
    """Write text files into a folder.

    Raises:
        UserError: one of `inputs` has the name of one, or of a result or bundle; without `overwrite`, one is there with
            other contents, or a result that tacgen did not write or that somebody changed.
    """
    for name in comparison.COMPARISON_FILES:
        output_file.refuse(out / name, inputs, overwrite=overwrite, kind="result")
    for path in inputs:
        if path.resolve().parent == out.resolve() and re.fullmatch(r"scene-\d+\.h5", path.resolve().name):
            raise UserError(f"{path}: is a log, and has the name of a bundle in {out}: choose another folder")
    for name, text in files.items():
        if not output_file.holds(out / name, text.encode()):
            output_file.refuse(out / name, inputs, overwrite=overwrite)
    for name, text in files.items():
        output_file.put(out / name, text.encode(), inputs, overwrite=overwrite, within=out)
