"""Kinematics and contact forces of a robot's model (MJCF or URDF) by MuJoCo; lengths become mm."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from tacgen.base import regular_file
from tacgen.base.errors import UserError
from tacgen.recipe import pose_table
from tacgen.touch import surfaces
from tacgen.touch.episode import BodySurface, Thing
from tacgen.touch.surfaces import RigidPart

Array = np.ndarray
MAX_MODEL_BYTES = 50_000_000  # of a model's text [bytes]
M_TO_MM = 1000.0
KINDS_OF_GEOMS = {2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box", 7: "mesh"}  # of mjtGeom
FREE, BALL, HINGE = 0, 1, 3  # of mjtJoint
ENDINGS = {FREE: ("x", "y", "z", "qw", "qx", "qy", "qz"), BALL: ("qw", "qx", "qy", "qz")}


def opened(path: Path) -> "Kinematics":
    """The model in an MJCF or URDF file. Raises UserError: MuJoCo is missing or refuses it."""
    regular_file.content(path, MAX_MODEL_BYTES)  # MuJoCo reads it itself
    return _compiled(str(path), lambda spec: spec.from_file(str(path)))


def of_text(text: str, name: str, folders: Sequence[Path]) -> "Kinematics":
    """The model in a text of MJCF, as episodes carry it. Files that it names are looked for by the longest end of their
    paths below `folders`. Raises UserError as `opened` does, or where a file is not found."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UserError(f"{name}: its model is no XML: {error}") from None
    below = {}
    for compiler in root.iter("compiler"):
        below = {key: compiler.attrib.pop(key, "") for key in ("meshdir", "texturedir", "assetdir")}
    for element in root.iter():
        if element.tag in ("texture", "material"):
            element.attrib.pop("texture", None)  # pictures are not needed
        elif given := element.get("file"):
            folder = below.get("meshdir") or below.get("assetdir") or ""
            element.set("file", str(_found(Path(folder) / given, name, folders)))
    for asset in root.iter("asset"):
        for texture in asset.findall("texture"):
            asset.remove(texture)
    whole = ElementTree.tostring(root, encoding="unicode")
    return _compiled(name, lambda spec: spec.from_string(whole))


def _found(given: Path, name: str, folders: Sequence[Path]) -> Path:
    for folder in ([Path("/")] if given.is_absolute() else []) + list(folders):
        for start in range(len(given.parts)):
            if (path := folder.joinpath(*[p for p in given.parts[start:] if p != "/"])).is_file():
                return path.resolve()
    where = ", ".join(map(str, folders))
    raise UserError(f"{name}: its model names {given}, which is not below {where}: put it there, or give --model")


def _compiled(name: str, read: Callable[[Any], Any]) -> "Kinematics":
    try:
        import mujoco
    except ImportError:
        raise UserError("joint states and models need MuJoCo: pip install 'tacgen[mujoco]'") from None
    try:
        spec = read(mujoco.MjSpec)
        spec.compiler.fusestatic = False  # links of a URDF that are fixed to others keep their names
        return Kinematics(name, spec.compile())
    except Exception as error:  # MuJoCo says by many types what it does not like
        raise UserError(f"{name}: MuJoCo cannot read it: {' '.join(str(error).split())}") from None


@dataclass(frozen=True)
class States:
    """Joint states at times (n,) [s]: positions (n, nq), known speeds (n, nv) and commands (n, nu) of actuators."""

    time: Array
    qpos: Array
    qvel: Array | None = None
    ctrl: Array | None = None


