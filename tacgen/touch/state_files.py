"""HDF5 files of simulated states: demonstrations of robomimic, robosuite and LIBERO, and trajectories of ManiSkill.

    https://robomimic.github.io/docs/datasets/overview.html
    https://maniskill.readthedocs.io/en/latest/user_guide/datasets/demos.html

A demonstration `data/demo_k` has `states`, rows of time, qpos and qvel of MuJoCo, and its model as the attribute
`model_file`. A trajectory `traj_k` has `env_states/actors/<body>`, rows of a pose (x y z [m], quaternion w x y z) and
speeds, and `env_states/articulations/<robot>`, the pose of its base, speeds, and positions and speeds of its joints.
"""

import importlib.util
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base.errors import UserError
from tacgen.bundle import hdf5_file
from tacgen.replay import array_log
from tacgen.touch import columns as columns_file
from tacgen.touch import kinematics
from tacgen.touch.columns import Get, Named
from tacgen.touch.kinematics import Kinematics
from tacgen.touch.recording import RecordedRows

Array = np.ndarray
MANISKILL_FPS = 20.0  # control_freq of its tasks, and of its files where --columns says no other [1/s]
BASE_NUMBERS = 13  # of a body's state: position, quaternion, speed and turning speed
ASSET_PACKAGES = ("robosuite", "libero")  # where their models' meshes are, if they are installed


@dataclass(frozen=True)
class StateFile:
    """Episodes of one HDF5 file. names: of their groups; models: those that episodes carry, by their texts."""

    path: Path
    kind: str
    fps: float
    names: list[str]
    model: Kinematics | None
    models: dict[str, Kinematics] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.names)

    def rows(self, number: int) -> RecordedRows:
        """One episode by its place. Raises UserError: it is damaged, or not as such files are."""
        with _group(self.path, self.names[number]) as group:
            return self._demo(group, number) if self.kind == "robomimic" else self._trajectory(group, number)

    def _demo(self, group: Any, number: int) -> RecordedRows:
        name = self.names[number].rpartition("/")[2]
        states, text = array_log.dataset(self.path, group, "states"), group.attrs.get("model_file")
        model = self.model
        if model is None and text is not None:
            text = text.decode() if isinstance(text, bytes) else str(text)
            if text not in self.models:
                self.models[text] = kinematics.of_text(text, f"{self.path}: {name}", [self.path.parent, *_installed()])
            model = self.models[text]
        time = states[:, 0].astype(float) - float(states[0, 0])
        if model is None:
            return RecordedRows(name, time, _getter(self.path, self.names[number]))
        places = 1 + model.model.nq, 1 + model.model.nq + model.model.nv
        if states.ndim != 2 or states.shape[1] not in (places[1], places[1] + model.model.na):
            raise UserError(
                f"{self.path}: {name}: its states have {states.shape[-1]} numbers, and of its model {places[1]}:"
                f" time, {model.model.nq} positions and {model.model.nv} speeds"
            )
        qpos, qvel = states[:, 1 : places[0]].astype(float), states[:, places[0] : places[1]].astype(float)
        return RecordedRows(name, time, _getter(self.path, self.names[number]), qpos=qpos, qvel=qvel, model=model)

    def _trajectory(self, group: Any, number: int) -> RecordedRows:
        states: dict[str, Array] = {}
        for kind in ("actors", "articulations"):
            try:
                inner = hdf5_file.item_at(group, f"env_states/{kind}")
            except (KeyError, ValueError):
                continue
            states |= {f"{kind}/{name}": array_log.dataset(self.path, inner, name) for name in inner}
        if not states:
            raise UserError(f"{self.path}: {self.names[number]}: has no env_states: record with --record-env-state")
        bodies = {name.partition("/")[2]: _pose(values) for name, values in states.items()}
        count = len(next(iter(bodies.values())))
        base = qpos = qvel = None
        if self.model is not None:
            size = self.model.model.nq
            for name, values in states.items():
                if name.startswith("articulations/") and values.shape[1] == BASE_NUMBERS + 2 * size:
                    base, qpos = _pose(values), values[:, BASE_NUMBERS : BASE_NUMBERS + size].astype(float)
                    qvel = values[:, BASE_NUMBERS + size :].astype(float)
                    break
            else:
                raise UserError(f"{self.path}: {self.names[number]}: none of its robots has the model's {size} joints")
        get = _getter(self.path, self.names[number])
        time = np.arange(count) / self.fps
        found = RecordedRows(self.names[number], time, get, bodies=bodies, model=self.model)
        return replace(found, qpos=qpos, qvel=qvel, base=base)


def opened(path: Path, model: Kinematics | None, fps: float | None) -> StateFile | None:
    """The demonstrations or trajectories in a file; None if it has neither. Raises UserError: it cannot be read."""
    with hdf5_file.opened(path) as root:
        demos = [name for name in root.get("data", ()) if re.fullmatch(r"demo_\d+", name)]
        trajectories = [name for name in root if re.fullmatch(r"traj_\d+", name)]
        if demos:
            names = [f"data/{name}" for name in sorted(demos, key=_number)]
            time = array_log.dataset(path, hdf5_file.item_at(root, names[0]), "states")[:, 0]
            steps = np.diff(time)
            if fps is None and not (len(steps) and np.median(steps) > 0):
                raise UserError(f"{path}: {names[0]}: its states have no time that increases: say fps in --columns")
            return StateFile(path, "robomimic", fps or float(np.round(1 / np.median(steps), 3)), names, model)
        if trajectories:
            return StateFile(path, "maniskill", fps or MANISKILL_FPS, sorted(trajectories, key=_number), model)
    return None


def _number(name: str) -> int:
    return int(name.rpartition("_")[2])


@contextmanager
def _group(path: Path, name: str) -> Iterator[Any]:
    with hdf5_file.opened(path) as root:
        yield hdf5_file.item_at(root, name)


def _getter(path: Path, group: str) -> Get:
    """Datasets below a group by their paths, read when they are asked for."""

    def get(name: str) -> Named:
        with _group(path, group) as here:
            try:
                values = array_log.dataset(path, here, name)
            except UserError:
                raise KeyError(", ".join(_datasets(here))) from None
        return values.reshape(len(values), -1), ()

    return get


def _datasets(group: Any) -> list[str]:
    found: list[str] = []
    group.visititems(lambda name, item: found.append(name) if hasattr(item, "dtype") else None)
    return found


def _pose(values: Array) -> Array:
    return columns_file.poses(values[:, :7], columns_file.ColumnNames())


def _installed() -> list[Path]:
    """Folders of the packages whose models' meshes episodes name, where they are installed."""
    found = (importlib.util.find_spec(name) for name in ASSET_PACKAGES)
    return [Path(folder) for spec in found if spec is not None for folder in spec.submodule_search_locations or ()]
