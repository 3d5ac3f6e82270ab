"""Opens recorded episodes: which reader it takes is seen from what is in the path."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tacgen.base.errors import UserError
from tacgen.touch import columns as columns_file
from tacgen.touch import kinematics, lerobot_data
from tacgen.touch.recording import Recording

EPISODE_FILES = "a LeRobot folder (meta/info.json)"


def open_source(
    path: Path,
    model: Path | None = None,
    objects: Iterable[str] = (),
    columns: Path | Mapping[str, Any] | None = None,
) -> Recording:
    """The episodes in a file or folder, a Source.

    Args:
        path: a LeRobot folder of version 3.
        model: MJCF or URDF whose joints the episodes have.
        objects: BODY of the model, NAME=mesh file, or NAME={shape: ...} as a recipe has it; without any, all bodies
            of the model that have a free joint.
        columns: see tacgen.touch.columns.

    Raises:
        UserError: nothing there can be read; the model or a mesh cannot.
    """
    given, known = columns_file.read(columns), kinematics.opened(model) if model else None
    asked = {name: text for name, _, text in (each.partition("=") for each in objects)}
    if not path.exists():
        raise UserError(f"{path}: there is no such file or folder")
    if (path / lerobot_data.INFO_PATH).is_file():
        folder = lerobot_data.opened(path, known)
        return Recording(path, "lerobot", given.fps or folder.fps, len(folder), folder.rows, asked, given)
    raise UserError(f"{path}: is none of {EPISODE_FILES}")
