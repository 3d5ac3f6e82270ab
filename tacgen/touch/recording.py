"""Rows of any file as a recorded episode: joint states through a model, columns as poses, forces, grip; and checks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from tacgen.base.errors import UserError
from tacgen.touch import oddities, surfaces
from tacgen.touch.columns import ColumnNames, Get, picked, poses
from tacgen.touch.episode import EpisodeLog, Thing
from tacgen.touch.kinematics import ENDINGS, FREE, M_TO_MM, Kinematics, States

Array = np.ndarray
DEFAULT_GRAVITY = (0.0, 0.0, -9.81)  # in the world, where no model says it [m/s^2]


@dataclass(frozen=True)
class RecordedRows:
    """The n rows of an episode as a file has them.

    time (n,) [s]; get: a feature by its name; named, commands: observed numbers and commands (n,) by their names;
    qpos, qvel: the model's states, where the file holds them whole; bodies: poses (n, 4, 4) [mm]; base: poses of the
    model's own world; forces (n, 3) [N] as a recorded episode has them; width (n,) [mm] between the fingers; model:
    that of the episode.
    """

    name: str
    time: Array
    get: Get
    named: Mapping[str, Array] = field(default_factory=dict)
    commands: Mapping[str, Array] = field(default_factory=dict)
    qpos: Array | None = None
    qvel: Array | None = None
    bodies: Mapping[str, Array] = field(default_factory=dict)
    forces: Mapping[tuple[str, str], Array] = field(default_factory=dict)
    base: Array | None = None
    width: Array | None = None
    model: Kinematics | None = None


@dataclass(frozen=True)
class Recording:
    """Recorded episodes. kind: lerobot, robomimic, maniskill, umi or log; fps: rows in a second; rows: of an episode by
    its place; asked: `--object`s, text by name, "" for a body of the model; columns: what the names in the file do not
    say."""

    path: Path
    kind: str
    fps: float
    count: int
    rows: Callable[[int], RecordedRows]
    asked: Mapping[str, str]
    columns: ColumnNames

    def __len__(self) -> int:
        return self.count

    @cached_property
    def things(self) -> Mapping[str, Thing]:
        """Objects by the names of their bodies: those asked for, else every body with a free joint in the model."""
        return self._things(self._first_model)

    @cached_property
    def _first_model(self) -> Kinematics | None:
        return self.rows(0).model

    def episode(self, number: int) -> EpisodeLog:
        """The one at this place, from 0. Raises UserError, one line: it cannot be read or is not plausible."""
        rows = self.rows(number)
        where = f"{self.path}: episode {rows.name}"
        self._refuse_other_things(rows.model, where)
        bodies, forces = dict(rows.bodies), dict(rows.forces)
        try:
            own = {name: poses(picked(text, rows.get), self.columns) for name, text in self.columns.bodies.items()}
            if rows.model is not None:
                states = _states(rows, rows.model, self.columns, own)
                placed = rows.model.poses(states.qpos)  # in the model's own world, which stands at `base`
                bodies |= placed if rows.base is None else {name: rows.base @ each for name, each in placed.items()}
                if states.ctrl is not None and not self.columns.forces:
                    forces |= rows.model.forces(states, [name for name in self.things if name in rows.model.bodies])
            forces |= {pair: _wide(text, rows, 3) for pair, text in self.columns.pairs.items()}
            told = self.columns.grip
            grip = np.maximum(_wide(told, rows, 1)[:, 0], 0.0) if told else None
        except (UserError, ValueError) as error:
            raise UserError(f"{where}: {error}") from None
        gravity = DEFAULT_GRAVITY if rows.model is None else rows.model.gravity
        found = EpisodeLog(number, rows.name, rows.time, bodies | own, forces, grip, gravity)
        if lost := [name for name in self.things if name not in found.bodies]:
            known = ", ".join(found.bodies) or "none"
            raise UserError(f"{where}: has no poses of {lost[0]} (of {known}): name its columns under bodies")
        oddities.refuse(found, self.fps, where)
        oddities.note(found, rows.width, where)
        return found

    def _things(self, model: Kinematics | None) -> dict[str, Thing]:
        asked = self.asked or dict.fromkeys(model.free if model else (), "")
        found = {}
        for name, text in asked.items():
            surface = surfaces.of_text(name, text) if text else None
            if model is not None and (name in model.bodies or surface is None):
                found[name] = model.thing(name, surface)
            elif surface is None:
                raise UserError(f"object {name}: without a model it needs a surface: --object {name}=MESH, or --model")
            else:
                found[name] = Thing(name, surface)
        if not found:
            raise UserError(f"{self.path}: no objects: name them by --object BODY (with --model) or --object NAME=MESH")
        return found

    def _refuse_other_things(self, model: Kinematics | None, where: str) -> None:
        """Episodes may carry models of their own: what is touched must be as in the first."""
        if model is None or model is self._first_model:
            return
        for name, thing in self._things(model).items():
            mine, its = self.things[name].surface, thing.surface
            if mine.indenter != its.indenter or not np.allclose(mine.pose, its.pose):
                raise UserError(
                    f"{where}: its {name} is of another size or shape than in the first episode:"
                    " give such episodes in files of their own"
                )


def _states(rows: RecordedRows, model: Kinematics, columns: ColumnNames, bodies: Mapping[str, Array]) -> States:
    """Joint states of the model. Raises UserError: a joint has no column, or a row no number."""
    size, qpos = int(model.model.nq), rows.qpos
    if columns.qpos:
        qpos = _wide(columns.qpos, rows, size)
    if qpos is None:
        qpos = _by_joints(rows, model, columns, bodies)
    elif qpos.shape[1] != size:
        raise UserError(f"has {qpos.shape[1]} joint positions, and {model.name} has {size}: is it its model?")
    if (wrong := ~np.isfinite(qpos).all(1)).any():
        raise UserError(f"row {wrong.argmax()}: its joint states are missing or no numbers")
    qvel = _wide(columns.qvel, rows, int(model.model.nv)) if columns.qvel else rows.qvel
    ctrl = _wide(columns.ctrl, rows, int(model.model.nu)) if columns.ctrl else None
    if ctrl is None and model.actuators and rows.commands.keys() >= set(model.actuators):
        ctrl = np.column_stack([rows.commands[name] for name in model.actuators])
    return States(rows.time, qpos, qvel, ctrl)


def _by_joints(rows: RecordedRows, model: Kinematics, columns: ColumnNames, bodies: Mapping[str, Array]) -> Array:
    """Joint positions (n, nq) from columns of single joints, and of free ones also from their bodies' poses."""
    if unknown := columns.joints.keys() - model.joints:
        there = ", ".join(model.joints)
        raise UserError(f"columns: joints: {model.name} has no joint {', '.join(sorted(unknown))}; there are: {there}")
    qpos, lost = np.tile(model.model.qpos0, (len(rows.time), 1)), []
    for joint, (place, endings, angle) in model.joints.items():
        values = _of_joint(joint, endings, rows, columns)
        if values is None and len(endings) == len(ENDINGS[FREE]) and (body := model.body_of(joint)) in bodies:
            values = _free_state(bodies[body])
        if values is None:
            lost.append(joint)
        else:
            scale = np.pi / 180 if angle and columns.angles == "deg" else 1.0
            qpos[:, place : place + len(endings)] = values * scale
    if lost:
        known = ", ".join(rows.named) or "none"
        raise UserError(f"no column is named as joint {', '.join(lost)}: name it under joints (there: {known})")
    return qpos


