"""Zarr buffers of the Universal Manipulation Interface: poses of the grippers' tips and widths.

    https://github.com/real-stanford/universal_manipulation_interface

`data/robotK_eef_pos` and `robotK_eef_rot_axis_angle` are the pose between the finger tips: x towards the right finger,
z out of the gripper; `robotK_gripper_width` is the distance of the fingers, `meta/episode_ends` where episodes end.
Bodies are `robotK`, and `robotK_left` and `robotK_right`, whose frames are those of sensors on the fingers: origin in
the middle of the face, z to the other finger, y to the tip. Poses of objects are of other arrays, which columns name.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base.errors import UserError
from tacgen.touch import columns as columns_file
from tacgen.touch.columns import ColumnNames, Named
from tacgen.touch.kinematics import M_TO_MM, Kinematics
from tacgen.touch.recording import RecordedRows

Array = np.ndarray
UMI_FPS = 60000 / 1001  # of its cameras [1/s]
# turns of the sensors' frames in the gripper's: z to the other finger, y to the tip
LEFT_TURN, RIGHT_TURN = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])


@dataclass(frozen=True)
class Buffer:
    """An open buffer. ends: places after the last row of each episode."""

    path: Path
    fps: float
    data: Any
    ends: Array
    model: Kinematics | None = None

    def __len__(self) -> int:
        return len(self.ends)

    def rows(self, number: int) -> RecordedRows:
        """One episode by its place. Raises UserError: arrays are missing or cannot be read."""
        start, end = int(self.ends[number - 1]) if number else 0, int(self.ends[number])

        def get(name: str) -> Named:
            if name not in self.data:
                raise KeyError(", ".join(sorted(self.data)))
            values = np.asarray(self.data[name][start:end])
            return values.reshape(len(values), -1), ()

        bodies: dict[str, Array] = {}
        width = None
        for robot in sorted(match[1] for name in self.data if (match := re.fullmatch(r"(robot\d+)_eef_pos", name))):
            try:
                pose = np.hstack([get(f"{robot}_eef_pos")[0], get(f"{robot}_eef_rot_axis_angle")[0]])
                width = get(f"{robot}_gripper_width")[0][:, 0] * M_TO_MM
            except KeyError as error:
                raise UserError(f"{self.path}: {robot} has no pose or width; there are: {error.args[0]}") from None
            bodies[robot] = columns_file.poses(pose, ColumnNames())
            for side, turn, sign in (("left", LEFT_TURN, -1), ("right", RIGHT_TURN, 1)):
                finger = np.tile(np.eye(4), (len(width), 1, 1))
                finger[:, :3, :3], finger[:, 0, 3] = turn, sign * width / 2
                bodies[f"{robot}_{side}"] = bodies[robot] @ finger
        time = np.arange(end - start) / self.fps
        return RecordedRows(str(number), time, get, bodies=bodies, width=width, model=self.model)


def opened(path: Path, fps: float | None, model: Kinematics | None = None) -> Buffer:
    """The buffer in a folder or `.zarr.zip`. Raises UserError: Zarr is missing, or it is no such buffer."""
    try:
        import zarr
    except ImportError:
        raise UserError("UMI's data need Zarr: pip install 'tacgen[zarr]'") from None
    try:
        store: Any = zarr.storage.ZipStore(path, mode="r") if path.is_file() else path
        root: Any = zarr.open(store, mode="r")
        data, ends = root["data"], np.asarray(root["meta/episode_ends"])
    except Exception as error:  # Zarr raises many types for what is damaged or is something else
        raise UserError(f"{path}: is no buffer with data and meta/episode_ends: {error}") from None
    if not (ends.ndim == 1 and len(ends) and (np.diff(ends, prepend=0) > 0).all()):
        raise UserError(f"{path}: its meta/episode_ends must be places that increase")
    return Buffer(path, fps or UMI_FPS, data, ends, model)
