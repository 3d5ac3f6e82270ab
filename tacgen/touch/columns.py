"""Which columns of recorded data are joint states, poses of bodies, forces and the grip.

What the data's own names do not say, a file of columns does (YAML; every key may be left out):

    units: m                    # of lengths: m or mm
    quaternion: wxyz            # order of quaternions: wxyz or xyzw
    angles: rad                 # of joints: rad or deg
    fps: 30                     # rows in a second, where the data have no time
    layout: tacgen              # of logs: names of arrays as of `tacgen replay --from`
    qpos: observation.qpos      # positions of all joints, in the order of the model
    qvel: observation.velocity  # their speeds; without them they are differences of positions
    ctrl: action                # commands of all actuators of the model, in its order
    joints: {elbow: "observation.state[elbow_flex.pos]"}           # or joint by joint
    bodies: {cup: "observation.cup", hand: "obs/eef_pos + obs/eef_quat"}
    forces: {left_pad/cup: "observation.pad_force[0:3]"}           # on the first by the second, in the world [N]
    grip: "action[left_finger]"                                    # what the gripper shall close with [N]

A reference names a feature, a dataset or an array. Brackets choose some of its numbers, by places from 0 or by their
names with commas between; ` + ` joins several, and `0.001 * feature` scales one. A pose is 7 numbers (position and
quaternion), 6 (position and rotation vector) or 16 (a matrix, row by row).
"""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from tacgen.base.errors import UserError
from tacgen.recipe.pose_table import MM_PER_UNIT
from tacgen.replay.contact_log import QUATERNION_ORDERS
from tacgen.sensor import validation_messages, yaml_source
from tacgen.sensor.base_model import Part, Positive

Array = np.ndarray
Named = tuple[Array, Sequence[str]]  # numbers (n, k), and the names of the k, of which there may be none
Get = Callable[[str], Named]  # of a feature; KeyError: there is none
REFERENCE = re.compile(r"\s*(?:(-?[\d.]+(?:e-?\d+)?)\s*\*\s*)?([^\[\]]+?)\s*(?:\[([^\]]*)\])?\s*")
MAX_QUATERNION_ERROR = 0.02  # of a quaternion's length from 1 [-]; single precision and mean values reach 1e-3


class ColumnNames(Part):
    """A file of columns."""

    units: Literal["m", "mm"] = "m"
    quaternion: Literal["wxyz", "xyzw"] = "wxyz"
    angles: Literal["rad", "deg"] = "rad"
    fps: Positive | None = None
    layout: str = "tacgen"
    qpos: str | None = None
    qvel: str | None = None
    ctrl: str | None = None
    joints: dict[str, str] = Field(default_factory=dict)
    bodies: dict[str, str] = Field(default_factory=dict)
    forces: dict[str, str] = Field(default_factory=dict)
    grip: str | None = None

    @property
    def pairs(self) -> dict[tuple[str, str], str]:
        """References of forces by their two bodies."""
        return {(one, other): text for pair, text in self.forces.items() for one, _, other in [pair.partition("/")]}


def read(given: Path | Mapping[str, Any] | None) -> ColumnNames:
    """The columns in a file or a mapping. Raises UserError: unknown keys, or values that cannot be."""
    if isinstance(given, Path):
        tree = yaml_source.load(given)
    else:
        nowhere = yaml_source.Mark(yaml_source.Source("columns"))
        tree = yaml_source.Tree(dict(given or {}), {(): yaml_source.Spot(nowhere, nowhere)})
    found, issues = validation_messages.validate(ColumnNames, tree.data or {})
    if found is None:
        raise validation_messages.report((issue, tree) for issue in issues)
    if wrong := [pair for pair in found.forces if not re.fullmatch("[^/]+/[^/]+", pair)]:
        raise UserError(f"columns: forces: {wrong[0]!r} must be two bodies, as in left_pad/cup: the touched one first")
    return found


def picked(reference: str, get: Get) -> Array:
    """The numbers (n, k) of a reference. Raises UserError: there is no such feature or name."""
    parts = []
    for text in reference.split(" + "):
        if (match := REFERENCE.fullmatch(text)) is None:
            raise UserError(f"columns: {text.strip()!r} is no reference such as feature, feature[0:3] or feature[x,y]")
        factor, name, some = match.groups()
        try:
            values, names = get(name)
        except KeyError as error:
            raise UserError(f"columns: there is no {name}; there are: {error.args[0]}") from None
        parts.append(float(factor or 1) * _some(values, names, name, some))
    return np.hstack(parts)


def _some(values: Array, names: Sequence[str], feature: str, some: str | None) -> Array:
    if some is None:
        return values
    if match := re.fullmatch(r"\s*(\d*)\s*:\s*(\d*)\s*", some):
        first, last = (int(text) if text else None for text in match.groups())
        if (last or 0) > values.shape[1]:
            raise UserError(f"columns: {feature}[{some}]: it has {values.shape[1]} numbers, counted from 0")
        return values[:, first:last]
    places = []
    for text in (part.strip() for part in some.split(",")):
        if text in names:
            places.append(list(names).index(text))
        elif text.isdecimal() and int(text) < values.shape[1]:
            places.append(int(text))
        else:
            told = ", ".join(names) or f"{values.shape[1]} without names, counted from 0"
            raise UserError(f"columns: {feature} has no {text!r}; there are: {told}")
    return values[:, places]


def poses(values: Array, columns: ColumnNames) -> Array:
    """Poses (n, 4, 4) [mm] from numbers (n, 6, 7 or 16); nan where one of a row's numbers is.

    Raises:
        ValueError: another count of numbers; a quaternion in a row is not of length 1.
    """
    from scipy.spatial.transform import Rotation

    values = np.asarray(values, float)
    known, found = np.isfinite(values).all(1), np.full((len(values), 4, 4), np.nan)
    some = values[known]
    found[known] = np.eye(4)
    if values.shape[1] == 16:
        found[known] = some.reshape(-1, 4, 4)
        position = found[known][:, :3, 3]
    elif values.shape[1] == 7:
        length = np.linalg.norm(some[:, 3:], axis=1)
        if (wrong := np.abs(length - 1) > MAX_QUATERNION_ERROR).any():
            row = np.flatnonzero(known)[wrong.argmax()]
            raise ValueError(f"row {row}: its quaternion is of length {length[wrong][0]:.3g}, not 1")
        turn = Rotation.from_quat(some[:, 3:][:, QUATERNION_ORDERS[columns.quaternion]], scalar_first=True)
        position, found[known, :3, :3] = some[:, :3], turn.as_matrix()
    elif values.shape[1] == 6:
        position, found[known, :3, :3] = some[:, :3], Rotation.from_rotvec(some[:, 3:]).as_matrix()
    else:
        raise ValueError(f"a pose is 7 numbers (x y z and a quaternion), 6 or 16, and these are {values.shape[1]}")
    found[known, :3, 3] = position * MM_PER_UNIT[columns.units]
    return found