@dataclass(frozen=True)
class Kinematics:
    """A compiled model of MuJoCo."""

    name: str
    model: Any

    @cached_property
    def bodies(self) -> list[str]:
        """Names of the bodies that have one, parents first, without the world."""
        return [name for k in range(1, self.model.nbody) if (name := self.model.body(k).name)]

    @cached_property
    def free(self) -> list[str]:
        """Names of the bodies with a free joint and no other joint below: what may be an object."""
        m = self.model
        roots = [int(m.jnt_bodyid[j]) for j in range(m.njnt) if m.jnt_type[j] == FREE]
        return [m.body(k).name for k in roots if (m.body_weldid[m.body_rootid == k] == k).all()]

    @cached_property
    def joints(self) -> dict[str, tuple[int, tuple[str, ...], bool]]:
        """By the name of each joint, or of its body where it has none: its first place in qpos, the endings of the
        names of its numbers ("" of a single one), and whether it is an angle."""
        m, found = self.model, {}
        for j in range(m.njnt):
            name, kind = m.joint(j).name or m.body(m.jnt_bodyid[j]).name, int(m.jnt_type[j])
            found[name] = int(m.jnt_qposadr[j]), ENDINGS.get(kind, ("",)), kind == HINGE
        return found

    def body_of(self, joint: str) -> str:
        """The name of the body that a joint moves; a joint without a name has its body's."""
        m = self.model
        known = {m.joint(j).name: m.body(m.jnt_bodyid[j]).name for j in range(m.njnt)}
        return str(known.get(joint, joint))

    @property
    def gravity(self) -> tuple[float, float, float]:
        """In the world [m/s^2]."""
        x, y, z = self.model.opt.gravity.tolist()
        return x, y, z

    @property
    def actuators(self) -> list[str]:
        """Names of the actuators in the order of commands."""
        return [self.model.actuator(k).name for k in range(self.model.nu)]

    def poses(self, qpos: Array) -> dict[str, Array]:
        """Poses (n, 4, 4) [mm] in the world of every named body, for joint states (n, nq)."""
        found = self._world(qpos)
        return {name: found[self.model.body(name).id] for name in self.bodies}

    def _world(self, qpos: Array) -> Array:
        """Poses (bodies, n, 4, 4) [mm] of all bodies for joint states (n, nq)."""
        import mujoco

        data = mujoco.MjData(self.model)
        found = np.tile(np.eye(4), (self.model.nbody, len(qpos), 1, 1))
        for row, state in enumerate(qpos):
            data.qpos[:] = state
            mujoco.mj_kinematics(self.model, data)
            found[:, row, :3, :3] = data.xmat.reshape(-1, 3, 3)
            found[:, row, :3, 3] = data.xpos * M_TO_MM
        return found

    def speeds(self, states: "States") -> Array:
        """Speeds (n, nv) of the joints: central differences of their positions."""
        import mujoco

        qpos, time = states.qpos, states.time
        found = np.zeros((len(qpos), self.model.nv))
        for row in range(len(qpos)):
            before, after = max(row - 1, 0), min(row + 1, len(qpos) - 1)
            if after > before:
                span = float(time[after] - time[before])
                mujoco.mj_differentiatePos(self.model, found[row], span, qpos[before], qpos[after])
        return found

    def forces(self, states: "States", things: Sequence[str]) -> dict[tuple[str, str], Array]:
        """Forces (n, 3) [N] in the world, on every body that is not fixed to the world by each of the things, by
        MuJoCo's forward dynamics; bodies that are fixed to each other have one force.

        Args:
            states: with speeds and commands: without its motors a gripper does not press.
        """
        import mujoco

        assert states.ctrl is not None

        m, data, wrench = self.model, mujoco.MjData(self.model), np.zeros(6)
        count = len(states.qpos)
        groups, held = m.body_weldid, {int(m.body_weldid[m.body(name).id]): name for name in things}
        found: dict[tuple[int, str], Array] = {}
        qvel = self.speeds(states) if states.qvel is None else states.qvel
        for row, (qpos, speed, ctrl) in enumerate(zip(states.qpos, qvel, states.ctrl, strict=True)):
            data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, speed, ctrl
            mujoco.mj_forward(m, data)
            for k in range(data.ncon):
                one, other = (int(groups[m.geom_bodyid[g]]) for g in data.contact[k].geom)
                mujoco.mj_contactForce(m, data, k, wrench)
                force = data.contact[k].frame.reshape(3, 3).T @ wrench[:3]  # on the second of its bodies
                for touched, thing, sign in ((one, other, -1), (other, one, 1)):
                    if thing in held:
                        found.setdefault((touched, held[thing]), np.zeros((count, 3)))[row] += sign * force
        none = np.zeros((count, 3))
        named = [(name, int(groups[m.body(name).id])) for name in self.bodies if groups[m.body(name).id]]
        return {
            (name, thing): found.get((group, thing), none)
            for thing in things for name, group in named if group != groups[m.body(thing).id]
        }  # fmt: skip

    def thing(self, body: str, surface: BodySurface | None = None) -> Thing:
        """An object of the model, with the surface of its geometry where none is given.

        Raises:
            UserError: the model has no such body, or the body has no geometry that may be touched.
        """
        if body not in self.bodies:
            raise UserError(f"object {body}: {self.name} has no such body; there are: {', '.join(self.bodies)}")
        m = self.model
        welded = [k for k in range(m.nbody) if k in self._fixed(m.body(body).id)]
        mass = m.body_mass[welded]
        world = self._world(m.qpos0[None])[:, 0]
        frames = np.asarray(np.linalg.inv(world[m.body(body).id]) @ world)  # of all bodies in the frame of this one
        centres = np.array([frames[k][:3, :3] @ m.body_ipos[k] * M_TO_MM + frames[k][:3, 3] for k in welded])
        centre = mass @ centres / mass.sum() if mass.sum() > 0 else None
        found = surfaces.of_solids(body, self._solids(welded, frames)) if surface is None else surface
        return Thing(body, found, float(mass.sum()) if mass.sum() > 0 else None, centre)

    def _fixed(self, body: int) -> set[int]:
        """The body and those that are fixed to it; of one fixed to the world, those below it alone."""
        m = self.model
        if m.body_weldid[body]:
            return {k for k in range(m.nbody) if m.body_weldid[k] == m.body_weldid[body]}
        found = {body}
        for k in range(body + 1, m.nbody):
            if int(m.body_parentid[k]) in found and not m.body_weldid[k]:
                found.add(k)
        return found

    def _solids(self, bodies: Sequence[int], frames: Array) -> list[RigidPart]:
        """The parts of bodies that are fixed to each other: what collides, or all where nothing does."""
        m = self.model
        all_geoms = [g for g in range(m.ngeom) if m.geom_bodyid[g] in bodies and int(m.geom_type[g]) in KINDS_OF_GEOMS]
        colliding = [g for g in all_geoms if m.geom_contype[g] or m.geom_conaffinity[g]]
        found = []
        for g in colliding or all_geoms:
            kind, mesh = KINDS_OF_GEOMS[int(m.geom_type[g])], int(m.geom_dataid[g])
            (pose,) = pose_table.matrices([m.geom_pos[g] * M_TO_MM], [m.geom_quat[g]])
            placed = frames[m.geom_bodyid[g]] @ pose
            size = m.geom_size[g] * M_TO_MM
            found.append(RigidPart(kind, size, placed, *(self._mesh(mesh) if kind == "mesh" else ())))
        return found

    def _mesh(self, mesh: int) -> tuple[Array, Array]:
        """Vertices [mm] and triangles in the frame of the geom."""
        m = self.model
        v, f = int(m.mesh_vertadr[mesh]), int(m.mesh_faceadr[mesh])
        corners = m.mesh_vert[v : v + m.mesh_vertnum[mesh]].astype(float) * M_TO_MM
        return corners, m.mesh_face[f : f + m.mesh_facenum[mesh]].astype(np.int64)
