"""MuJoCo: a rigid pad and a rigid shape with soft contact.

The shape is held at rest at each pose (mj_inverse: what contact gives to a body that does not accelerate), or moves
along the face at the speed of its path, since friction that is at rest creeps to 0 here; forces are mj_contactForce.
Contact is convex: the ring is 32 capsules. Contact's stiffness is per mass, and the shape weighs what its density says.
"""

import time
from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.referee.case import DENSITY_KG_M3, PAD_MM, STANDARD_GRAVITY_M_S2, Array, Case, spread
from benchmarks.referee.player import Answer
from benchmarks.referee.playing import missing, quaternion, speed, versions, wrench

DEFAULT = {"solref": (0.02, 1.0), "solimp": (0.9, 0.95, 0.001, 0.5, 2.0)}
TUNED = DEFAULT
GRASP_STEPS = 500  # of 2 ms


class MujocoRigid:
    name = "MuJoCo rigid"
    settings = ("default", "tuned")

    def available(self) -> str | None:
        return missing("mujoco")

    def version(self) -> str:
        return versions("mujoco")

    def play(self, case: Case, setting: str) -> Answer:
        return self.with_contact(case, DEFAULT if setting == "default" else TUNED)

    def with_contact(self, case: Case, contact: Mapping[str, tuple[float, ...]]) -> Answer:
        """Play with these solref and solimp."""
        import mujoco

        model = _model(case, contact).compile()
        data = mujoco.MjData(model)
        found, start = [], time.process_time()
        for frame in case.judged:
            if case.mass_kg:
                mujoco.mj_step(model, data, nstep=GRASP_STEPS)
            else:
                moved, turned = speed(case, frame)
                pose = case.poses[frame]
                data.qpos[:3], data.qpos[3:] = np.array(pose[:3]) / 1000, quaternion(pose)
                local = Rotation.from_matrix(pose.matrix[:3, :3]).inv().apply(turned)
                data.qvel[:3], data.qvel[3:], data.qacc[:] = moved / 1000, local, 0
                mujoco.mj_inverse(model, data)
            found.append(_contacts(model, data))
        seconds = (time.process_time() - start) / len(case.judged)
        force, torque = (np.array(part) for part in zip(*(wrench(*one) for one in found), strict=True))
        pressure, traction = (np.array(part) for part in zip(*(spread(*one) for one in found), strict=True))
        return Answer(force, torque, seconds, dict(contact), pressure, traction)


def _model(case: Case, contact: Mapping[str, tuple[float, ...]]):  # type: ignore[no-untyped-def]
    """The scene [m]; a grasp has two pads that are closed."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.gravity = (0, STANDARD_GRAVITY_M_S2 if case.mass_kg else 0, 0)
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.default.geom.solref[:], spec.default.geom.solimp[:] = contact["solref"], contact["solimp"]
    spec.default.geom.friction[0], spec.default.geom.density = case.friction, DENSITY_KG_M3
    half = np.array(PAD_MM) / 2000
    faces = [0.0] if not case.mass_kg else [0.0, 0.01 + 2 * case.poses[-1].z / 1000]
    for sign, face in zip((-1, 1), faces, strict=False):
        spec.worldbody.add_geom(name=f"pad{face}", type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=(0, 0, face + sign * half[2]))
    body = spec.worldbody.add_body(pos=(0, 0, case.poses[-1].z / 1000))
    body.add_freejoint()
    if case.shape == "ring":
        at = np.radians(np.linspace(0, 360, 33))
        ring = np.stack([3 * np.cos(at), 3 * np.sin(at), np.full(33, 0.8)], -1) / 1000
        for a, b in zip(ring[:-1], ring[1:], strict=True):
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(0.0008, 0, 0), fromto=np.concatenate([a, b]))
        return spec
    mesh = case.mesh()
    spec.add_mesh(name="shape", uservert=(mesh.vertices / 1000).ravel(), userface=mesh.faces.ravel())
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="shape")
    return spec


def _contacts(model, data) -> tuple[Array, Array]:  # type: ignore[no-untyped-def]
    """Points (n, 3) [mm] of contact and forces (n, 3) [N] on the pads, which are the world's."""
    import mujoco

    points, forces = np.zeros((data.ncon, 3)), np.zeros((data.ncon, 3))
    for i, contact in enumerate(data.contact):
        local = np.zeros(6)
        mujoco.mj_contactForce(model, data, i, local)
        sign = 1 if model.geom_bodyid[contact.geom[1]] == 0 else -1  # it acts on the second
        points[i], forces[i] = 1000 * contact.pos, sign * contact.frame.reshape(3, 3).T @ local[:3]
    return points, forces


PLAYERS = (MujocoRigid(),)