def _of_joint(joint: str, endings: Sequence[str], rows: RecordedRows, columns: ColumnNames) -> Array | None:
    """Columns (n, k) of a joint: as given, or by names as joint, joint.pos, and joint.x ... joint.qz of a free one."""
    if joint in columns.joints:
        return _wide(columns.joints[joint], rows, len(endings))
    for form in ("{}.{}", "{}_{}") if len(endings) > 1 else ("{}", "{}.pos"):
        names = [form.format(joint, ending) for ending in endings]
        if all(name in rows.named for name in names):
            return np.column_stack([rows.named[name] for name in names])
    return None


def _free_state(poses: Array) -> Array:
    """States (n, 7) of a free joint from poses (n, 4, 4) [mm], nan where these are."""
    from scipy.spatial.transform import Rotation

    found, known = np.full((len(poses), 7), np.nan), np.isfinite(poses).all((1, 2))
    found[known, :3] = poses[known, :3, 3] / M_TO_MM
    found[known, 3:] = Rotation.from_matrix(poses[known, :3, :3]).as_quat(scalar_first=True)
    return found


def _wide(reference: str, rows: RecordedRows, width: int) -> Array:
    """Numbers (n, width) of a reference. Raises UserError: there are other ones."""
    values = picked(reference, rows.get)
    if values.shape[1] != width:
        raise UserError(f"columns: {reference}: has {values.shape[1]} numbers, expected {width}")
    return np.asarray(values, float)
